"""The drives of a station: what stands between a command and the motors."""
