"""Scenario files: keys, tags, variants, expectations."""
