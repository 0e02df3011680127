"""From trees to dataclasses: types, defaults, tags, and messages that name key, value and what is allowed."""

import math
from dataclasses import dataclass, field

import pytest

from forcectl.errors import BadInputError, invalid
from forcectl.framework.fields import slot
from forcectl.framework.reader import describe
from forcectl.framework.yaml_tree import Tagged, parse
from forcectl.scenario import catalog
from forcectl.scenario.schema import ScenarioReader
from forcectl.scenario.trees import to_tree


@dataclass
class Inner:
    gain: float = 1.0
    limit: float = math.inf

    def __post_init__(self):
        if self.gain < 0:
            raise invalid("gain", self.gain, "not negative")


@dataclass
class Other:
    width: float = 2.0


TABLE = {"Inner": f"{__name__}:Inner", "Other": f"{__name__}:Other"}


@dataclass
class Outer:
    needed: int
    name: str = "x"
    flag: bool = False
    number: float | None = None
    text_or_number: float | str = 0.0
    numbers: list[float] = field(default_factory=list)
    table: dict[str, int] = field(default_factory=dict)
    inner: Inner = field(default_factory=lambda: Inner(gain=5.0))
    part: object = slot("part", Inner)
    inners: list[Inner] = field(default_factory=list)


@pytest.fixture(autouse=True)
def part_is_a_slot(monkeypatch):
    monkeypatch.setitem(catalog.SLOTS, "part", TABLE)
    monkeypatch.setitem(catalog.CONTRACTS, "part", ())


READER = ScenarioReader(lambda key: "f.yaml")


def read(text):
    return READER.dataclass(Outer, parse(text, "f.yaml"))


def test_values_of_every_kind():
    outer = read(
        "{needed: 3.0, name: '7', flag: true, number: 2, text_or_number: hi, numbers: [1, 2.5],"
        " table: {a: 1}, inner: {limit: 3}, part: !Other {width: 1},"
        " inners: [{gain: 1}, {}]}"
    )
    assert (outer.needed, outer.name, outer.flag, outer.number) == (3, "7", True, 2.0)
    assert isinstance(outer.needed, int)
    assert isinstance(outer.number, float)
    assert outer.text_or_number == "hi"
    assert (outer.numbers, outer.table) == ([1.0, 2.5], {"a": 1})
    assert outer.part == Other(width=1.0)
    assert outer.inners == [Inner(1.0), Inner()]


def test_a_partly_written_mapping_keeps_the_rest_of_the_default():
    assert read("{needed: 1, inner: {limit: 3}}").inner == Inner(gain=5.0, limit=3.0)


def test_infinity_is_taken_only_where_the_default_is_infinite():
    assert read("{needed: 1, inner: {limit: .inf}}").inner.limit == math.inf
    with pytest.raises(BadInputError, match=r"inner.gain = inf: must be a finite number"):
        read("{needed: 1, inner: {gain: .inf}}")


def test_reading_what_was_written_gives_the_same():
    outer = read("{needed: 3, part: !Other {width: 7}, inners: [{gain: 2}]}")
    tree = to_tree(outer)
    assert tree["part"].tag == "Other"
    assert READER.dataclass(Outer, tree) == outer


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "f.yaml: needed is missing: must be a whole number"),
        ("3", "f.yaml: scenario = 3: must be a mapping with keys out of: needed, name,"),
        ("{needed: 1.5}", "f.yaml: needed = 1.5: must be a whole number"),
        ("{needed: true}", "f.yaml: needed = True: must be a whole number"),
        ("{needed: 1, flag: 1}", "f.yaml: flag = 1: must be true or false"),
        ("{needed: 1, name: 7}", "f.yaml: name = 7: must be text"),
        ("{needed: 1, nam: 7}", "f.yaml: nam: unknown key 'nam': did you mean 'name'? known: needed, name,"),
        ("{needed: 1, 3: 7}", "f.yaml: 3: unknown key 3: known:"),
        ("{needed: 1, number: [1]}", "f.yaml: number = [1]: must be a number"),
        ("{needed: 1, text_or_number: []}", "f.yaml: text_or_number = []: must be a number or text"),
        ("{needed: 1, numbers: 4}", "f.yaml: numbers = 4: must be a list, each a number"),
        ("{needed: 1, numbers: [1, x]}", "f.yaml: numbers.1 = 'x': must be a number"),
        ("{needed: 1, table: {1: 2}}", "f.yaml: table.1 = 1: must be text"),
        ("{needed: 1, table: [1]}", "f.yaml: table = [1]: must be a mapping"),
        ("{needed: 1, inner: {gain: -2}}", "f.yaml: inner.gain = -2.0: must be not negative"),
        ("{needed: 1, inner: {gain: .nan}}", "f.yaml: inner.gain = nan: must be a finite number"),
        (f"{{needed: 1, inner: {{gain: 1{'0' * 320}}}}}", "inner.gain = inf: must be a finite number"),
        ("{needed: 1, inner: null}", "f.yaml: inner = None: must be a mapping with keys out of: gain, limit"),
        (
            "{needed: 1, part: !Otter {}}",
            "f.yaml: part: unknown tag '!Otter': did you mean '!Other'? known: !Inner, !Other, !Import",
        ),
        ("{needed: 1, part: !Other {gain: 1}}", "f.yaml: part.gain: unknown key 'gain': known: width"),
        ("{needed: 1, inners: [{gain: 1}, {gain: x}]}", "f.yaml: inners.1.gain = 'x': must be a number"),
    ],
)
def test_messages_name_file_key_value_and_what_is_allowed(text, message):
    with pytest.raises(BadInputError) as caught:
        read(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_long_values_are_cut():
    with pytest.raises(BadInputError) as caught:
        read(f"{{needed: [{'1, ' * 500}]}}")
    assert len(str(caught.value)) < 140


def test_types_in_words():
    assert describe(list[float] | None) == "a list, each a number or null"
    assert describe(dict[str, int]) == "a mapping"
    assert describe(Inner) == "a mapping with keys out of: gain, limit"
    assert to_tree(Inner()) == Tagged({"gain": 1.0, "limit": math.inf})
