"""Force laws: from a desired and a measured force to a displacement command."""
