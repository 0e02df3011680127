"""YAML text as trees: scalars, tags, merging, overrides, differences."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged, difference, dump, merge, nest, parse, place

AWKWARD = "a1.e-+~<=:#'\"{}[],!&*%@`|>? \n\t\u00e9\u2028"
scalars = (
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text(AWKWARD, max_size=8)
)
names = st.text("abcdefgh", min_size=1, max_size=3)
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.builds(Tagged, st.dictionaries(names, inner, max_size=3), st.none() | st.sampled_from(["A", "B"]))
    ),
    max_leaves=12,
)
mappings = st.builds(Tagged, st.dictionaries(names, trees, max_size=4))


def same(a, b):
    if isinstance(a, Tagged):
        return isinstance(b, Tagged) and a.tag == b.tag and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def test_scalars_follow_yaml_1_2():
    tree = parse(
        "{a: 2e5, b: 1e-3, c: on, d: no, e: 0x10, f: 1:30, g: .5, h: -3, i: true, j: null, k: 2020-01-01}", "f"
    )
    assert tree == {
        "a": 2e5,
        "b": 1e-3,
        "c": "on",
        "d": "no",
        "e": "0x10",
        "f": "1:30",
        "g": 0.5,
        "h": -3,
        "i": True,
        "j": None,
        "k": "2020-01-01",
    }
    assert parse("[.inf, -.inf]", "f") == [math.inf, -math.inf]
    assert math.isnan(parse(".nan", "f"))


def test_a_tag_may_stand_alone_or_before_a_mapping():
    tree = parse("{a: !Integral {integral_gain: 3}, b: !Step }", "f")
    assert (tree["a"].tag, tree["b"].tag, tree["b"]) == ("Integral", "Step", {})


@pytest.mark.slow
@given(mappings)
def test_dump_and_parse_are_inverse(tree):
    assert same(parse(dump(tree), "f"), tree)


@pytest.mark.slow
@example(Tagged({"a": []}), Tagged({"a": None}))
@example(Tagged({"a": Tagged({"a": None})}), Tagged({"a": Tagged()}))
@example(Tagged({"a": Tagged({}, "A")}), Tagged({"a": Tagged({})}))
@given(mappings, mappings)
def test_a_difference_merged_on_the_base_gives_the_other(base, other):
    change = difference(base, other)
    if expressible(base, other):
        assert same(merge(base, change), _with_order(base, other))


def expressible(base, other):
    """Merging removes no key or tag at any depth, so there is a difference only towards trees that keep them."""
    if not isinstance(base, Tagged) or not isinstance(other, Tagged) or other.tag not in (None, base.tag):
        return True
    return other.tag == base.tag and all(key in other and expressible(base[key], other[key]) for key in base)


def _with_order(base, other):
    return Tagged({k: other[k] for k in [*base, *other]}, other.tag)


def test_merge_goes_into_mappings_and_replaces_the_rest():
    base = parse("{a: {b: 1, c: [1, 2]}, d: 4}", "f")
    assert merge(base, parse("{a: {c: [3]}, e: 5}", "f")) == {"a": {"b": 1, "c": [3]}, "d": 4, "e": 5}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 4}


def test_another_tag_replaces_the_same_tag_or_none_merges():
    base = parse("{c: !A {x: 1, y: 2}}", "f")
    assert merge(base, parse("{c: !B {y: 3}}", "f")) == {"c": {"y": 3}}
    merged = merge(base, parse("{c: {y: 3}}", "f"))
    assert merged == {"c": {"x": 1, "y": 3}}
    assert merged["c"].tag == "A"
    assert merge(base, parse("{c: !A {y: 3}}", "f")) == {"c": {"x": 1, "y": 3}}


def test_a_class_of_another_path_replaces_and_one_of_the_same_path_merges():
    base = parse("{c: !Import {path: 'm:A', parameters: {x: 1}}}", "f")
    other = parse("{c: !Import {path: 'm:B', parameters: {y: 3}}}", "f")
    assert merge(base, other) == other
    assert same(merge(base, difference(base, other)), other)
    assert merge(base, parse("{c: !Import {path: 'm:A', parameters: {y: 3}}}", "f"))["c"]["parameters"] == {
        "x": 1,
        "y": 3,
    }
    assert merge(base, nest({"c.path": "m:B"}))["c"] == {"path": "m:B", "parameters": {"x": 1}}
    assert merge(base, parse("{c: !Import {parameters: {y: 3}}}", "f"))["c"]["parameters"] == {"x": 1, "y": 3}


def test_dotted_overrides_reach_into_lists():
    base = parse("{a: {list: [10, 20, 30]}}", "f")
    assert merge(base, nest({"a.list.1": 7})) == {"a": {"list": [10, 7, 30]}}
    assert merge(base, nest({"a.list.9": 7})) == {"a": {"list": {"9": 7}}}


def test_later_overrides_win_and_python_values_are_accepted():
    import numpy as np

    tree = nest({"a.b": 1, "a": {"c": (1, 2)}, "a.b.d": np.float64(2.5), "e": np.arange(2)})
    assert tree == {"a": {"b": {"d": 2.5}, "c": [1, 2]}, "e": [0, 1]}


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a: 1\na: 2", "'a' is written twice (line 2, column 1)"),
        ("a: [1, 2", "line 1"),
        ("{" * 5000, "nested too deeply"),
        ("a: &x [*x]", "holds itself"),
        ("a: *nothing", "undefined alias"),
        ("a: !!python/object:os.system x", "could not determine a constructor"),
        ("a: !Integral 3", "!Integral must be followed by a mapping"),
        ("? {a: 1}\n: 2", "unhashable"),
        ("a: \x00", "not allowed"),
        ("a: !!int x", "invalid literal"),
        ('a: "x\\0y"', "control character"),
        ('a: "\\x9b31m"', "control character"),
        ('"\\ud800": 1', "control character"),
        ("x: &x [1,1,1,1,1,1,1,1,1,1]\n" + "".join(f"y{i}: &y{i} [{', '.join([f'*{p}'] * 10)}]\n" for i, p in
            enumerate(["x", "y0", "y1", "y2", "y3"])), "more than 100000 values"),
        ("x: &x {a: 1}\n" + "".join(f"y{i}: &y{i} {{<<: [{', '.join([f'*{p}'] * 10)}]}}\n" for i, p in
            enumerate(["x", *(f"y{i}" for i in range(20))])), "more than 100000 keys are merged"),
        ("_0: &a0 {k: 1}\n" + "".join(f"_{i + 1}: &a{i + 1} {{<<: *a{i}, k{i}: 1}}\n" for i in range(6000)),
            "more than 100000 keys are merged"),
        ("# " + 500_000 * "x", "more than 500000 characters"),
    ],
)  # fmt: skip
def test_text_that_is_no_tree_is_one_line_with_the_place(text, what):
    with pytest.raises(BadInputError) as caught:
        parse(text, "some.yaml")
    message = str(caught.value)
    assert message.startswith("some.yaml: not ")
    assert what in message
    assert "\n" not in message


def test_every_key_has_the_line_where_it_stands():
    text = "a: 1\nb: &b\n  c: [1,\n    2]\n  d.e: {f: 3}\ng:\n  <<: *b\n  c: 4\nh: !T\n  i: 5\n"
    lines = parse(text, "f").lines
    assert lines["a"] == 1
    assert (lines["b"], lines["b.c"], lines["b.c.0"], lines["b.c.1"]) == (2, 3, 3, 4)
    assert lines["b.d.e.f"] == 5
    assert (lines["g"], lines["g.d.e.f"], lines["g.c"]) == (6, 5, 8)
    assert (lines["h"], lines["h.i"]) == (9, 10)


def test_what_is_not_in_a_file_stands_where_the_part_around_it_does():
    lines = parse("a:\n  b: 1\n", "f").lines
    assert [place("f", lines, key) for key in ("a.b", "a.c.d", "x", "")] == ["f:2", "f:1", "f", "f"]
