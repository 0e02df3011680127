"""References and motion in the unconstrained directions."""
