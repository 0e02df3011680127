"""Controllers of a scenario that follow tasks."""
