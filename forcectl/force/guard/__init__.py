"""The guard in front of every controller."""
