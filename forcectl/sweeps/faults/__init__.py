"""Behaviour of a scenario under faults: one run for each fault of a list, and one without a fault."""
