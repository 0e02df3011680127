"""Batches: n scalar loops side by side inside one block; element i uses element i of every port, state and parameter.

The equations are written once, with operators that mean the same on floats and on arrays. With n = 1 they get floats,
as numpy takes ten times longer for single numbers. Each batch element equals the same loop run alone, bit for bit. In
blocks made of one of Drake's linear systems it does so to rounding (1e-12), and there a NaN of one element reaches the
others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.block import BlockCache, PythonBlock
from forcectl.framework.fields import interval

BatchValue = Any  # a float when the batch has one element, else an array of shape (n,)

# Largest batch for which a loop over floats is faster than numpy; measured.
SMALL_BATCH = 8

# Functions that operators cannot express, for floats; for arrays numpy has the same names and results.
SCALAR_MATH: Any = SimpleNamespace(
    maximum=max,
    minimum=min,
    copysign=math.copysign,
    sqrt=math.sqrt,
    floor=lambda v: v // 1.0 if math.isfinite(v) else v,
    where=lambda condition, a, b: a if condition else b,
)


@dataclass(frozen=True)
class BatchParameter:
    """A numeric parameter in the Context with a value for each batch element.

    Attributes:
        value: one number for all elements, or shape (n,).
        allowed: bounds as in `Key`. Infinity is allowed unless they say "finite"; "a number" allows any.
        unit: unit, for documentation and graphs.
    """

    value: ArrayLike
    allowed: str = "finite"
    unit: str = ""


def batch_values(name: str, value: ArrayLike, size: int, allowed: str = "finite") -> Array:
    """`value` as an array of shape (size,), checked.

    Raises:
        BadInputError: wrong length, not a number, or outside the bounds.
    """
    check_count("size", size)
    if value is None or isinstance(value, bool):
        raise invalid(name, value, "a number or a list of numbers")
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise invalid(name, value, "a number or a list of numbers") from None
    if array.ndim > 1 or array.size not in (1, size):
        raise BadInputError(f" has shape {array.shape}: must be one number or shape ({size},)", key=name)
    array = np.broadcast_to(array.ravel(), size).astype(float)
    # Infinity means "no limit" and is allowed where the bounds only fix a sign; NaN never is.
    if np.isnan(array).any() or not interval(allowed).holds(array).all():
        raise invalid(name, array.tolist() if size > 1 else float(array[0]), allowed)
    return array


def check(name: str, value: float, allowed: str = "finite") -> float:
    """`value` as a finite float when it is "positive", "not negative" or "finite", else BadInputError."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise invalid(name, value, "a finite number")
    return float(batch_values(name, value, 1, allowed)[0])


def check_count(name: str, value: int) -> int:
    """`value` as a whole number of at least 1, else BadInputError."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise invalid(name, value, "a whole number, at least 1")
    return int(value)


def whole_multiple(name: str, value: float, period: float, period_name: str) -> int:
    """`value` as a multiple of `period`; BadInputError if it is not zero or a whole multiple."""
    ratio = check(name, value) / period
    if not (value >= 0 and math.isfinite(ratio) and abs(ratio - round(ratio)) <= 1e-6):
        raise invalid(name, value, f"zero or a whole multiple of {period_name} = {period:g}")
    return round(ratio)


def check_order(lower: str, upper: str, values: Mapping[str, Array]) -> None:
    """BadInputError unless `lower` is at most `upper` in every batch element."""
    if np.any(values[lower] > values[upper]):
        raise invalid(lower, values[lower].tolist(), f"at most {upper} = {values[upper].tolist()}")


class BatchBlock(PythonBlock):
    """A LeafSystem of a batch of n loops with named parameters in the Context.

    `parameter_names` and `parameter_units` name the numeric parameters for graphs and tools.
    """

    parameter_names: Sequence[str] = ()
    parameter_units: Mapping[str, str] = {}
    # Whether the equations need arrays even for one batch element.
    on_arrays = False

    def __init__(self, size: int, parameters: Mapping[str, BatchParameter]):
        super().__init__()
        self._size = size = check_count("size", size)
        self._shape: tuple[int, ...] = (size,) if size > 1 or self.on_arrays else ()
        self.math = np if self._shape else SCALAR_MATH
        self._allowed = {name: p.allowed for name, p in parameters.items()}
        initial = {name: self._checked(name, p.value) for name, p in parameters.items()}
        self.check_together(initial)
        self._index = {name: self.DeclareNumericParameter(BasicVector(value)) for name, value in initial.items()}
        self.parameter_names = tuple(parameters)
        self.parameter_units = {name: p.unit for name, p in parameters.items()}
        values = BlockCache(
            self,
            "parameter values",
            lambda: Value[object](()),
            lambda block, context, value: block._collect(context, value),
            {self.all_parameters_ticket()},
        )
        # The result of `derive` for the parameters in this block's context.
        self.values: Callable[[Context], Any] = values.Eval

    @property
    def size(self) -> int:
        """Number of batch elements."""
        return self._size

    def set_parameter(self, context: Context, name: str, value: ArrayLike) -> None:
        """Set a parameter in this block's context, checked like at construction."""
        index = self._find(name)
        checked = self._checked(name, value)
        self.check_together({n: self.parameter(context, n) for n in self._index} | {name: checked})
        context.get_mutable_numeric_parameter(index).SetFromVector(checked)

    def parameter(self, context: Context, name: str) -> Array:
        """The value of a parameter in this block's context, shape (n,)."""
        return context.get_numeric_parameter(self._find(name)).CopyToVector()

    def check_together(self, values: Mapping[str, Array]) -> None:
        """Raise BadInputError when parameters contradict each other; no check by default."""

    def _checked(self, name: str, value: ArrayLike) -> Array:
        return batch_values(f"{type(self).__name__}.{name}", value, self._size, self._allowed[name])

    def _find(self, name: str) -> int:
        if name not in self._index:
            raise unknown(f"parameter of {type(self).__name__}", name, self._index)
        return self._index[name]

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """Quantities that the equations need, from the parameters; computed once per change, not per tick."""
        return values

    def _collect(self, context: Context, value: AbstractValue) -> None:
        values = tuple(self.batch_value(context.get_numeric_parameter(i).CopyToVector()) for i in self._index.values())
        value.set_value(self.derive(values))

    def choose(self, condition: BatchValue, new: dict[str, Any], old: Mapping[str, Any]) -> dict[str, Any]:
        """By name: the new batch values where the condition holds, the old ones elsewhere."""
        if self._shape:
            return {name: np.where(condition, value, old[name]) for name, value in new.items()}
        return new if condition else {name: old[name] for name in new}

    def batch_value(self, vector: Array) -> BatchValue:
        """A vector of shape (n,) in the form that the equations use: a float for one element, else an array."""
        return vector if self._shape else vector.item()

    def unstack(self, vector: Array) -> Any:
        """A stacked vector of shape (k n,) as k batch values."""
        return vector.reshape(-1, self._size) if self._shape else vector.tolist()

    def write(self, vector: BasicVector, value: BatchValue) -> None:
        """Write one batch value into a vector of shape (n,)."""
        if self._shape:
            vector.SetFromVector(value)
        else:
            vector.SetAtIndex(0, value)

    def stack(self, *values: BatchValue) -> Array:
        """k batch values as one vector of shape (k n,)."""
        return np.concatenate(values) if self._shape else np.array(values)
