"""Sensors of force and of joint motion."""
