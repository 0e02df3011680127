"""Invariance control (Chapter 3): a force that does not pass its limit."""
