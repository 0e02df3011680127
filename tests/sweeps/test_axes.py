import pickle

import numpy as np
import pytest
from pydrake.common import schema
from scipy import stats

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse
from forcectl.sweeps.axes import axis_of, is_plain

UNIFORM = np.random.default_rng(3).random(4000)


def axis(text):
    return axis_of("a.b", parse(text, "test"))


@pytest.mark.parametrize(
    ("text", "distribution"),
    [
        ("!Uniform {min: -2, max: 5}", stats.uniform(-2, 7)),
        ("!Gaussian {mean: 3, stddev: 0.5}", stats.norm(3, 0.5)),
        ("!LogUniform {min: 1e3, max: 1e6}", stats.loguniform(1e3, 1e6)),
    ],
)
def test_draws_are_quantiles_of_the_distribution(text, distribution):
    assert axis(text).draw(UNIFORM) == pytest.approx(distribution.ppf(UNIFORM), rel=1e-9)


def test_the_ends_of_the_unit_interval_give_finite_values():
    assert np.isfinite(axis("!Gaussian {mean: 0, stddev: 1}").draw(np.array([0.0, 1.0]))).all()


def test_a_fixed_value_is_drawn_always():
    assert set(axis("!Deterministic {value: 4}").draw(UNIFORM)) == {4.0}


@pytest.mark.parametrize("text", ["[1, 2.5, 7]", "!UniformDiscrete {values: [1, 2.5, 7]}"])
def test_values_of_a_list_are_equally_likely(text):
    found = [axis(text).value(x) for x in axis(text).draw(UNIFORM)]
    for value in (1, 2.5, 7):
        assert found.count(value) / len(found) == pytest.approx(1 / 3, abs=0.03)


def test_distributions_of_drake_are_those_of_the_file():
    for given, text in (
        (schema.Uniform(1, 2), "!Uniform {min: 1, max: 2}"),
        (schema.Gaussian(1, 2), "!Gaussian {mean: 1, stddev: 2}"),
        (schema.Deterministic(3), "!Deterministic {value: 3}"),
    ):
        assert axis_of("a.b", given) == axis(text)
    assert axis_of("a.b", schema.UniformDiscrete([1, 2])).values == [1, 2]


def test_parts_are_shown_as_text_and_numbers_as_numbers():
    found = axis("[!Integral {integral_gain: 2}, 3, true, wood]")
    assert found.labels == ["!Integral {integral_gain: 2}", 3, True, "wood"]
    assert found.value(0.0) == {"integral_gain": 2}


def test_axes_travel_between_processes():
    for text in ("[1, 2]", "!LogUniform {min: 1, max: 2}"):
        assert pickle.loads(pickle.dumps(axis(text))) == axis(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3", "keys.a.b = 3: must be a list of values, or a distribution: !Deterministic"),
        ("[]", "keys.a.b = []: must be a list of at least one value"),
        ("[1, 2, 1]", "keys.a.b holds 1 twice"),
        ("!Unifrom {min: 1, max: 2}", "keys.a.b: unknown distribution '!Unifrom': did you mean '!Uniform'"),
        ("!Uniform {min: 1}", "keys.a.b.max is missing: !Uniform has the keys min, max"),
        ("!Uniform {min: 1, max: 2, mean: 1}", "keys.a.b.mean: unknown key 'mean'"),
        ("!Uniform {min: 2, max: 2}", "keys.a.b.max = 2.0: must be above min = 2"),
        ("!Uniform {min: low, max: 2}", "keys.a.b.min = 'low': must be a finite number"),
        ("!Uniform {min: .nan, max: 2}", "keys.a.b.min = nan: must be a finite number"),
        ("!LogUniform {min: 0, max: 2}", "keys.a.b.min = 0.0: must be positive"),
        ("!Gaussian {mean: 0, stddev: 0}", "keys.a.b.stddev = 0.0: must be positive"),
        ("[1, 2, 1.0]", "keys.a.b holds 1.0 twice: values of a list must differ"),
        ("!Gaussian {mean: 0, stddev: -1}", "keys.a.b.stddev = -1.0: must be positive"),
        ("!UniformDiscrete {values: 3}", "keys.a.b.values = 3: must be a list of values"),
        ("!UniformDiscrete {values: []}", "keys.a.b.values = []: must be a list of at least one value"),
    ],
)
def test_what_cannot_be_varied_is_told(text, message):
    with pytest.raises(BadInputError) as error:
        axis(text)
    assert str(error.value).startswith(message)


def test_objects_from_python_are_not_for_files():
    assert is_plain(parse("{a: [1, !Integral {integral_gain: 2}]}", "test"))
    assert not is_plain({"a": [object()]})
