"""Placing blocks and wires of a block diagram."""
