"""Running scenarios: simulation, logs, run directories, reproduction, replay."""
