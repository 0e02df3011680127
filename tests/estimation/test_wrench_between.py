"""The wrench between two arms, against arms that touch: equal and opposite at the place where they do."""

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce

import forcectl as fc
from forcectl.diagrams.signals import WrenchBetweenConfig
from forcectl.errors import BadInputError
from forcectl.estimation.wrench_between import WrenchBetween
from tests.examples.reactive_examples import two_arms

Q = two_arms().parameters.default_posture + 0.1
ON_RIGHT = np.array([0.2, -0.1, 0.3, 4.0, -5.0, 6.0])


def tips():
    context = two_arms().create_context()
    two_arms().set_positions(context, Q)
    arms = two_arms().parts.arms
    return {name: arm.tcp_frame.CalcPoseInWorld(context) for name, arm in arms.items()}


def felt(error_left=0.0, error_right=0.0, **options):
    """The wrench of the left arm on the right one, at its TCP, of what both feel and what is wrong with that."""
    p = {name: pose.translation() for name, pose in tips().items()}
    on_left = SpatialForce(-ON_RIGHT[:3], -ON_RIGHT[3:]).Shift(p["left"] - p["right"]).get_coeffs()
    block = WrenchBetween(two_arms(), ("left", "right"), **options)
    context = block.CreateDefaultContext()
    wrenches = np.concatenate([on_left + error_left, ON_RIGHT + error_right])
    block.GetInputPort("estimated_wrench").FixValue(context, wrenches)
    block.GetInputPort("joint_position").FixValue(context, Q)
    return block.GetOutputPort("wrench").Eval(context)


def test_it_is_what_both_arms_feel():
    np.testing.assert_allclose(felt(), ON_RIGHT, atol=1e-12)


def test_errors_of_the_arms_are_halved():
    np.testing.assert_allclose(felt(error_right=np.full(6, 0.5)) - ON_RIGHT, 0.25, atol=1e-12)
    np.testing.assert_allclose((felt(error_left=np.full(6, 0.5)) - ON_RIGHT)[3:], -0.25, atol=1e-12)


def test_axes_of_the_tool():
    frame = two_arms().parts.arms["right"].tcp_frame
    R = tips()["right"].rotation().matrix()
    turned = np.concatenate([R.T @ ON_RIGHT[:3], R.T @ ON_RIGHT[3:]])
    np.testing.assert_allclose(felt(expressed_in=frame), turned, atol=1e-12)


def scenario(**choice):
    return {
        "preset": "ideal",
        "station": {
            "fidelity": "Multibody",
            "robot": "yumi",
            "drive": "!JointInterface",
            "sensors": {"joints": "!JointReadings"},
            "environment": "!Parts",
        },
        "controller": "!JointMoves",
        "estimators": {"force": "!ForceEstimator"},
        "signals": {"touch": WrenchBetweenConfig(**choice)},
        "duration": 0.02,
    }


def test_in_a_scenario_it_is_a_signal_of_the_log():
    log = fc.run(scenario(between=["left", "right"])).log
    assert log["touch"].shape[1] == 6


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"between": ["left", "right"], "axes": "hand"}, "axes"),
        ({"between": ["left", "middle"]}, "unknown between 'middle': known: left, right"),
        ({"between": ["left", "left"]}, "two different arms"),
        ({"between": ["left", "right"], "of": "joint_position"}, "of shape"),
        ({"between": ["left", "right"], "expressed_in": "hand"}, "expressed_in"),
    ],
)
def test_bad_input_is_named(choice, message):
    with pytest.raises(BadInputError, match=message):
        fc.run(scenario(**choice))


@pytest.mark.parametrize("key", ["axes", "expressed_in"])
def test_a_choice_that_there_is_not_is_named_with_its_key(key):
    with pytest.raises(BadInputError, match=f"unknown {key} 'elbow': known: ") as caught:
        WrenchBetweenConfig(between=["left", "right"], **{key: "elbow"})
    assert caught.value.key == key
