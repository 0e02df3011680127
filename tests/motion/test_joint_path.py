"""Joint motion as a function of time: positions and speeds that belong together, rest at the ends, limits kept."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.model import plant_model
from forcectl.errors import BadInputError
from forcectl.motion.joint_path import DitherConfig, JointExcitationConfig, Move, Sines, path_at
from tests.examples.block_examples_joint_interface import workcell

START = np.array([0.2, -0.5])


@settings(deadline=None)
@given(st.floats(0.0, 3.0), st.floats(0.1, 2.0), st.floats(0.05, 1.0), st.floats(0.0, 2 * np.pi))
def test_the_speed_is_the_derivative_of_the_position(time, duration, ramp, phase):
    parts = [
        Move(0.5, duration, np.array([0.3, -1.0])),
        Sines(0.2, 2.5, ramp, np.array([0.1, 0.4]), np.array([1.0, 3.0]), np.array([phase, 0.0])),
    ]
    h = 1e-6
    before, after = path_at(time - h, START, parts)[0], path_at(time + h, START, parts)[0]
    # Where a ramp begins or ends, its curvature jumps.
    np.testing.assert_allclose(path_at(time, START, parts)[1], (after - before) / (2 * h), atol=1e-3)


def test_a_move_ends_where_it_was_to_and_rests():
    move = Move(1.0, 0.5, np.array([0.3, -1.0]))
    for time, share in ((0.0, 0.0), (1.0, 0.0), (1.25, 0.5), (1.5, 1.0), (9.0, 1.0)):
        position, speed = move.at(time)
        np.testing.assert_allclose(position, share * move.step, atol=1e-12)
        if share != 0.5:
            np.testing.assert_array_equal(speed, [0.0, 0.0])
    # The fastest point is in the middle: 1.875 of the mean.
    np.testing.assert_allclose(move.at(1.25)[1], 1.875 * move.step / 0.5)


def test_sines_are_at_rest_outside_of_their_time():
    sines = Sines(1.0, 2.0, 0.2, np.array([0.1, 0.4]), np.array([1.0, 3.0]), np.array([0.5, 0.0]))
    for time in (0.0, 1.0, 2.0, 5.0):
        for values in sines.at(time):
            np.testing.assert_array_equal(values, [0.0, 0.0])


def test_an_excitation_keeps_the_limits_of_the_joints():
    model = plant_model(workcell())
    limits = model.robot.limits
    config = JointExcitationConfig(speed_shares=[0.2, 1.0], duration=3.0, frequency=0.8)
    path = config.add_to(DiagramBuilder(), model)
    context = path.CreateDefaultContext()
    q, v = [], []
    for time in np.arange(0.0, 6.0, 0.004):
        context.SetTime(time)
        q.append(path.GetOutputPort("joint_position_command").Eval(context))
        v.append(path.GetOutputPort("joint_velocity_command").Eval(context))
    q, v = np.array(q), np.array(v)
    assert (q > limits.position_lower).all()
    assert (q < limits.position_upper).all()
    assert (np.abs(v) <= 1.1 * limits.velocity).all()  # the ramps add a little
    assert (np.abs(np.diff(v, axis=0)) / 0.004 <= 1.5 * limits.acceleration).all()
    # Both ways, and all of them at different times.
    assert (v.max(axis=0) > 0.1 * limits.velocity).all()
    assert (v.min(axis=0) < -0.1 * limits.velocity).all()


def test_a_dither_never_lets_all_joints_rest():
    (sines,) = DitherConfig(amplitude_deg=1.0, frequency=5.0).parts(7)
    slowest = min(np.abs(sines.at(t)[1]).max() for t in np.arange(1.0, 2.0, 0.001))
    assert slowest > 0.5 * np.radians(1.0) * 2 * np.pi * 5.0
    assert DitherConfig().parts(7) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed_shares": []}, "speed_shares = \\[\\]: must be at least one"),
        ({"speed_shares": [1.5]}, "speed_shares.0 = 1.5"),
        ({"frequency_spread": 0.5}, "frequency_spread = 0.5"),
        ({"room_share": 1.0}, "room_share = 1.0"),
        ({"duration": 0.0}, "duration = 0"),
    ],
)
def test_an_excitation_that_cannot_be_is_refused(options, message):
    with pytest.raises(BadInputError, match=message):
        JointExcitationConfig(**options)
