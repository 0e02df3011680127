"""Golden files: logs and wirings of a test that are kept beside it, and compared with those of every later run."""
