"""Force laws of the literature besides those of the thesis, for the same slot `controller`."""
