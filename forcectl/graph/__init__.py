"""Block-diagram graphs of any Drake diagram."""
