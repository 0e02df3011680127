"""What became of a contact: its first touch, and how a tool aligned with it."""
