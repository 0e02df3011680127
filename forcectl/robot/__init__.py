"""Robots: the numbers of a folder, the rigid-body model, and what is computed from it."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
