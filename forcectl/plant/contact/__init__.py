"""The environment: surfaces, materials and contact."""
