"""Force laws of the field besides those of the thesis, in the same slot."""
