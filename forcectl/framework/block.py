"""Bases of blocks and diagrams that are written in Python, and freed when nothing uses them any more.

Python's garbage collector frees a diagram when it sees all that leads to it. The bindings of Drake for Python 3.11 hide
two things from it, see docs/upstream/drake_python_311_leak.md:

- A class written in Python gives its instances a dictionary, which these bindings visit a second time as their own. The
  collector counts twice what is in it. With empty `__slots__` there is only one dictionary, that of the bindings.
- An output port keeps the function it calls. A method bound to the block would keep the block.
"""

from __future__ import annotations

from types import MethodType
from typing import Any
from weakref import ref

from pydrake.systems.framework import Diagram, LeafSystem, OutputPort

_Type: Any = type(LeafSystem)

# The newer bindings free blocks as they are, and no type can be derived from theirs.
if _Type.__name__ == "pybind11_type":

    class _OneDictionary(_Type):
        """Type of a class with empty `__slots__`, and of all that are derived from it."""

        def __new__(cls, name: str, bases: tuple[type, ...], members: dict[str, Any]) -> Any:
            return super().__new__(cls, name, bases, {"__slots__": (), **members})

    _Type = _OneDictionary


class PythonBlock(LeafSystem, metaclass=_Type):
    """A LeafSystem that its output ports do not keep alive; declare them with methods as ever."""

    def DeclareVectorOutputPort(self, *args: Any, **named: Any) -> OutputPort:
        """As Drake's."""
        return super().DeclareVectorOutputPort(*map(_weak, args), **{name: _weak(each) for name, each in named.items()})

    def DeclareAbstractOutputPort(self, *args: Any, **named: Any) -> OutputPort:
        """As Drake's."""
        return super().DeclareAbstractOutputPort(
            *map(_weak, args), **{name: _weak(each) for name, each in named.items()}
        )


class PythonDiagram(Diagram, metaclass=_Type):
    """A Diagram that can be freed."""


def _weak(argument: Any) -> Any:
    """A bound method as a function that does not keep its block; anything else as it is."""
    if not isinstance(argument, MethodType):
        return argument
    block: Any = ref(argument.__self__)
    function = argument.__func__
    return lambda *args: function(block(), *args)
