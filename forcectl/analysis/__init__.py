"""Metrics and figures from the log of a run."""
