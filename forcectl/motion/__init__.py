"""References, trajectories and loads."""
