"""Constraints on the motion of robots."""
