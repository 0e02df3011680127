"""Base classes of blocks and diagrams written in Python that are freed when nothing uses them any more.

Python's garbage collector can free a diagram only if it sees all references to it. The bindings of Drake for Python
3.11 hide two kinds of them, see docs/upstream/drake_python_311_leak.md:

- A class written in Python gives its instances a dictionary, which these bindings visit a second time as their own. The
  collector counts its entries twice. With empty `__slots__` there is only the dictionary of the bindings.
- An output port holds a reference to its function. A method bound to the block would keep the block alive.

With all bindings, a `CacheEntry` holds a reference to its block, and Drake one to the entry's function. A block that
stores its own entry, or passes a bound method to it, is never freed: hence `BlockCache`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MethodType
from typing import Any
from weakref import ref

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, Diagram, LeafSystem, OutputPort, System, ValueProducer

from forcectl.errors import BadInputError, show

_Type: Any = type(LeafSystem)

# Newer bindings free blocks without this, and their metaclass cannot be derived from.
if _Type.__name__ == "pybind11_type":

    class _OneDictionary(_Type):
        """Metaclass that gives a class, and all classes derived from it, empty `__slots__`."""

        def __new__(cls, name: str, bases: tuple[type, ...], members: dict[str, Any]) -> Any:
            return super().__new__(cls, name, bases, {"__slots__": (), **members})

    _Type = _OneDictionary


class PythonBlock(LeafSystem, metaclass=_Type):
    """A LeafSystem whose output ports do not keep it alive, although they are declared with bound methods."""

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
    """A bound method as a function with a weak reference to its block; anything else as it is."""
    if not isinstance(argument, MethodType):
        return argument
    block: Any = ref(argument.__self__)
    function = argument.__func__
    return lambda *args: function(block(), *args)


class BlockCache:
    """A cache entry of `block` that the block can store as an attribute without keeping itself alive.

    Args:
        allocate: allocates the value.
        calc: computes the value; called with the block, its context and the value. A plain function, not a method bound
            to the block.
        prerequisites: dependency tickets of the value.
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
        """The up-to-date value in this block's context."""
        return self._block().get_cache_entry(self._index).Eval(context)


def scratch(block: LeafSystem, name: str, make: Callable[[], Any]) -> BlockCache:
    """Work space of `block` in the Context, made by `make` at its first use, and overwritten at every use.

    It is not allocated with the context, as Drake allocates and copies contexts for every query of feedthrough.
    """
    nothing = {block.nothing_ticket()}
    return BlockCache(
        block, name, lambda: Value[object](()), lambda owner, context, value: value.set_value(make()), nothing
    )


def values_of_tick(block: LeafSystem, prerequisites: set[Any]) -> BlockCache:
    """The result of `block._compute(context)`, cached while the prerequisites stay the same."""
    return BlockCache(
        block,
        "values of this tick",
        lambda: Value[object](()),
        lambda owner, context, value: value.set_value(owner._compute(context)),
        prerequisites,
    )


def of_ports(system: System, attribute: str) -> dict[str, Any]:
    """Entries by port name of an attribute of a block, or of the blocks inside a diagram; outer blocks win."""
    inner = system.GetSystems() if isinstance(system, Diagram) else []
    found: dict[str, Any] = {}
    for block in inner:
        found |= of_ports(block, attribute)
    own = getattr(system, attribute, {})
    if not isinstance(own, Mapping):
        raise BadInputError(
            f"block {system.get_name()!r}: {attribute} = {show(own)}: must be a mapping of names of ports"
        )
    return found | dict(own)
