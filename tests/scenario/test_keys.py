"""The keys of a part in words, for what is shipped and for what an installed package registers."""

import dataclasses
from dataclasses import dataclass

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.fields import Config, key, key_of, slot
from forcectl.scenario.catalog import SLOTS, tags_of
from forcectl.scenario.keys import KeyWords, classes_of, keys_of
from forcectl.scenario.scenario import Scenario
from forcectl.scenario.schema import load_object


@dataclass(kw_only=True)
class Inner(Config):
    width: float = key(2.5, "of it", unit="m", bounds="positive")


@dataclass(kw_only=True)
class Own(Config):
    needed: int = key(meaning="how many")
    mode: str = key("a", choices=("a", "b"))
    point: list[float] = key([1.0, 2.0], unit="m", size=2)
    part: Inner = key(Inner, "one")
    other: Inner | None = key(None)
    several: list[Inner] = key([], "more")
    by_name: dict[str, dict[str, Inner]] = key({}, "many")
    law: object = slot("reference", load_object(SLOTS["reference"]["Step"]), "filled")
    named: dict[str, object] = slot("reference", dict, meaning="by name")
    listed: list[object] = slot("reference", list)
    law_needed: object = slot("reference")

    def wrench(self, time):
        """As a load has it."""


def test_every_key_is_told_in_words():
    assert keys_of(Own) == [
        KeyWords("needed", "a whole number", "", "", "", "how many"),
        KeyWords("mode", "text", "", "one of a, b", "a", ""),
        KeyWords("point", "a list, each a number", "m", "2 values, from -100 to 100 m", "[1.0, 2.0]", ""),
        KeyWords("part", "a mapping", "", "", "", "one"),
        KeyWords("part.width", "a number", "m", "positive, from 1e-09 to 100 m", "2.5", "of it"),
        KeyWords("other", "a mapping or null", "", "", "null", ""),
        KeyWords("other.width", "a number", "m", "positive, from 1e-09 to 100 m", "2.5", "of it"),
        KeyWords("several", "a list, each a mapping", "", "", "[]", "more"),
        KeyWords("several.0.width", "a number", "m", "positive, from 1e-09 to 100 m", "2.5", "of it"),
        KeyWords("by_name", "names, each with names, each with a mapping", "", "", "{}", "many"),
        KeyWords("by_name.<name>.<name>.width", "a number", "m", "positive, from 1e-09 to 100 m", "2.5", "of it"),
        KeyWords("law", "a part of the slot reference", "", "", "!Step", "filled"),
        KeyWords("named", "names, each with a part of the slot reference", "", "", "{}", "by name"),
        KeyWords("listed", "a list of parts of the slot reference", "", "", "[]", ""),
        KeyWords("law_needed", "a part of the slot reference", "", "", "", ""),
    ]


def test_a_class_that_is_no_dataclass_has_no_keys():
    assert keys_of(int) == []


def test_a_tag_of_an_installed_package_is_found(monkeypatch):
    tags = {"load": {"Own": f"{__name__}:Own"}}
    monkeypatch.setattr("forcectl.scenario.catalog.announced", lambda slot: tags.get(slot, {}))
    assert classes_of("!Own") == {"load": Own}


def test_a_tag_that_no_slot_has_is_refused():
    with pytest.raises(BadInputError, match=r"^unknown tag '!Sten': did you mean '!Step'\?"):
        classes_of("Sten")


def every_configuration():
    waiting = [Scenario, *(load_object(path) for slot in SLOTS for path in tags_of(slot).values())]
    for cls in waiting:
        for kind in cls.__annotations__.values():
            inner = getattr(__import__(cls.__module__, fromlist=["x"]), str(kind).split("[")[-1].rstrip("]"), None)
            if dataclasses.is_dataclass(inner) and inner not in waiting:
                waiting.append(inner)
    return waiting


@pytest.mark.parametrize("cls", every_configuration(), ids=lambda cls: cls.__name__)
def test_every_key_has_a_meaning(cls):
    assert [f.name for f in dataclasses.fields(cls) if not key_of(f).meaning] == []
