"""File names from names of variants: readable, safe, no two alike."""

import re

import forcectl as fc
from forcectl.figures.file_names import file_names
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.layers import select_variants


def test_a_name_is_readable_and_safe():
    names = {
        "K_I = 4.5 1/s": "K_I-4.5-1-s",
        "wood, VRFT for 7.5 rad/s": "wood-VRFT-for-7.5-rad-s",
        "compliance -20 %": "compliance-minus-20-pct",
        "compliance +20 %": "compliance-plus-20-pct",
        "invariance [57]": "invariance-57",
        "../../etc/passwd": "etc-passwd",
        "härter": "harter",
        "接触": "variant",
        "": "variant-2",
        "x" * 300: "x" * 60,
    }
    assert file_names(names) == names


def test_no_two_are_alike_whatever_the_file_system_makes_of_case():
    found = file_names(["a/b", "a b", "A-B", "a-b-2", "..."])
    assert found == {"a/b": "a-b", "a b": "a-b-2", "A-B": "A-B-3", "a-b-2": "a-b-2-2", "...": "variant"}


def test_every_shipped_variant_has_its_own():
    for experiment in fc.list_experiments():
        variants = select_variants(find_scenario(experiment))
        parts = file_names(variants)
        assert len({part.lower() for part in parts.values()}) == len(variants)
        assert all(re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", part) for part in parts.values())
        assert not [part for part in parts.values() if part.startswith("variant")], experiment
