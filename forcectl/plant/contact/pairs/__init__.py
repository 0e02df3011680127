"""Contacts of two parts in place of that of their shapes."""
