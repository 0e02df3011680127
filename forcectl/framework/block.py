"""Bases of blocks and diagrams that are written in Python, and freed when nothing uses them any more.

Python's garbage collector frees a diagram when it sees all that leads to it. The bindings of Drake for Python 3.11 hide
two things from it, see docs/upstream/drake_python_311_leak.md:

- A class written in Python gives its instances a dictionary, which these bindings visit a second time as their own. The
  collector counts twice what is in it. With empty `__slots__` there is only one dictionary, that of the bindings.
- An output port keeps the function it calls. A method bound to the block would keep the block.

Whatever the bindings, a `CacheEntry` keeps its block, and Drake what an entry calls. A block that stores its own entry,
or gives it a bound method, is never freed: hence `BlockCache`.
"""

from __future__ import annotations

from collections.abc import Callable
from types import MethodType
from typing import Any
from weakref import ref

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, Diagram, LeafSystem, OutputPort, System, ValueProducer

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


class BlockCache:
    """A cache entry of `block`, which the block may store.

    Args:
        allocate: makes the value.
        calc: computes it, called with the block, its context and the value; a plain function, not a method bound to the
            block.
        prerequisites: tickets the value depends on.
    """

    def __init__(
        self,
        block: LeafSystem,
        name: str,
        allocate: Callable[[], AbstractValue],
        calc: Callable[[Any, Context, AbstractValue], None],
        prerequisites: set[Any],
    ):
        self._block: Any = ref(block)
        weak = self._block
        entry = block.DeclareCacheEntry(
            name,
            ValueProducer(allocate=allocate, calc=lambda context, value: calc(weak(), context, value)),
            prerequisites_of_calc=prerequisites,
        )
        self._index, self._ticket = entry.cache_index(), entry.ticket()

    def ticket(self) -> Any:
        """The dependency ticket of the value."""
        return self._ticket

    def Eval(self, context: Context) -> Any:
        """The value in this block's context, brought up to date."""
        return self._block().get_cache_entry(self._index).Eval(context)


def scratch(block: LeafSystem, name: str, make: Callable[[], Any]) -> BlockCache:
    """A place to work in, made by `make` at the first use of a context of `block`, and overwritten at every use.

    Not with the context: Drake allocates one of a block for every question about its feedthrough, and copies it.
    """
    nothing = {block.nothing_ticket()}
    return BlockCache(
        block, name, lambda: Value[object](()), lambda owner, context, value: value.set_value(make()), nothing
    )


def values_of_tick(block: LeafSystem, prerequisites: set[Any]) -> BlockCache:
    """What `block._compute(context)` returns, computed once while the prerequisites stay the same."""
    return BlockCache(
        block,
        "values of this tick",
        lambda: Value[object](()),
        lambda owner, context, value: value.set_value(owner._compute(context)),
        prerequisites,
    )


def of_ports(system: System, attribute: str) -> dict[str, Any]:
    """What a block, or the blocks inside a diagram, say of ports by name in an attribute; outer blocks win."""
    inner = system.GetSystems() if isinstance(system, Diagram) else []
    found: dict[str, Any] = {}
    for block in inner:
        found |= of_ports(block, attribute)
    return found | getattr(system, attribute, {})
