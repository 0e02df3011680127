"""From trees to dataclasses without slots: what is missing is told at once, and arrays."""

import enum
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.framework.fields import Config, key
from forcectl.framework.reader import Reader, join
from forcectl.framework.yaml_tree import parse, place


@dataclass(kw_only=True)
class Part(Config):
    width: float = key(meaning="of it", unit="m", bounds="positive")
    height: float = key(meaning="of it", unit="m")
    name: str = key("x")
    reach: float = key(4.0, bounds="positive or infinite")


@dataclass(kw_only=True)
class Whole(Config):
    needed: int = key()
    values: np.ndarray = key(lambda: np.zeros(2), "two numbers")
    part: Part = key(meaning="one")
    parts: list[Part] = key([], "more")
    named: dict[str, Part] = key({}, "by name")
    given: Part = key(lambda: Part(width=1.0, height=2.0), "whole")


def read(text):
    tree = parse(text, "f.yaml")
    return Reader(lambda dotted: place("f.yaml", tree.lines, dotted)).dataclass(Whole, tree)


def refused(text):
    with pytest.raises(BadInputError) as caught:
        read(text)
    return str(caught.value)


def test_a_tree_becomes_the_dataclass_with_the_rest_of_its_defaults():
    whole = read("{needed: 1, values: [1, 2.5], part: {width: 1, height: 2}, given: {height: 5}}")
    np.testing.assert_array_equal(whole.values, [1.0, 2.5])
    assert whole.given == Part(width=1.0, height=5.0)


def test_null_leaves_a_named_part_out():
    whole = read("{needed: 1, part: {width: 1, height: 2}, named: {a: null, b: {width: 1, height: 2}}}")
    assert whole.named == {"b": Part(width=1.0, height=2.0)}
    assert refused("{needed: 1, part: null}").startswith("f.yaml:1: part = None: must be a mapping")


def test_all_that_is_missing_is_told_at_once_with_its_meaning():
    text = "parts:\n  - {width: 1, height: 2}\n  - {height: 2}\nnamed:\n  a: {width: 1}\npart:\n  width: 1\n"
    assert refused(text) == (
        "f.yaml: needed is missing: must be a whole number; "
        "part.height is missing: must be a number (of it [m]); "
        "parts.1.width is missing: must be a number (of it [m]); "
        "named.a.height is missing: must be a number (of it [m])"
    )


def test_a_number_may_be_infinite_where_its_bounds_say_so():
    assert read("{needed: 1, part: {width: 1, height: 2, reach: .inf}}").part.reach == math.inf
    assert refused("{needed: 1, part: {width: .inf, height: 2}}").endswith("part.width = inf: must be a finite number")


def test_a_misspelt_key_is_told_before_what_is_missing_for_it():
    message = refused("needed: 1\npart:\n  witdh: 1\n  height: 2\n")
    assert (
        message == "f.yaml:3: part.witdh: unknown key 'witdh': did you mean 'width'? known: width, height, name, reach"
    )


@pytest.mark.parametrize("values", ["3", "[1, a]", "[1, true]", "{a: 1}"])
def test_an_array_is_a_list_of_numbers(values):
    message = refused(f"needed: 1\npart: {{width: 1, height: 2}}\nvalues: {values}\n")
    assert message.startswith("f.yaml:3: values = ")
    assert message.endswith(": must be a list of numbers")


def test_a_check_of_the_class_is_told_with_the_line_of_its_key():
    message = refused("needed: 1\npart: {width: 1, height: 2}\nparts:\n- height: 1\n  width: 0\n")
    assert message == "f.yaml:5: parts.0.width = 0.0: must be positive"


def test_keys_are_joined_by_dots():
    assert (join("a", "b"), join("", "b"), join("a", ""), join("a", 3)) == ("a.b", "b", "a", "a.3")


class Wood(enum.Enum):
    OAK = 1
    ASH = 2


@dataclass(kw_only=True)
class Kinds:
    """The types that a class of the user's may have."""

    side: Literal["left", "right"] = "left"
    wood: Wood = Wood.OAK
    pair: tuple[float, int] = (0.0, 0)
    many: tuple[int, ...] = ()
    file: Path = Path("x")


def kinds(text):
    return Reader(lambda dotted: f"f.yaml: {dotted}").dataclass(Kinds, parse(text, "f.yaml"))


def test_classes_of_the_users_may_have_the_usual_types():
    found = kinds("{side: right, wood: ASH, pair: [1, 2], many: [3, 4, 5], file: a/b.csv}")
    assert found == Kinds(side="right", wood=Wood.ASH, pair=(1.0, 2), many=(3, 4, 5), file=Path("a/b.csv"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("side: rihgt", "side: unknown value 'rihgt': did you mean 'right'? known: left, right"),
        ("side: 3", "side = 3: must be one of left, right"),
        ("wood: OKA", "wood: unknown value 'OKA': did you mean 'OAK'? known: OAK, ASH"),
        ("pair: [1]", "pair = [1]: must be a list of 2 values"),
        ("pair: [1, x]", "pair.1 = 'x': must be a whole number"),
        ("many: 3", "many = 3: must be a list, each a whole number"),
        ("many: [1.5]", "many.0 = 1.5: must be a whole number"),
        ("file: 3", "file = 3: must be a path"),
    ],
)
def test_what_does_not_fit_such_a_type_is_told(text, message):
    with pytest.raises(BadInputError) as error:
        kinds(text)
    assert str(error.value).endswith(message)
