"""What results and choices look like in the terminal."""
