"""Directories of results: who has one while it is written, and what is left of one that never was."""
