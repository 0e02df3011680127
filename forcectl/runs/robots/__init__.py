"""What `forcectl robot` finds out of a robot folder, and how it says so."""
