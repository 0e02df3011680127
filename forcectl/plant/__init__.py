"""The parts of a force-controlled robot: loops, compliance, contact, friction, sensors."""
