"""What is made of the table of a sweep: figures, the worst trials kept whole, and one page."""
