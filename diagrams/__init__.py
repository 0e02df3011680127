"""Wiring: stations and closed loops put together from the library's blocks. No equations live here."""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
