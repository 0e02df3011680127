"""A value that cannot be read is told with the file, the line and the full key."""

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse

ALLOWED = "must be written without the zero before it, or as"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 010", f"some.yaml:1: a = 010: {ALLOWED} '010' for text"),
        ("a:\n  - -00.5", f"some.yaml:2: a.0 = -00.5: {ALLOWED} '-00.5' for text"),
        ("a:\n  b: {c: !T {d: 007}}", f"some.yaml:2: a.b.c.d = 007: {ALLOWED} '007' for text"),
        ("a: &x {b: 01}\nc: *x", f"some.yaml:1: a.b = 01: {ALLOWED} '01' for text"),
        ("010", f"some.yaml: 010: {ALLOWED} '010' for text"),
    ],
)
def test_a_number_with_a_zero_before_it(text, message):
    with pytest.raises(BadInputError) as caught:
        parse(text, "some.yaml")
    assert str(caught.value) == message
    assert caught.value.key == message.partition(" = ")[0].partition(": ")[2] * (" = " in message)
