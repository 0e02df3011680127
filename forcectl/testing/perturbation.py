"""A test run once for each combination of perturbed parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from forcectl.errors import BadInputError, invalid


def perturb(**values: Iterable[Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Run a test for all combinations of values of its arguments::

        @perturb(stiffness=[1e3, 1e5], seed=range(5))
        def test_robust(stiffness, seed): ...

    The tests are named after the values, `test_robust[stiffness=1000-seed=0]`.

    Args:
        values: by the name of the argument.

    Raises:
        BadInputError: there is no argument, or one without values.
    """
    if not values:
        raise BadInputError("perturb: must have an argument with values, as in perturb(seed=range(5))")
    lists = {}
    for name, each in values.items():
        if isinstance(each, str) or not isinstance(each, Iterable):
            raise invalid(f"perturb({name})", each, "several values, such as [1e3, 1e5] or range(5)")
        lists[name] = list(each)
        if not lists[name]:
            raise invalid(f"perturb({name})", lists[name], "at least one value")

    def decorate(test: Callable[..., Any]) -> Callable[..., Any]:
        for name, each in lists.items():  # pytest names the parameters of the innermost first
            test = pytest.mark.parametrize(name, each, ids=[f"{name}={_short(value)}" for value in each])(test)
        return test

    return decorate


def _short(value: Any) -> str:
    """A number or a word as it is, of anything else its type; pytest numbers those that are equal."""
    if isinstance(value, float):
        return f"{value:g}"
    return str(value) if isinstance(value, int | str | None) else type(value).__name__
