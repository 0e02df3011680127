"""Excitation profiles: shape of the moves, scaling, files, bad input."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.motion.excitation import ExcitationFileConfig, TrapezoidalMovesConfig, trapezoidal_moves
from forcectl.testing import run_diagram

lengths = st.floats(-5e-3, 5e-3)


@pytest.mark.slow
@given(st.lists(lengths, min_size=2, max_size=6), st.floats(1e-3, 0.1), st.floats(1e-2, 1.0), st.floats(0.0, 2.0))
@settings(max_examples=60, deadline=None)
def test_moves_end_at_rest_where_they_should_within_speed_and_acceleration(positions, speed, acceleration, rest):
    path = trapezoidal_moves(positions, speed=speed, acceleration=acceleration, rest=rest, start_rest=0.3)
    time = np.linspace(0.0, path.end_time(), 4001)
    x, v, a = (np.array([p.value(t).item() for t in time]) for p in (path, path.derivative(), path.derivative(2)))
    assert np.abs(v).max() <= speed * (1 + 1e-9)
    assert np.abs(a).max() <= acceleration * (1 + 1e-9)
    # No jumps: neighbouring samples are a step of the speed apart, at most.
    assert np.abs(np.diff(x)).max() <= speed * time[1] * (1 + 1e-6) + 1e-12
    assert x[0] == positions[0]
    assert path.value(path.end_time() + 1.0).item() == pytest.approx(positions[-1], abs=1e-9)
    assert min(positions) - 1e-9 <= x.min() <= x.max() <= max(positions) + 1e-9


def test_the_default_profile_is_the_one_of_the_targets():
    """0-1-2-3-4-3-2-1-0 mm, 5 mm/s, 0.05 m/s^2, 2 s rest: 0.3 s a move, into the surface."""
    config = TrapezoidalMovesConfig()
    path = config.trajectory()
    assert config.end_time() == pytest.approx(0.5 + 8 * 2.3)
    rests = [path.value(0.5 + 2.3 * (i + 1) - 1.0).item() for i in range(8)]
    np.testing.assert_allclose(rests, [-1e-3, -2e-3, -3e-3, -4e-3, -3e-3, -2e-3, -1e-3, 0.0], atol=1e-15)
    assert path.derivative().value(0.65).item() == pytest.approx(-5e-3)


def excitation(config, compliance, duration: float = 4.0) -> np.ndarray:
    block = config.add_to(DiagramBuilder(), compliance)
    return run_diagram(block, duration, period=0.1)["excitation"]


def test_on_other_contacts_it_presses_with_the_same_force():
    stiffness = np.array([5900.0, 5e4, 2.1e5])
    push = excitation(TrapezoidalMovesConfig(), 1 / stiffness)
    np.testing.assert_allclose(push * stiffness, np.tile(push[:, :1] * 5900.0, 3), atol=1e-9)
    assert push[-1] @ stiffness / 3 == pytest.approx(-2e-3 * 5900.0)


def test_a_scale_of_ones_own_holds_for_every_contact():
    push = excitation(TrapezoidalMovesConfig(scale=0.1), [1e-4, 1e-6])
    np.testing.assert_allclose(push[-1], -2e-4)


def write(folder: Path, text: str) -> str:
    file = folder / "profile.csv"
    file.write_text(text, encoding="utf-8")
    return str(file)


def test_a_profile_from_a_file(tmp_path):
    path = write(tmp_path, "displacement,time,remark\n0,0,\n-1e-3,1,\n-1e-3,2,\n0,4,\n")
    config = ExcitationFileConfig(path=path)
    assert config.end_time() == 4.0
    push = excitation(config, [1e-4, 1e-5], 5.0)
    np.testing.assert_allclose(push[[5, 10, 15, 30, 50], 1], [-5e-4, -1e-3, -1e-3, -5e-4, 0.0], atol=1e-15)
    scaled = excitation(ExcitationFileConfig(path=path, scale=None), [1e-5], 5.0)
    np.testing.assert_allclose(scaled[:, 0], 0.059 * push[:, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,force\n0,1\n1,2\n", "displacement"),
        ("time,displacement\n0,0\n1,soft\n", "line 3"),
        ("time,displacement\n0,0\n0,1e-3\n", "increasing"),
        ("time,displacement\n0,0\n1,nan\n", "displacement"),
        ("time,displacement\n0,1e-3\n1,1e-3\n", "constant"),
        ("time,displacement\n0,1e-3\n", "1 rows"),
        ("time,displacement\n0,0\n1,4\n2,0\n", "column displacement is nowhere below zero"),
        ("time,displacement\n0,0\n9,-4\n18,0\n", "column displacement has 4: must be in metres, at most 1 m"),
        ("time,displacement\n0,0\n0.001,-0.05\n2,0\n", "changes by 0.05 m from 0 to 0.001: must be at most 1 m/s"),
        ("time,displacement\n0,0\n1,-\u0661\n", "line 3"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(tmp_path, text, says):
    with pytest.raises(BadInputError, match=says) as caught:
        ExcitationFileConfig(path=write(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert "path" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("depths", [1e-3]),
        ("depths", [1e-3, 1e-3]),
        ("depths", [0.0, math.nan]),
        ("speed", 0.0),
        ("acceleration", -1.0),
        ("rest", -1.0),
        ("start_rest", math.inf),
        ("scale", 0.0),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name):
        TrapezoidalMovesConfig(**{name: value})
