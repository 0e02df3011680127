"""Analyses of a contact: its first touch, side force, and how a tool aligns with and follows a surface."""
