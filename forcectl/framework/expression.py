"""Conditions and numbers as text, such as `overshoot_pct <= 5 and peak_force_N < 20` or `abs(touch.force_z) > 1`.

Names may contain dots. Allowed are numbers, the operators `+ - * / **`, comparisons, and, or, not, parentheses and the
functions `abs`, `min` and `max`; nothing else can be called.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, product
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
# Functions, with the smallest and the largest number of their arguments.
_FUNCTIONS: dict[str, tuple[Callable[..., Any], int, float]] = {
    "abs": (abs, 1, 1),
    "min": (min, 2, math.inf),
    "max": (max, 2, math.inf),
}
_OPPOSITE: dict[type, type[ast.cmpop]] = {ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt}
_ANY = (-math.inf, math.inf)
_SHOWN = 12  # number of known names in a message about an unknown one


class _UndefinedError(Exception):
    """A value that the expression needs is missing."""


class Expression:
    """An expression over named values.

    Args:
        text: the expression, as written.
        key: its dotted key, for messages.
        example: a valid expression for that key, for messages.

    Attributes:
        text: the expression, as written.
        names: names that it needs, in order of appearance.
        texts: texts that it compares with, such as wood in `material == 'wood'`.

    Raises:
        BadInputError: it is no such expression.
    """

    def __init__(self, text: str, key: str = "expression", example: str = "overshoot_pct <= 5 and peak_force_N < 20"):
        self.text = text
        self._key, self._example = key, example
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise invalid(key, text, f"an expression such as {example}") from None
        self.names = list(dict.fromkeys(self._names(self._tree)))
        constants = [node.value for node in ast.walk(self._tree) if isinstance(node, ast.Constant)]
        self.texts = [value for value in constants if isinstance(value, str)]

    def check_names(self, known: Iterable[str], kind: str) -> None:
        """Raise BadInputError for a name that is not among the known ones.

        Args:
            known: all known names.
            kind: what they stand for, for the message.
        """
        names = list(known)
        for name in self.names:
            if name not in names:
                raise unknown(kind, name, names, _SHOWN).at(self._key)

    def check_condition(self) -> None:
        """Raise BadInputError unless the expression is a condition that can be both true and false.

        Every part of it must be a comparison with a name in it, and terms without names must be numbers.
        """
        for part in _parts_of_condition(self._tree):
            shown = "" if part is self._tree else f": {ast.unparse(part)!r}"
            if not isinstance(part, ast.Compare) or not any(map(_dotted, ast.walk(part))):
                wanted = f"a comparison of a name, such as {self._example.partition(' and ')[0]}"
                raise BadInputError(f" = {self.text!r}{shown}: must be {wanted}", key=self._key)
            for term in (part.left, *part.comparators):
                if any(self._names(term)):
                    continue
                value = self._value_or_none(term, {})
                if value is None or value in (math.inf, -math.inf):
                    raise BadInputError(f" = {self.text!r}: {ast.unparse(term)!r} must be a number", key=self._key)
        for node in ast.walk(self._tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div) and _range(node.right, {}) == (0.0, 0.0):
                raise BadInputError(f" = {self.text!r}: {ast.unparse(node)!r} has no value", key=self._key)
        denied = self._limits(_denied(self._tree))
        for limits, so in (
            (self.limits(), "true for no {}: must be possible"),
            (denied, "true for every {}: must not be"),
        ):
            for side in (side for side, (low, high) in limits.items() if low > high):
                raise BadInputError(f" = {self.text!r}: {so.format(side)}", key=self._key)
        self.check_open({}, {})

    def check_open(
        self, true_within: Mapping[str, tuple[float, float]], false_within: Mapping[str, tuple[float, float]]
    ) -> None:
        """Raise BadInputError for a comparison with the same result for all values.

        Args:
            true_within: lowest and highest value by name; no comparison may be true for all values in these ranges.
            false_within: the same, but for comparisons that are false for all values.
        """
        for ranges, refused in ((true_within, True), (false_within, False)):
            for part, holds in self.settled(ranges):
                if holds == refused:
                    shown = "" if part == self.text.strip() else f": {part!r}"
                    text = f" = {self.text!r}{shown} is always {str(holds).lower()}: must depend on the values"
                    raise BadInputError(text, key=self._key)

    def limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value at which the condition can hold, for each term that is compared with numbers.

        Terms are keys as written, such as abs(touch.force_z). Parts inside `or` and `not` are not considered.
        """
        return self._limits(self._tree)

    def covers(self, other: Expression) -> bool:
        """Whether this condition certainly holds where another one does; True only if it consists of limits alone."""
        limits, others = self.limits(), other.limits()
        whole = bool(limits) and sum(map(_plain, _joined(self._tree))) == len(list(_parts_of_condition(self._tree)))
        pairs = [(limits[side], others.get(side, _ANY)) for side in limits]
        return whole and all(low <= least and most <= high for (low, high), (least, most) in pairs)

    def _limits(self, tree: ast.expr) -> dict[str, tuple[float, float]]:
        found: dict[str, tuple[float, float]] = {}
        for part in _joined(tree):
            terms = [part.left, *part.comparators]
            for op, (left, right) in zip(part.ops, pairwise(terms), strict=True):
                for side, other, mirrored in ((left, right, False), (right, left, True)):
                    number = None if any(self._names(other)) else self._value_or_none(other, {})
                    if isinstance(number, float) and any(self._names(side)):
                        name = ast.unparse(side)
                        low, high = found.get(name, _range(side, {}) if isinstance(side, ast.Call) else _ANY)
                        least, most = _held(type(op), number, mirrored)
                        found[name] = max(low, least), min(high, most)
        return found

    def settled(self, ranges: Mapping[str, tuple[float, float]]) -> Iterator[tuple[str, bool]]:
        """Comparisons, as written, with the same result for all values, and that result.

        Args:
            ranges: lowest and highest value by name; a name without a range may have any value.
        """
        for part in _parts_of_condition(self._tree):
            if len(found := _outcomes(part, ranges)) == 1:
                yield ast.unparse(part), found.pop()

    def always_holds(self, ranges: Mapping[str, tuple[float, float]]) -> bool:
        """Whether the whole condition holds for all values within ranges, see `settled`."""
        return _outcomes(self._tree, ranges) == {True}

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """The value of the expression with `values` by name; None where it is undefined.

        It is undefined when a value that it needs is None, after a division by zero, and for a root of a negative
        number. In `and` and `or` an undefined part counts only where no other part decides.
        """
        return self._value_or_none(self._tree, values)

    def deciding_value(self, values: Mapping[str, Any]) -> Any:
        """The value that decides whether the condition holds; None where it is undefined.

        For a comparison it is its first term with a name in it. For `and` the first part counts, for `or` the first
        part that holds, or else the first. For an expression without a comparison it is its value.

        Args:
            values: values by name.
        """
        return self._value_or_none(self._deciding(self._tree, values), values)

    def _value_or_none(self, node: ast.expr, values: Mapping[str, Any]) -> Any:
        try:
            return self._value(node, values)
        except (_UndefinedError, ZeroDivisionError, OverflowError):
            return None

    def _deciding(self, node: ast.expr, values: Mapping[str, Any]) -> ast.expr:
        if isinstance(node, ast.BoolOp):
            holds = (part for part in node.values if self._value_or_none(part, values))
            chosen = next(holds, node.values[0]) if isinstance(node.op, ast.Or) else node.values[0]
            return self._deciding(chosen, values)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return self._deciding(node.operand, values)
        if isinstance(node, ast.Compare):
            terms = [node.left, *node.comparators]
            return next((term for term in terms if any(self._names(term))), node.left)
        return node

    def _names(self, node: ast.AST) -> Iterable[str]:
        name = _dotted(node)
        if name:
            yield name
            return
        if isinstance(node, ast.Constant):
            if not isinstance(node.value, int | float | str):
                raise invalid(self._key, self.text, "of numbers and names")
            return
        if isinstance(node, ast.Call):
            yield from self._names_in_call(node)
            return
        parts = [part for part in ast.iter_child_nodes(node) if not isinstance(part, ast.expr_context)]
        operators = [part for part in parts if isinstance(part, ast.operator | ast.unaryop | ast.cmpop)]
        expressions = isinstance(node, ast.BoolOp | ast.BinOp | ast.UnaryOp | ast.Compare)
        if not expressions or any(type(part) not in _OPERATORS for part in operators):
            raise self._misplaced(node)
        for part in parts:
            if isinstance(part, ast.expr):
                yield from self._names(part)

    def _names_in_call(self, node: ast.Call) -> Iterable[str]:
        name = _dotted(node.func)
        if name not in _FUNCTIONS or node.keywords:
            raise self._misplaced(node)
        _, fewest, most = _FUNCTIONS[name]
        if not fewest <= len(node.args) <= most:
            wanted = "one value" if most == 1 else "two values or more"
            raise BadInputError(f" = {self.text!r}: {name}() must be of {wanted}", key=self._key)
        for part in node.args:
            yield from self._names(part)

    def _misplaced(self, node: ast.AST) -> BadInputError:
        allowed = f"names, numbers, + - * / **, comparisons, and, or, not, {', '.join(_FUNCTIONS)}"
        fault = f" = {self.text!r}: {ast.unparse(node)!r} cannot stand here: must be of {allowed}"
        return BadInputError(fault, key=self._key)

    def _value(self, node: ast.expr, values: Mapping[str, Any]) -> Any:
        if name := _dotted(node):
            if values.get(name) is None:
                raise _UndefinedError
            return values[name]
        if isinstance(node, ast.Constant):
            # Numbers are floats, so that a large power overflows instead of becoming an integer with many digits.
            return float(node.value) if isinstance(node.value, int | float) else node.value
        if isinstance(node, ast.BoolOp):
            decides, parts = isinstance(node.op, ast.Or), [self._value_or_none(part, values) for part in node.values]
            found = decides in [bool(part) for part in parts if part is not None]
            if None in parts and not found:
                raise _UndefinedError
            return found == decides
        if isinstance(node, ast.UnaryOp | ast.BinOp):
            sides = [node.operand] if isinstance(node, ast.UnaryOp) else [node.left, node.right]
            return self._apply(_OPERATORS[type(node.op)], *(self._value(side, values) for side in sides))
        if isinstance(node, ast.Call):
            terms = [self._value(part, values) for part in node.args]
            return self._apply(_FUNCTIONS[_dotted(node.func)][0], *terms)
        assert isinstance(node, ast.Compare)
        terms = [self._value(part, values) for part in (node.left, *node.comparators)]
        operators = [_OPERATORS[type(op)] for op in node.ops]
        return all(self._apply(op, *pair) for op, pair in zip(operators, pairwise(terms), strict=True))

    def _apply(self, function: Callable[..., Any], *terms: Any) -> Any:
        try:
            value = function(*terms)
        except TypeError:
            shown = " and ".join(repr(term) for term in terms)
            raise BadInputError(f" = {self.text!r}: cannot be worked out with {shown}", key=self._key) from None
        if isinstance(value, complex):  # a root of a negative number
            raise _UndefinedError
        return value


