import pytest

from forcectl.errors import BadInputError
from forcectl.sweeps.expression import Expression

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
        ("a / (b.c - 3)", None),
        ("10 ** 10 ** 10", None),
    ],
)
def test_values(text, value):
    assert Expression(text)(VALUES) == value


def test_names_in_order_of_appearance():
    assert Expression("b.c > 1 and a + b.c < 4").names == ["b.c", "a"]


@pytest.mark.parametrize(
    "text",
    ["", "a <", "import os", "open('x')", "a[0]", "lambda: a", "a.b()", "[a]", "a if a else a", "a and", "a := 2",
     "b'x' == a", "a in name", "(" * 300, "None", "a % 2", "__import__('os')", "f'{a}'"],
)  # fmt: skip
def test_nothing_but_numbers_names_and_comparisons(text):
    with pytest.raises(BadInputError, match="success") as error:
        Expression(text, "success")
    assert "\n" not in str(error.value)


def test_terms_that_do_not_go_together_are_told():
    with pytest.raises(BadInputError, match=r"success = 'name < 3': cannot be worked out with 'wood' and 3.0"):
        Expression("name < 3", "success")(VALUES)


def test_a_name_that_is_not_known_is_told_with_the_nearest():
    with pytest.raises(BadInputError, match=r"constraints.0: unknown varied key 'stifness': did you mean 'stiffness'"):
        Expression("stifness > 1", "constraints.0").check_names(["stiffness"], "varied key")
