"""Robots: the numbers of a folder, the rigid-body model, and what is computed from it."""
