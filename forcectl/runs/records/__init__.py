"""Recorded experiments: reading them from files, and checking them before a controller is tuned on them."""
