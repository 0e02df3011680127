"""The reference governor (Section 4.5)."""
