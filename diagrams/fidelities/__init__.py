"""Fidelities: ways to simulate the parts of a station, with or without dynamics."""
