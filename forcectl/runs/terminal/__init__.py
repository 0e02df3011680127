"""Output of results and choices in the terminal."""
