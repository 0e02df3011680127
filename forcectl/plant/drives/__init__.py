"""From a joint command to the motion of the motors."""
