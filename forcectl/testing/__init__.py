"""Tests for any Drake system or diagram: assertions that say what is wrong, and a pytest plugin with fixtures.

The names are imported when they are used, so that starting pytest with the plugin installed does not import Drake.
"""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
