"""The simulated world: drives, sensors, contact and compliance."""
