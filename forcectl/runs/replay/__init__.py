"""Replays of runs: what happened in three dimensions, with forces and modes, as one page."""
