"""Quadratic programs of controllers."""
