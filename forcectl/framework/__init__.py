"""Building blocks of systems: sampling, parameters, batches, caches, rotations."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
