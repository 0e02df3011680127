"""Cache entries of Python blocks that do not keep their block alive.

Drake keeps what a cache entry calls, and a `CacheEntry` keeps its block, where Python's garbage collector cannot look:
a block that stores its own entry, or gives it a bound method, is never freed, and its diagram with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from weakref import ref

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, LeafSystem, ValueProducer


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
