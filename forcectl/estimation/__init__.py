"""Estimators of what the controllers are not told."""
