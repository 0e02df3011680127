"""Errors are data: key, value, what is allowed and where; the line is made of them at the end."""

import pickle

import pytest

from forcectl.errors import BadInputError, about, invalid, one_line, parts_of, place_in_code, show, unknown


def test_a_value_that_is_not_allowed():
    error = invalid("gain", -1.0, "positive")
    assert (error.key, error.value, error.allowed, error.where) == ("gain", -1.0, "positive", "")
    assert str(error) == "gain = -1.0: must be positive"


def test_a_full_key_and_a_place_are_put_in_front():
    error = invalid("gain", -1.0, "positive").at("controller.gain", "own.yaml:3")
    assert str(error) == "own.yaml:3: controller.gain = -1.0: must be positive"
    assert (error.value, error.allowed) == (-1.0, "positive")
    assert str(unknown("arm", "lft", ["left", "right"]).at("loads.0.arm", "own.yaml:3")) == (
        "own.yaml:3: loads.0.arm: unknown arm 'lft': did you mean 'left'? known: left, right"
    )


def test_the_place_in_code_is_the_last_of_a_user():
    own = compile("\n\nimport json\njson.loads('{')", "folder/my_law.py", "exec")
    with pytest.raises(ValueError, match="line 1") as caught:
        exec(own, {"__name__": "my_law"})
    assert place_in_code(caught.value) == " (my_law.py:4)"
    assert place_in_code(KeyError("never raised")) == ""


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (BadInputError("nothing fits"), "nothing fits"),
        (BadInputError("must have a tag", key="a.b"), "a.b: must have a tag"),
        (BadInputError(" has 2 values: must have 3", key="a.b"), "a.b has 2 values: must have 3"),
    ],
)
def test_a_text_goes_on_after_the_key_or_follows_a_colon(error, text):
    assert str(error) == text


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        ("arm", "arm"),
        ("stiffness set", "stiffness_set"),
        ("robot (neither shipped nor a folder)", "robot"),
        ("variant of own.yaml", "variant"),
    ],
)
def test_an_unknown_name_is_about_the_key_of_its_kind(kind, field):
    error = unknown(kind, "x", ["a"])
    assert (error.field, error.key, error.value, error.allowed) == (field, "", "x", "one of a")


def test_the_nearest_name_is_found_whatever_the_case():
    assert "did you mean 'Integral'?" in str(unknown("tag", "integrall", ["Step", "Integral"]))
    assert "did you mean" not in str(unknown("tag", "zzz", ["Step", "Integral"]))


def test_an_error_can_be_sent_to_another_process():
    error = invalid("gain", -1.0, "positive").at("controller.gain", "own.yaml:3")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.key, again.value) == (str(error), error.key, error.value)


def test_the_middle_of_a_long_value_is_left_out():
    text = show([float(i) for i in range(1000)])
    assert len(text) == 60
    assert text.startswith("[0.0, 1.0")
    assert text.endswith("999.0]")


def test_an_exception_of_the_users_whose_text_fails_is_still_one_line():
    class OddError(Exception):
        def __str__(self):
            raise LookupError("no text")

    assert one_line(OddError()) == "OddError: its text raises LookupError"


def test_the_parts_at_work_are_known_innermost_first():
    outer, inner = object(), object()
    with pytest.raises(ZeroDivisionError) as caught, about(outer), about(inner):
        1 / 0  # noqa: B018  (raises)
    assert parts_of(caught.value) == [inner, outer]
