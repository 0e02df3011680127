"""Fidelities: ways to realise the parts of a station."""
