"""Golden files: logs and wirings that a test once gave, kept beside it, and compared with what it gives today."""
