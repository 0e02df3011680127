"""Tasks that give way to forces: forces along their coordinates, references by modes, the motion of both."""
