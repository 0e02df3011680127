"""Sweeps: thousands of variations of a scenario, planned in files first, on any engine."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
