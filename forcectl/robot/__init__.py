"""Robots: the parameters of a robot folder, the rigid-body model, and quantities computed from it."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
