"""What a scenario does when something fails: one run for each fault of a list, beside the sound one."""
