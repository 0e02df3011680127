"""Checks of a scenario before it runs, beyond those of each part by itself."""
