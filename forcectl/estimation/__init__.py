"""Estimation while a loop runs: compliance, external torque, wrench."""