def _parts_of_condition(node: ast.expr) -> Iterable[ast.expr]:
    """The operands of `and`, `or` and `not`, down to parts without them."""
    inner = node.values if isinstance(node, ast.BoolOp) else [node.operand] if isinstance(node, ast.UnaryOp) else []
    if not inner or (isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.Not)):
        yield node
        return
    for part in inner:
        yield from _parts_of_condition(part)


def _joined(node: ast.expr) -> Iterable[ast.Compare]:
    """The comparisons that must all hold: one alone, or those joined by `and`."""
    if isinstance(node, ast.Compare):
        yield node
    elif isinstance(node, ast.BoolOp) and isinstance(node.op, ast.And):
        for part in node.values:
            yield from _joined(part)


def _plain(part: ast.Compare) -> bool:
    """Whether it is one comparison of a term with a number, other than !=."""
    (op, *more), sides = part.ops, (part.left, *part.comparators)
    return not more and not isinstance(op, ast.NotEq) and any(not any(map(_dotted, ast.walk(side))) for side in sides)


def _denied(node: ast.expr) -> ast.expr:
    """The negation of an `or` of comparisons, as an `and` of the opposite ones; empty for other conditions."""
    parts = node.values if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or) else []
    plain = [part for part in parts if isinstance(part, ast.Compare) and _plain(part)]
    turned = [ast.Compare(one.left, [_OPPOSITE.get(type(one.ops[0]), ast.NotEq)()], one.comparators) for one in plain]
    return ast.BoolOp(ast.And(), [*turned])


