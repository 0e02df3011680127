import math
import re

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.expression import Expression

VALUES = {"a": 2.0, "b.c": 3.0, "none": None, "name": "wood", "yes": True}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a < b.c", True),
        ("1 < a < b.c <= 3", True),
        ("1 < a < b.c < 3", False),
        ("a * b.c - 1", 5.0),
        ("-a ** 2", -4.0),
        ("a > 3 or not b.c == 2", True),
        ("name == 'wood' and yes", True),
        ("(a + b.c) / 2 >= 2.5", True),
        ("none > 1", None),
        ("a > 1 or none > 1", True),
        ("none > 1 or a > 1", True),
        ("none > 1 or a > 5", None),
        ("none > 1 and a > 1", None),
        ("none > 1 and a > 5", False),
        ("not (none > 1 and a > 5)", True),
        ("a / (b.c - 3)", None),
        ("10 ** 10 ** 10", None),
        ("(a - b.c) ** 0.5 > 0", None),
        ("abs(a - b.c) + min(a, b.c, 7) * max(-a, -b.c)", -3.0),
        ("abs(none) > 1", None),
        ("max(a, b.c) == b.c", True),
    ],
)
def test_values(text, value):
    assert Expression(text)(VALUES) == value


def test_names_in_order_of_appearance():
    assert Expression("b.c > 1 and a + b.c < 4").names == ["b.c", "a"]


@pytest.mark.parametrize(
    "text",
    ["", "a <", "import os", "open('x')", "a[0]", "lambda: a", "a.b()", "[a]", "a if a else a", "a and", "a := 2",
     "b'x' == a", "a in name", "(" * 300, "None", "a % 2", "__import__('os')", "f'{a}'", "abs(a, a)", "abs()",
     "min(a)", "max(*a)", "min(a, key=a)", "a.abs(a)", "sum(a, a)", "max(a, open('x'))"],
)  # fmt: skip
def test_nothing_but_numbers_names_and_comparisons(text):
    with pytest.raises(BadInputError, match="success") as error:
        Expression(text, "success")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + 1 > 0.5", 3.0),
        ("0.5 < abs(-a) < b.c", 2.0),
        ("b.c > 2 and a > 1", 3.0),
        ("b.c > 5 or a > 1", 2.0),
        ("not (b.c > 5 or a > 3)", 3.0),
        ("yes", True),
        ("3 > 2", 3.0),
        ("none > 1", None),
    ],
)
def test_the_value_that_decides(text, value):
    assert Expression(text).deciding_value(VALUES) == value


def test_texts_that_are_compared_with():
    assert Expression("name == 'wood' and a > 1").texts == ["wood"]


def test_terms_that_do_not_go_together_are_told():
    with pytest.raises(BadInputError, match=r"success = 'name < 3': cannot be worked out with 'wood' and 3.0"):
        Expression("name < 3", "success")(VALUES)


def test_a_name_that_is_not_known_is_told_with_the_nearest():
    with pytest.raises(BadInputError, match=r"constraints.0: unknown varied key 'stifness': did you mean 'stiffness'"):
        Expression("stifness > 1", "constraints.0").check_names(["stiffness"], "varied key")
    with pytest.raises(BadInputError, match=r"did you mean 'key_7'. known: key_7, .* and 88 more$"):
        Expression("ky_7 > 1").check_names([f"key_{i}" for i in range(100)], "key")


@pytest.mark.parametrize(
    ("text", "limits"),
    [
        ("a > 1 and a < 3", {"a": (math.nextafter(1, 2), math.nextafter(3, 2))}),
        ("1 <= a <= 3", {"a": (1.0, 3.0)}),
        ("3 > a and b.c == 2", {"a": (-math.inf, math.nextafter(3, 2)), "b.c": (2.0, 2.0)}),
        ("abs(a) < 1 and a != 0", {"abs(a)": (0.0, math.nextafter(1, 0)), "a": (-math.inf, math.inf)}),
        ("abs(a) - 5 < -3", {"abs(a) - 5": (-math.inf, math.nextafter(-3, -4))}),
        ("abs(a) - abs(b) < -1", {"abs(a) - abs(b)": (-math.inf, math.nextafter(-1, -2))}),
        ("a > 2 * 3 and a < b", {"a": (math.nextafter(6, 7), math.inf)}),
        ("a > 1 or a < 0", {}),
        ("not (a > 1)", {}),
    ],
)
def test_between_which_values_a_condition_can_hold(text, limits):
    assert Expression(text).limits() == limits


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a > 2 and 1 > a", "true for no a: must be possible"),
        ("a < 1 and a > 1", "true for no a: must be possible"),
        ("2 < a < 1", "true for no a: must be possible"),
        ("a > 1 and b < 1 / 0", "'1 / 0' must be a number"),
        ("a > (-1) ** 0.5", "must be a number"),
    ],
)
def test_a_condition_that_cannot_hold_is_refused(text, told):
    with pytest.raises(BadInputError, match=re.escape(told)):
        Expression(text, "success").check_condition()
    Expression("a >= 1 and a <= 1 and b == 'wood'").check_condition()
    Expression("abs(a) - abs(b) < -1").check_condition()


RANGES = {"a": (0.0, 1.0), "b": (2.0, 3.0)}


@pytest.mark.parametrize(
    ("text", "settled"),
    [
        ("a < 1", []),
        ("a <= 1", [("a <= 1", True)]),
        ("a > 1", [("a > 1", False)]),
        ("a == 2", [("a == 2", False)]),
        ("a != 2", [("a != 2", True)]),
        ("-1 < a < 5", [("-1 < a < 5", True)]),
        ("a + b >= 2", [("a + b >= 2", True)]),
        ("a - b > 0", [("a - b > 0", False)]),
        ("-a * b > -3.5", [("-a * b > -3.5", True)]),
        ("abs(a - 2) < 1", [("abs(a - 2) < 1", False)]),
        ("min(a, x) > 1 or max(b, x) >= 2", [("min(a, x) > 1", False), ("max(b, x) >= 2", True)]),
        ("not (a < 5) and x > 0", [("a < 5", True)]),
        ("b / a > -1 and x * a > -1 and a ** 2 > -1 and a == 'wood'", []),
    ],
)
def test_comparisons_that_no_value_changes(text, settled):
    assert list(Expression(text).settled(RANGES)) == settled


def test_a_condition_that_always_holds():
    assert Expression("a < 0.5 or b > 1").always_holds(RANGES)
    assert not Expression("a < 0.5 or b > 2").always_holds(RANGES)
    assert not Expression("a < 5 and x > 0").always_holds(RANGES)


def test_a_long_condition_is_settled_as_fast_as_a_short_one():
    text = " or ".join(f"s{i} > {i}" for i in range(60))
    condition = Expression(text)
    assert list(condition.settled({"s1": (0.0, 0.5)})) == [("s1 > 1", False)]
    assert condition.always_holds({"s0": (1.0, 2.0)})
    assert not condition.always_holds({})
