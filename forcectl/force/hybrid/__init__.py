"""Hybrid control in six dimensions: forces and torques in some directions of a task frame, motion in the others."""
