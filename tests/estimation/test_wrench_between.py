"""The wrench between two arms, against arms that touch: equal and opposite at the place where they do."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce

import forcectl as fc
from forcectl.diagrams.signals import WrenchBetweenConfig
from forcectl.errors import BadInputError
from forcectl.estimation.force_estimator import KalmanForceEstimatorConfig
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


def covariance(seed):
    """Of a wrench, with torques known to some hundredths and forces to some tenths, in all mixtures."""
    root = np.random.default_rng(seed).normal(size=(6, 6)) * np.array([0.03, 0.03, 0.03, 0.3, 0.3, 0.3])[:, None]
    return root @ root.T


def weighted(z_left, z_right, P_left, P_right):
    """What the block makes of estimates in the axes of the TCPs, with their covariances there."""
    block = WrenchBetween(two_arms(), ("left", "right"), local=True, weighted=True)
    context = block.CreateDefaultContext()
    values = {"estimated_wrench": [z_left, z_right], "wrench_covariance": [P_left, P_right], "joint_position": [Q]}
    for name, parts in values.items():
        block.GetInputPort(name).FixValue(context, np.concatenate([np.ravel(part) for part in parts]))
    return block.GetOutputPort("wrench").Eval(context)


def features():
    """What the arms would read of each component of the wrench on the right one, in the axes of their TCPs."""
    left, right = tips()["left"], tips()["right"]
    columns = []
    for one in np.eye(6):
        on_right = SpatialForce(one[:3], one[3:])
        on_left = SpatialForce(-on_right.Shift(left.translation() - right.translation()).get_coeffs())
        columns.append(
            [
                pose.rotation().inverse().multiply(part)
                for pose, wrench in ((left, on_left), (right, on_right))
                for part in (wrench.rotational(), wrench.translational())
            ]
        )
    return np.reshape(columns, (6, 12)).T


@pytest.mark.parametrize("part", [slice(0, 3), slice(3, 6)], ids=["torque", "force"])
def test_weighted_it_is_the_least_squares_of_what_both_arms_feel(part):
    """Of forces and of torques alone: whitened readings of both at the right TCP, solved as one system."""
    P, H = (covariance(1), covariance(2)), features()
    z = H @ ON_RIGHT + np.random.default_rng(3).normal(size=12) * 0.2
    rows, values = [], []
    for i in (0, 1):
        there = np.linalg.inv(H[6 * i : 6 * i + 6])
        root = np.linalg.inv(np.linalg.cholesky((there @ P[i] @ there.T)[part, part]))
        rows.append(root)
        values.append(root @ (there @ z[6 * i : 6 * i + 6])[part])
    expected = np.linalg.lstsq(np.vstack(rows), np.concatenate(values))[0]
    np.testing.assert_allclose(weighted(z[:6], z[6:], *P)[part], expected, atol=1e-9)
    assert np.abs(ON_RIGHT[part] - expected).max() > 0.01


def test_an_arm_that_feels_nothing_does_not_count():
    z = features() @ ON_RIGHT + np.r_[np.ones(6), np.zeros(6)]
    np.testing.assert_allclose(weighted(z[:6], z[6:], 1e6 * np.eye(6), covariance(1)), ON_RIGHT, atol=1e-4)


@pytest.mark.parametrize("known", [np.zeros((6, 6)), np.diag([0, 0, 0, 1.0, 1, 1])])
def test_covariances_that_have_no_inverse(known):
    """Forces only, or nothing yet."""
    z = features() @ ON_RIGHT
    np.testing.assert_allclose(weighted(z[:6], z[6:], known, known), ON_RIGHT, atol=1e-9)


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


def test_in_a_scenario_it_can_be_weighted():
    """By what the filters know; that itself is not logged."""
    choice = {"between": ["left", "right"], "of": "estimated_local_wrench", "axes": "tcp", "weights": "covariance"}
    estimators = {"force": KalmanForceEstimatorConfig(expressed_in="tcp")}
    log = fc.run(scenario(**choice) | {"estimators": estimators}).log
    assert np.isfinite(log["touch"].values).all()
    assert np.ptp(log["touch"].values) > 0
    assert "wrench_covariance" not in log


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"between": ["left", "right"], "weights": "covariance"}, "wrench_covariance, which nothing puts out"),
        ({"between": ["left", "right"], "weights": "best"}, "weights"),
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


@pytest.mark.parametrize("key", ["axes", "weights", "expressed_in"])
def test_a_choice_that_there_is_not_is_named_with_its_key(key):
    with pytest.raises(BadInputError, match=f"unknown {key} 'elbow': known: ") as caught:
        WrenchBetweenConfig(between=["left", "right"], **{key: "elbow"})
    assert caught.value.key == key
