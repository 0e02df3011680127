"""Recorded experiments: read from files, and what they must be for a controller to be tuned on them."""
