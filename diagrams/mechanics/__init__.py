"""The multibody side of a station: robot, environment and surfaces in one plant."""
