"""With everything switched off that tells them apart, the three fidelities are one loop, and it is the textbook's."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from tests.examples.station_runs import (
    FILTER,
    FORCE,
    PERIOD,
    SENSOR,
    SPRINGS,
    closed_loop,
    continuous_reference,
    sampled_reference,
    signal,
)

FIDELITIES = ("OneDimensional", "Kinematic", "Multibody")
VERTICAL, OBLIQUE = (0.0, 0.0, 1.0), (1.0, 0.0, 1.0)


def ideal(fidelity: str, gain: float, stiffness: float, normal: tuple[float, ...] = VERTICAL, **changes: Any) -> Any:
    """A run of the ideal preset, but with the usual control tick."""
    usual = {"duration": 1.5, "station__period": PERIOD, "station__time_step": 0.001}
    return closed_loop(
        preset="ideal",
        station__fidelity=fidelity,
        station__normal=normal,
        station__environment__stiffness=stiffness,
        controller__integral_gain=gain,
        **(usual | changes),
    )


def measured(*args: Any, **changes: Any) -> np.ndarray:
    return signal(ideal(*args, **changes), "measured_force")


def percent_apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance at any time, in percent of the step."""
    return float(100 * np.abs(a - b).max() / FORCE)


CASES = [(3.0, SPRINGS, VERTICAL), (1.5, 5e4, OBLIQUE)]
SKEW = (0.3, -0.8, 0.5)
# A slow and a fast loop on a soft and on a stiff environment; CASES has what is in between.
MORE_CASES = [
    (1.5, SPRINGS, SKEW),
    (1.5, 1e6, VERTICAL),
    (6.0, SPRINGS, OBLIQUE),
    (6.0, 1e6, SKEW),
]


def assert_all_agree(gain: float, stiffness: float, normal: tuple[float, ...]) -> None:
    forces = {fidelity: measured(fidelity, gain, stiffness, normal) for fidelity in FIDELITIES}
    for a in FIDELITIES:
        for b in FIDELITIES:
            assert percent_apart(forces[a], forces[b]) < 1.0, (a, b)


@pytest.mark.parametrize(("gain", "stiffness", "normal"), CASES)
def test_fidelities_agree_within_one_percent_of_the_step(
    gain: float, stiffness: float, normal: tuple[float, ...]
) -> None:
    assert_all_agree(gain, stiffness, normal)


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "stiffness", "normal"), MORE_CASES)
def test_fidelities_agree_for_other_gains_stiffnesses_and_directions(
    gain: float, stiffness: float, normal: tuple[float, ...]
) -> None:
    assert_all_agree(gain, stiffness, normal)


@pytest.mark.parametrize("gain", [0.7, 1.5, 3.0, 6.0])
@pytest.mark.parametrize("normal", [VERTICAL, OBLIQUE])
def test_one_dimensional_station_is_the_continuous_plant_under_the_sampled_law(
    gain: float, normal: tuple[float, ...]
) -> None:
    force = measured("OneDimensional", gain, 5e4, normal)
    assert percent_apart(force, sampled_reference(len(force) - 1, gain)) < 0.1


@pytest.mark.parametrize(("gain", "stiffness"), [(1.5, SPRINGS), (3.0, SPRINGS), (6.0, 5e4)])
def test_kinematic_station_along_the_tool_is_the_same_continuous_plant(gain: float, stiffness: float) -> None:
    force = measured("Kinematic", gain, stiffness)
    assert percent_apart(force, sampled_reference(len(force) - 1, gain)) < 0.1


def test_exact_reference_is_what_an_integrator_of_another_kind_finds() -> None:
    """The reference itself, tick by tick with Dormand-Prince instead of the matrix exponential."""
    gain, count, z = 3.0, 250, np.zeros(4)
    command, found = 0.0, []

    def rates(_: float, z: np.ndarray, command: float) -> list[float]:
        x, dx, f, df = z
        return [dx, FILTER**2 * (command - x) - 2 * FILTER * dx, df, SENSOR**2 * (x - f) - 2 * SENSOR * df]

    for _ in range(count + 1):
        found.append(z[2])
        command += gain * PERIOD * (FORCE - z[2])
        z = solve_ivp(rates, (0.0, PERIOD), z, method="DOP853", rtol=1e-11, atol=1e-12, args=(command,)).y[:, -1]
    np.testing.assert_allclose(found, sampled_reference(count, gain), atol=1e-9)


