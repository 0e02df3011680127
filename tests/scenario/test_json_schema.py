"""The JSON Schema of scenario files has every key, takes the shipped scenarios, and refuses what the Reader refuses.

A small reader of JSON Schema stands in for a package; it knows every word that the schema uses, and no others.
"""

import copy
import dataclasses
import json
import math
import random
import re

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged, parse
from forcectl.scenario.catalog import SLOTS, experiments_folder, find_scenario, list_experiments, tags_of
from forcectl.scenario.json_schema import custom_tags, scenario_schema
from forcectl.scenario.scenario import Scenario, load_scenario
from forcectl.scenario.schema import load_object

SCHEMA = scenario_schema()
TYPES = {
    "number": lambda v: isinstance(v, int | float) and not isinstance(v, bool),
    "integer": lambda v: isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) and v == int(v),
    "boolean": lambda v: isinstance(v, bool),
    "string": lambda v: isinstance(v, str),
    "null": lambda v: v is None,
    "array": lambda v: isinstance(v, list),
    "object": lambda v: isinstance(v, dict),
}
BOUNDS = {
    "minimum": lambda v, b: v >= b,
    "exclusiveMinimum": lambda v, b: v > b,
    "maximum": lambda v, b: v <= b,
    "exclusiveMaximum": lambda v, b: v < b,
}
ANNOTATIONS = {"$schema", "yaml.customTags", "$defs", "title", "description", "default"}
CHECKED = {"$ref", "type", "anyOf", "enum", "properties", "patternProperties", "additionalProperties", "items"}


def fits(value, schema):
    """Whether a tree without tags fits a schema; the part of draft 2020-12 that the schema is written in."""
    assert set(schema) <= ANNOTATIONS | CHECKED | set(BOUNDS) | {"maxItems"}
    name = schema.get("$ref", "").removeprefix("#/$defs/").replace("%20", " ")
    if name and not fits(value, SCHEMA["$defs"][name]):
        return False
    types = schema.get("type", [])
    types = [types] if isinstance(types, str) else types
    if types and not any(TYPES[name](value) for name in types):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if "anyOf" in schema and not any(fits(value, one) for one in schema["anyOf"]):
        return False
    if TYPES["number"](value) and not all(holds(value, schema[b]) for b, holds in BOUNDS.items() if b in schema):
        return False
    if isinstance(value, list):
        short = len(value) <= schema.get("maxItems", len(value))
        return short and all(fits(part, schema["items"]) for part in value if "items" in schema)
    return not isinstance(value, dict) or all(_key_fits(key, part, schema) for key, part in value.items())


def _key_fits(key, part, schema):
    own = schema.get("properties", {}).get(key)
    patterns = [inner for pattern, inner in schema.get("patternProperties", {}).items() if re.search(pattern, str(key))]
    found = [inner for inner in (own, *patterns) if inner is not None]
    if not found:
        further = schema.get("additionalProperties", True)
        return further if isinstance(further, bool) else fits(part, further)
    return all(fits(part, inner) for inner in found)


def test_it_is_strict_json():
    assert json.loads(json.dumps(SCHEMA, allow_nan=False)) == SCHEMA
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.parametrize("name", list_experiments())
def test_every_shipped_experiment_fits(name):
    assert fits(find_scenario(name).tree, SCHEMA)


@pytest.mark.parametrize("path", sorted((experiments_folder() / "presets").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_preset_fits(path):
    assert fits(parse(path.read_text(), path.name), SCHEMA)


def test_every_key_of_everything_that_fills_a_slot_is_in_it():
    for slot in SLOTS:
        for tag, path in tags_of(slot).items():
            keys = {f.name for f in dataclasses.fields(load_object(path)) if f.init}
            part = SCHEMA["$defs"][f"{slot} !{tag}"]
            assert set(part["properties"]) == keys
            assert all("description" in value for value in part["properties"].values())
    assert set(SCHEMA["properties"]) == {f.name for f in dataclasses.fields(Scenario)}


def test_units_bounds_defaults_and_choices_are_those_of_the_keys():
    gain = SCHEMA["$defs"]["controller !Integral"]["properties"]["integral_gain"]
    text = "integral gain K_I of the force error [1/s], from 0.000001 to 10000"
    assert gain == {"description": text, "default": 1.5, "type": "number", "minimum": 1e-6, "maximum": 10000}
    kind = SCHEMA["$defs"]["fault !ReadingFault"]["properties"]["kind"]
    assert (kind["enum"], kind["default"]) == (["nan", "frozen", "lost"], "nan")
    assert SCHEMA["properties"]["duration"] | {"description": ""} == {
        "description": "",
        "default": 5.0,
        "type": "number",
        "minimum": 1e-6,
        "maximum": 86400.0,
    }


@pytest.mark.parametrize(
    "text",
    [
        "duraton: 3",
        "duration: 0",
        "duration: long",
        "seed: 1.5",
        "seed: -1",
        "station: {gravty: true}",
        "station: {gravity: 1}",
        "station: {normal: [0, 0, 1, 0]}",
        "controller: !Integral {integral_gian: 3}",
        "controller: !AdaptiveIntegral {forgetting: 2}",
        "station: {drive: {servo: {tuned_for: axis}}}",
        "station: {environment: !Surface {surface: {slope: 3}}}",
        "expect: [{target: t, metric: overshoot_N, maximun: 3}]",
        "variants: {a: {contoller: {}}}",
    ],
)
def test_what_it_refuses_the_reader_refuses(text):
    tree = parse(text, "f")
    assert not fits(tree, SCHEMA)
    variants = list(tree.get("variants", [])) or [None]
    with pytest.raises(BadInputError):
        load_scenario(tree, variants[0])


@pytest.mark.slow
def test_it_takes_what_the_reader_takes():
    rng = random.Random(1)
    trees = [find_scenario(name).tree for name in ("fig_2_7", "fig_5_2", "table_4_1", "multi_material")]
    taken = 0
    for _ in range(120):
        tree = copy.deepcopy(rng.choice(trees))
        for name in ("variants", "expect"):
            tree.pop(name, None)
        _change(tree, rng)
        try:
            load_scenario(tree)
        except BadInputError:
            continue
        taken += 1
        assert fits(tree, SCHEMA), tree
    assert taken > 20


def _change(tree, rng):
    """Another value at a random key of a tree."""
    places = []
    waiting = [tree]
    for part in waiting:
        for key in part if isinstance(part, dict) else range(len(part)):
            places.append((part, key))
            if isinstance(part[key], dict | list):
                waiting.append(part[key])
    container, key = rng.choice(places)
    if TYPES["number"](container[key]) and rng.random() < 0.7:
        container[key] *= rng.choice([0.5, 2, 10])
    else:
        container[key] = rng.choice([-1, 0, 0.5, 2, 3.0, "x", True, None, [], [0.0, 0.0, 1.0], Tagged(), "Kinematic"])


def test_an_editor_is_told_every_tag():
    tags = custom_tags()
    assert {"!Integral mapping", "!Integral scalar", "!Import mapping", "!Surface mapping"} <= set(tags)
    assert SCHEMA["yaml.customTags"] == tags
