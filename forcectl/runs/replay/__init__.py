"""Replays of runs: the motion in three dimensions, with forces and modes, as one HTML page."""
