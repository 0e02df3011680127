"""Compliant tasks: forces along task coordinates, references by modes, and the motion that results."""
