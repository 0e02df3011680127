"""Force laws: from a desired and a measured force to a displacement command."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
