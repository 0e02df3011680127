"""Scenarios and runs: from a YAML file to logs, metrics, figures and verdicts."""
