"""What every metric is: unit, meaning, formula and sign."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
