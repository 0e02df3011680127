"""Ordering of the columns for few crossings and bends."""
