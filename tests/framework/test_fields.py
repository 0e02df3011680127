"""Keys of configurations check themselves: types, bounds, choices, sizes, and messages that name the key."""

import dataclasses
import math
from dataclasses import dataclass, fields

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.fields import REQUIRED, Config, Interval, Key, default_of, interval, key, key_of


@dataclass(kw_only=True)
class Inner(Config):
    width: float = key(2.0, "of it", unit="m", bounds="positive")


@dataclass(kw_only=True)
class Outer(Config):
    needed: float = key(meaning="always given")
    gain: float = key(1.5, "gain K", unit="1/s", bounds="not negative")
    limit: float = key(math.inf, "largest", bounds="positive")
    reach: float = key(4.0, bounds="positive or infinite")
    share: float = key(0.5, bounds="above 0 and at most 1")
    slope: float | None = key(None, bounds="from -0.3 to 0.3")
    count: int = key(2, bounds="from 1 to 9")
    switch: bool = key(True)
    name: str = key("x")
    mode: str = key("fast", choices=("fast", "slow"))
    late: str = key("a", choices=lambda: ["a", "b"])
    times: list[float] = key([], unit="s", bounds="not negative")
    normal: list[float] = key([0.0, 0.0, 1.0], bounds="not all zero", size=3)
    wrenches: list[list[float]] = key([], size=2)
    part: Inner = key(Inner, "within")
    plain: float = -1.0

    def __post_init__(self):
        super().__post_init__()
        if self.gain > self.limit:
            raise BadInputError(" is above the limit", key="gain")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gain": -0.1}, "gain = -0.1: must be not negative"),
        ({"gain": "1"}, "gain = '1': must be a finite number"),
        ({"gain": True}, "gain = True: must be a finite number"),
        ({"gain": None}, "gain = None: must be a finite number"),
        ({"gain": math.nan}, "gain = nan: must be a finite number"),
        ({"gain": math.inf}, "gain = inf: must be a finite number"),
        ({"gain": 3.0, "limit": 2}, "gain is above the limit"),
        ({"limit": 0}, "limit = 0: must be positive"),
        ({"limit": math.nan}, "limit = nan: must be a finite number"),
        ({"reach": 0.0}, "reach = 0.0: must be positive or infinite"),
        ({"share": 0.0}, "share = 0.0: must be above 0 and at most 1"),
        ({"share": 1.1}, "share = 1.1: must be above 0 and at most 1"),
        ({"slope": -0.31}, "slope = -0.31: must be from -0.3 to 0.3"),
        ({"count": 10}, "count = 10: must be a whole number from 1 to 9"),
        ({"count": 2.0}, "count = 2.0: must be a whole number"),
        ({"count": False}, "count = False: must be a whole number"),
        ({"switch": 1}, "switch = 1: must be true or false"),
        ({"name": 7}, "name = 7: must be text"),
        ({"mode": "fats"}, "mode: unknown mode 'fats': did you mean 'fast'? known: fast, slow"),
        ({"late": "c"}, "late: unknown late 'c': known: a, b"),
        ({"times": 3.0}, "times = 3.0: must be a list"),
        ({"times": [0.0, -1.0]}, "times.1 = -1.0: must be not negative"),
        ({"times": [0.0, math.inf]}, "times.1 = inf: must be a finite number"),
        ({"normal": []}, "normal = []: must be three numbers, not all zero"),
        ({"normal": [0.0, 0.0, 0.0]}, "normal = [0.0, 0.0, 0.0]: must be not all zero"),
        ({"wrenches": [[1.0, 2.0], [1.0]]}, "wrenches.1 = [1.0]: must be two numbers"),
        ({"wrenches": [[1.0, "a"]]}, "wrenches.0.1 = 'a': must be a finite number"),
    ],
)
def test_a_wrong_value_is_refused_by_name(values, message):
    with pytest.raises(BadInputError) as caught:
        Outer(needed=0.0, **values)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "values",
    [
        {"gain": 0},
        {"limit": math.inf},
        {"reach": math.inf},
        {"share": 1.0},
        {"slope": -0.3},
        {"count": 9},
        {"mode": "slow"},
        {"late": "b"},
        {"times": [0.0, 2]},
        {"wrenches": []},
        {"wrenches": [[1.0, -2.0]]},
        {"plain": "anything"},
    ],
)
def test_what_is_allowed_is_taken_as_it_is(values):
    outer = Outer(needed=0.0, **values)
    assert {name: getattr(outer, name) for name in values} == values


