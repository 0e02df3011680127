"""Laws tuned by virtual reference feedback tuning while they run (Chapter 4)."""
