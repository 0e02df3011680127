"""Contact models of two parts, which replace the contact of their shapes."""
