"""Conditions and numbers as text in a sweep file, such as `overshoot_pct <= 5 and peak_force_N < 20`.

Names are dotted keys or metrics. There are numbers, the operators `+ - * / **`, comparisons, and, or, not,
parentheses: nothing that could call anything.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from typing import Any

from forcectl.errors import BadInputError, invalid, unknown

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


class _UndefinedError(Exception):
    """A value that the expression needs is not there."""


class Expression:
    """An expression over named values.

    Args:
        text: as written.
        key: of the sweep file, for messages.

    Attributes:
        text: as written.
        names: that it needs, in order of appearance.

    Raises:
        BadInputError: it is no expression of that kind.
    """

    def __init__(self, text: str, key: str = "expression"):
        self.text = text
        self._key = key
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise invalid(key, text, "an expression such as overshoot_pct <= 5 and peak_force_N < 20") from None
        self.names = list(dict.fromkeys(self._names(self._tree)))

    def check_names(self, known: Iterable[str], kind: str) -> None:
        """Raise BadInputError for a name that is not among the known ones.

        Args:
            known: names that there are.
            kind: what they are, for the message.
        """
        names = list(known)
        for name in self.names:
            if name not in names:
                raise unknown(kind, name, names).at(self._key)

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """The value of the expression; None where a value that it needs is None, or for a division by zero.

        Args:
            values: by name.
        """
        try:
            return self._value(self._tree, values)
        except (_UndefinedError, ZeroDivisionError, OverflowError):
            return None

    def _names(self, node: ast.AST) -> Iterable[str]:
        name = _dotted(node)
        if name:
            yield name
            return
        if isinstance(node, ast.Constant):
            if not isinstance(node.value, int | float | str):
                raise invalid(self._key, self.text, "of numbers and names")
            return
        parts = [part for part in ast.iter_child_nodes(node) if not isinstance(part, ast.expr_context)]
        operators = [part for part in parts if isinstance(part, ast.operator | ast.unaryop | ast.cmpop)]
        expressions = isinstance(node, ast.BoolOp | ast.BinOp | ast.UnaryOp | ast.Compare)
        if not expressions or any(type(part) not in _OPERATORS for part in operators):
            written = ast.unparse(node)
            raise BadInputError(
                f" = {self.text!r}: {written!r} cannot stand here: must be of names, numbers, + - * / **, comparisons, "
                "and, or, not",
                key=self._key,
            )
        for part in parts:
            if isinstance(part, ast.expr):
                yield from self._names(part)

    def _value(self, node: ast.expr, values: Mapping[str, Any]) -> Any:
        name = _dotted(node)
        if name:
            if values.get(name) is None:
                raise _UndefinedError
            return values[name]
        if isinstance(node, ast.Constant):
            # Numbers are real ones, so that a power ends as an overflow and not as a number of many digits.
            return float(node.value) if isinstance(node.value, int | float) else node.value
        if isinstance(node, ast.BoolOp):
            parts = (self._value(part, values) for part in node.values)
            return all(parts) if isinstance(node.op, ast.And) else any(parts)
        if isinstance(node, ast.UnaryOp):
            return self._apply(node.op, self._value(node.operand, values))
        if isinstance(node, ast.BinOp):
            return self._apply(node.op, self._value(node.left, values), self._value(node.right, values))
        assert isinstance(node, ast.Compare)
        terms = [self._value(part, values) for part in (node.left, *node.comparators)]
        return all(self._apply(op, *pair) for op, pair in zip(node.ops, pairwise(terms), strict=True))

    def _apply(self, op: ast.AST, *terms: Any) -> Any:
        try:
            return _OPERATORS[type(op)](*terms)
        except TypeError:
            shown = " and ".join(repr(term) for term in terms)
            raise BadInputError(f" = {self.text!r}: cannot be worked out with {shown}", key=self._key) from None


def _dotted(node: ast.AST) -> str:
    """The dotted name of a node, "" for anything else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        base = _dotted(node.value)
        return f"{base}.{node.attr}" if base else ""
    return ""
