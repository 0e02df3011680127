"""Check of units in an expression: terms that are added, subtracted or compared must have the same unit."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from itertools import pairwise

from forcectl.errors import BadInputError
from forcectl.framework.expression import Expression

_SAME = (ast.Add, ast.Sub)


def check_units(expression: Expression, unit_of: Callable[[str], str], key: str) -> None:
    """Refuse sums, differences and comparisons of names that have different units.

    Numbers, products, quotients and powers fit to any unit: in `2 * a < b` the number may have a unit.

    Args:
        expression: the expression.
        unit_of: gives the unit of a name; "" where it is unknown.
        key: dotted key of the expression, for the message.

    Raises:
        BadInputError: about the first of these.
    """
    for node in ast.walk(ast.parse(expression.text.strip(), mode="eval")):
        sides: Sequence[ast.expr] = ()
        if isinstance(node, ast.BinOp) and isinstance(node.op, _SAME):
            sides = (node.left, node.right)
        elif isinstance(node, ast.Compare):
            sides = (node.left, *node.comparators)
        elif isinstance(node, ast.Call):
            sides = node.args
        for left, right in pairwise(sides):
            units = [_unit(side, unit_of) for side in (left, right)]
            if all(units) and units[0] != units[1]:
                of_each = " and ".join(
                    f"{ast.unparse(side)!r} in {unit}" for side, unit in zip((left, right), units, strict=True)
                )
                raise BadInputError(f" = {expression.text!r}: {of_each}: must be of the same unit", key=key)


def _unit(node: ast.expr, unit_of: Callable[[str], str]) -> str:
    """Unit of a term; "" for any."""
    if isinstance(node, ast.Name | ast.Attribute):
        return unit_of(ast.unparse(node))
    if isinstance(node, ast.UnaryOp):
        return _unit(node.operand, unit_of)
    if isinstance(node, ast.BinOp) and isinstance(node.op, _SAME):
        return _unit(node.left, unit_of) or _unit(node.right, unit_of)
    if isinstance(node, ast.Call):
        return next(filter(None, (_unit(part, unit_of) for part in node.args)), "")
    return ""
