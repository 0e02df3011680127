"""Distances between the links of a robot, and to obstacles."""
