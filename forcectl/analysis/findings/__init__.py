"""Findings: what went wrong in a run, or is worth knowing of it, in words."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
