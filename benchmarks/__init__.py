"""What forcectl costs: each module here is a program, `python -m benchmarks` runs them all and prints one table."""
