"""The examination of a robot folder by `forcectl robot`, and its output."""