def test_defaults_are_copied_and_parts_are_made_anew():
    one, other = Outer(needed=1.0), Outer(needed=1.0)
    one.normal.append(7.0)
    one.part.width = 3.0
    assert (other.normal, other.part.width) == ([0.0, 0.0, 1.0], 2.0)


def test_a_dataclass_made_of_a_configuration_checks_the_keys_of_both():
    @dataclass(kw_only=True)
    class Mine(Inner):
        height: float = key(1.0, bounds="positive")

    for values in ({"width": 0.0}, {"height": 0.0}):
        with pytest.raises(BadInputError, match="must be positive"):
            Mine(**values)


def test_a_field_says_what_it_is():
    by_name = {f.name: f for f in fields(Outer)}
    assert key_of(by_name["gain"]) == Key("gain K", "1/s", "not negative")
    assert key_of(by_name["plain"]) == Key()
    assert key_of(by_name["late"]).chosen() == ["a", "b"]
    assert default_of(by_name["needed"]) is REQUIRED
    assert default_of(by_name["part"]) == Inner()


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        ("", Interval()),
        ("positive", Interval(low=0.0, without_low=True)),
        ("not negative", Interval(low=0.0)),
        ("below zero", Interval(high=0.0, without_high=True)),
        ("above 0 and below 1", Interval(0.0, 1.0, True, True)),
        ("from -1e-3 to 2", Interval(-1e-3, 2.0)),
        ("positive, at most 86400", Interval(0.0, 86400.0, True)),
        ("positive and finite", Interval(0.0, math.inf, True, True)),
        ("negative and finite", Interval(-math.inf, 0.0, True, True)),
        ("finite", Interval(-math.inf, math.inf, True, True)),
        ("a number", Interval()),
    ],
)
def test_bounds_in_words_are_an_interval(bounds, expected):
    assert interval(bounds) == expected


def test_other_words_are_refused():
    with pytest.raises(ValueError, match="bounds = 'positve': must be in the words of Key"):
        interval("positve")


def test_an_interval_may_leave_out_its_ends():
    assert [Interval(0.0, 1.0, True, False).holds(x) for x in (-0.1, 0.0, 0.5, 1.0, 1.1)] == [0, 0, 1, 1, 0]


@pytest.mark.parametrize(
    ("unit", "bounds", "fine", "wrong", "allowed"),
    [
        ("N", "not negative", (0.0, 1e5), (1e15,), "not negative, at most 100000 N"),
        ("rad/s", "positive", (1e-6, 1e6), (1e-9, 1.7e308), "positive, from 1e-06 to 1e+06 rad/s"),
        ("m", "below zero", (-0.1,), (-1e9, -1e-12), "below zero, from -100 to -1e-09 m"),
        ("N", "positive or infinite", (math.inf, 400.0), (1e300,), "positive or infinite, from 1e-09 to 100000 N"),
        ("m or rad", "", (-9e3, 9e3), (1e5,), "from -10000 to 10000 m or rad"),
        ("s", "positive, at most 86400", (1e-6, 86400.0), (1e-12,), "positive, at most 86400, at least 1e-06 s"),
    ],
)
def test_a_number_lies_in_the_physical_range_of_its_unit(unit, bounds, fine, wrong, allowed):
    declared = Key("of the test", unit, bounds)
    assert declared.allowed() == allowed
    made = dataclasses.make_dataclass(
        "Made", [("x", float, key(meaning="of the test", unit=unit, bounds=bounds))], bases=(Config,)
    )
    for value in fine:
        assert made(value).x == value
    for value in wrong:
        with pytest.raises(BadInputError) as caught:
            made(value)
        assert str(caught.value) == f"x = {value!r}: must be {allowed}"
