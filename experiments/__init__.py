"""Questions: one scenario file (YAML) per figure or table of the thesis, and beyond. No code lives here."""
