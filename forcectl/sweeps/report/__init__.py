"""Report on a sweep from its table: figures, the worst trials stored in full, and one page."""
