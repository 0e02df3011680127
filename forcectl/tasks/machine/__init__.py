"""Task state machines: modes with guards, timeouts and named ends."""