def _held(op: type, number: float, mirrored: bool) -> tuple[float, float]:
    """Lowest and highest x for which `x op number` holds; mirrored: `number op x`."""
    if op is ast.Eq:
        return number, number
    if op is ast.NotEq:
        return -math.inf, math.inf
    toward = math.inf if (op in (ast.Gt, ast.GtE)) != mirrored else -math.inf
    bound = math.nextafter(number, toward) if op in (ast.Gt, ast.Lt) else number
    return (bound, math.inf) if toward > 0 else (-math.inf, bound)


def _outcomes(node: ast.expr, ranges: Mapping[str, tuple[float, float]]) -> set[bool]:
    """Possible results of a condition for values within ranges."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return {not each for each in _outcomes(node.operand, ranges)}
    if isinstance(node, ast.BoolOp):
        return _all_or_any([_outcomes(part, ranges) for part in node.values], isinstance(node.op, ast.And))
    if not isinstance(node, ast.Compare):
        return {True, False}
    pairs = zip(node.ops, pairwise([node.left, *node.comparators]), strict=True)
    return _all_or_any([_pair_outcomes(type(op), *pair, ranges) for op, pair in pairs], True)


def _pair_outcomes(op: type, left: ast.expr, right: ast.expr, ranges: Mapping[str, tuple[float, float]]) -> set[bool]:
    if ast.dump(left) == ast.dump(right):
        return {op in (ast.Eq, ast.LtE, ast.GtE)}
    return _compared(op, _range(left, ranges), _range(right, ranges))


def _all_or_any(outcomes: Sequence[set[bool]], by_and: bool) -> set[bool]:
    """Possible results of parts joined by `and` (true where all are), or by `or` (false where all are)."""
    return {each for each, enough in ((by_and, all), (not by_and, any)) if enough(each in one for one in outcomes)}


def _compared(op: type, left: tuple[float, float], right: tuple[float, float]) -> set[bool]:
    """Possible results of a comparison of two numbers within ranges."""
    if op in (ast.Gt, ast.GtE):
        return _compared(ast.Lt if op is ast.Gt else ast.LtE, right, left)
    if op is ast.NotEq:
        return {not each for each in _compared(ast.Eq, left, right)}
    if op is ast.Eq:
        if left[1] < right[0] or right[1] < left[0]:
            return {False}
        return {True} if left[0] == left[1] == right[0] == right[1] else {True, False}
    compare = _OPERATORS[op]
    surely, possibly = compare(left[1], right[0]), compare(left[0], right[1])
    return {True} if surely else {True, False} if possibly else {False}


def _range(node: ast.expr, ranges: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    """Lowest and highest value of a term for values within ranges; unlimited for terms that are not analysed."""
    if name := _dotted(node):
        return ranges.get(name, _ANY)
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return float(node.value), float(node.value)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        low, high = _range(node.operand, ranges)
        return -high, -low
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
        if isinstance(node.op, ast.Sub) and ast.dump(node.left) == ast.dump(node.right):
            return 0.0, 0.0
        pairs = product(_range(node.left, ranges), _range(node.right, ranges))
        ends = [_OPERATORS[type(node.op)](*pair) for pair in pairs]
        return _ANY if any(map(math.isnan, ends)) else (min(ends), max(ends))
    if isinstance(node, ast.Call):
        inner = [_range(part, ranges) for part in node.args]
        if _dotted(node.func) == "abs":
            low, high = inner[0]
            return max(low, -high, 0.0), max(-low, high)
        choose = min if _dotted(node.func) == "min" else max
        return choose(low for low, _ in inner), choose(high for _, high in inner)
    return _ANY


def _dotted(node: ast.AST) -> str:
    """The dotted name of a node, "" for anything else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        base = _dotted(node.value)
        return f"{base}.{node.attr}" if base else ""
    return ""
