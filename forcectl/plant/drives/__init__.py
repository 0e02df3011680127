"""Drives: from a joint command to the motion of the motors."""
