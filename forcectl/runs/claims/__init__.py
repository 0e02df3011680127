"""Directories of results: which process writes one, and what is left of one that was not completed."""
