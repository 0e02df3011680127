"""Off-line tuning and identification from recorded data."""