@pytest.mark.parametrize(("gain", "normal"), [(3.0, OBLIQUE), (6.0, OBLIQUE)])
def test_kinematic_station_follows_the_curved_kinematics_of_the_robot(gain: float, normal: tuple[float, ...]) -> None:
    """Reference: all six joint filters in continuous time, forward kinematics, spring and force filter."""
    workcell = describe(StationConfig(fidelity="Kinematic", normal=list(normal), elastic_joints=False))
    robot, q_0, context = workcell.robot, workcell.start, workcell.start_context()
    start = float(workcell.contact.n @ robot.pose(context).translation())
    count, displacement = 500, 0.0
    z = np.concatenate([q_0, np.zeros(6), np.zeros(2)])  # joints, their rates, measured force and its rate

    def rates(_: float, z: np.ndarray, command: np.ndarray) -> np.ndarray:
        q, rate, f, df = z[:6], z[6:12], z[12], z[13]
        robot.set_positions(context, q)
        force = max(0.0, -SPRINGS * (float(workcell.contact.n @ robot.pose(context).translation()) - start))
        bend = FILTER**2 * (command - q) - 2 * FILTER * rate
        return np.concatenate([rate, bend, [df, SENSOR**2 * (force - f) - 2 * SENSOR * df]])

    found = []
    for _ in range(count + 1):
        found.append(z[12])
        displacement -= gain * PERIOD * (FORCE - z[12]) / SPRINGS
        robot.set_positions(context, z[:6])
        direction = np.linalg.solve(robot.jacobian(context), np.concatenate([np.zeros(3), workcell.contact.n]))
        command = q_0 + direction * displacement
        z = solve_ivp(rates, (0.0, PERIOD), z, rtol=1e-7, atol=1e-9, args=(command,)).y[:, -1]
    force = measured("Kinematic", gain, SPRINGS, normal)[: count + 1]
    assert percent_apart(force, np.array(found)) < 0.1
    # The curvature is there to be followed: the straight-line loop is further away than that.
    assert percent_apart(force, sampled_reference(count, gain)) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("fidelity", "allowed"), [("OneDimensional", 0.1), ("Kinematic", 0.1), ("Multibody", 0.3)])
@pytest.mark.parametrize(("gain", "stiffness", "normal"), [(3.0, SPRINGS, VERTICAL), (4.5, 1e6, SKEW)])
def test_the_ideal_preset_is_the_continuous_loop(
    fidelity: str, allowed: float, gain: float, stiffness: float, normal: tuple[float, ...]
) -> None:
    """To 0.1 % of the step; the multibody robot's wrist sensor also feels the inertia of the tool."""
    log = closed_loop(
        preset="ideal",
        duration=1.0,
        station__fidelity=fidelity,
        station__normal=normal,
        station__environment__stiffness=stiffness,
        controller__integral_gain=gain,
    )
    some = slice(None, None, 40)
    reference = continuous_reference(signal(log, "time")[some], gain)
    assert percent_apart(signal(log, "measured_force")[some], reference) < allowed


@pytest.mark.parametrize(("gain", "stiffness", "normal"), [(1.5, SPRINGS, OBLIQUE), (4.5, 2e5, VERTICAL)])
def test_faster_sampling_converges_to_the_continuous_loop(
    gain: float, stiffness: float, normal: tuple[float, ...]
) -> None:
    times = np.arange(0.0, 1.0, 0.02)
    reference = continuous_reference(times, gain)
    distance = []
    for period in (0.002, 0.001, 0.0005):
        steps = {"station__period": period, "station__time_step": period}
        log = ideal("OneDimensional", gain, stiffness, normal, duration=1.0, **steps)
        at_times = np.searchsorted(signal(log, "time"), times - 1e-9)
        distance.append(np.abs(signal(log, "measured_force")[at_times] - reference).max())
    # A held command is late by half a period: the error is of first order.
    assert distance[0] < 0.01 * FORCE
    assert distance[0] / distance[1] == pytest.approx(2.0, rel=0.1)
    assert distance[1] / distance[2] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("damping_time", [0.005, 0.02])
def test_damped_environment_is_a_spring_and_a_damper_in_parallel(damping_time: float) -> None:
    stiffness = 5e4
    changes = {"station__environment__damping": damping_time * stiffness}
    reference = sampled_reference(750, 3.0, damping_time=damping_time)
    undamped = sampled_reference(750, 3.0)
    for fidelity in ("OneDimensional", "Kinematic"):
        force = measured(fidelity, 3.0, stiffness, **changes)
        # The deformation is sampled every tick, which the undamped loop does not notice.
        assert percent_apart(force, reference) < 0.2
    assert percent_apart(measured("Multibody", 3.0, stiffness, **changes), reference) < 1.0
    assert reference.max() < undamped.max()
