"""Compliant contact against closed forms and an independent fine integration."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.plant.contact.compliant_contact import (
    CompliantContact,
    EnvironmentConfig,
    damped_contact,
    dissipative_contact,
    elastic_force,
)
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.contact.surface_materials import MaterialsConfig, SegmentConfig
from forcectl.plant.linear_contact import LinearContact
from forcectl.testing import assert_ports, run_diagram

displacements = st.floats(-1e-2, 1e-2)
stiffnesses = st.floats(1e3, 1e6)
compliances = st.floats(0.0, 1e-3)


def force_at(block: CompliantContact | LinearContact, dx: object, **inputs: object) -> np.ndarray:
    """The force at once, without any event."""
    context = block.CreateDefaultContext()
    for name, value in {"displacement": dx, **inputs}.items():
        block.GetInputPort(name).FixValue(context, np.atleast_1d(value))
    return block.GetOutputPort("contact_force").Eval(context)


def fine_contact(
    dx: Callable[[float], float], duration: float, period: float, *, k: float, d: float, c_r: float, steps: int = 400
) -> tuple[np.ndarray, np.ndarray]:
    """Force and deformation at the ticks, by explicit integration with tiny steps (needs c_r > 0).

    Touching: -dx = c_r F + z and F = k z + d z', so z' = ((-dx - z)/c_r - k z)/d; apart: F = 0 and k z + d z' = 0.
    """
    z, dt = 0.0, period / steps
    forces, deformations = [], []
    for i in range(round(duration / period) + 1):
        forces.append(max(0.0, (-dx(i * period) - z) / c_r))
        deformations.append(z)
        for j in range(steps):
            pressed = max(0.0, (-dx(i * period + j * dt) - z) / c_r)
            z += dt * (pressed - k * z) / d
    return np.array(forces), np.array(deformations)


@given(displacements, stiffnesses, compliances)
@settings(max_examples=50)
def test_force_is_displacement_over_total_compliance(dx, k, c_r):
    """F = max(0, -dx/C_T), C_T = C_R + 1/K_E. (2.7), (2.8)"""
    block = CompliantContact(1, stiffness=k, robot_compliance=c_r)
    expected = max(0.0, -dx / (c_r + 1 / k))
    assert force_at(block, dx).item() == pytest.approx(expected, rel=1e-12)
    assert elastic_force(dx, 1 / (c_r + 1 / k)) == pytest.approx(expected, rel=1e-12)


@given(displacements, displacements, stiffnesses, st.floats(0.0, 1e4), compliances)
@settings(max_examples=50)
def test_a_step_fulfils_its_own_equations(dx, z, k, rate, c_r):
    """-dx = C_R F + z+ while touching and F = K z+ + D/h (z+ - z); never pulling; free relaxation when lost."""
    force, after = damped_contact(dx, z, k, rate, c_r)
    scale = k * 1e-2 + rate * 2e-2
    assert force >= 0.0
    if force > 0.0:
        assert -dx == pytest.approx(c_r * force + after, abs=1e-12)
        assert force == pytest.approx(k * after + rate * (after - z), abs=1e-9 * scale)
    else:
        assert k * after + rate * (after - z) == pytest.approx(0.0, abs=1e-9 * scale)
        assert after >= -dx - 1e-12, "the surface has not passed through the tool"


def test_zero_damping_in_the_damped_form_is_the_elastic_form():
    block = CompliantContact(2, stiffness=5900.0, damping=[0.0, 30.0], robot_compliance=3.2e-5)
    log = run_diagram(block, 0.2, period=0.002, inputs={"displacement": lambda t: [1e-3 * math.sin(40 * t)] * 2})
    t = log.time
    expected = np.maximum(0.0, -1e-3 * np.sin(40 * t) / (3.2e-5 + 1 / 5900))
    np.testing.assert_allclose(log["contact_force"][:, 0], expected, atol=1e-12 * 5)
    assert np.max(np.abs(log["contact_force"][:, 1] - expected)) > 0.1


def test_a_vanishing_damper_or_robot_compliance_is_a_limit():
    """No jump at D_E = 0 and none at C_R = 0."""
    dx = {"displacement": lambda t: 1e-3 * math.sin(40 * t) - 5e-4}

    def forces(**changed: float) -> np.ndarray:
        block = CompliantContact(1, **{"stiffness": 5900.0, "damping": 20.0, "robot_compliance": 0.0, **changed})
        return run_diagram(block, 0.3, period=0.002, inputs=dx)["contact_force"]

    np.testing.assert_allclose(forces(robot_compliance=1e-14), forces(), atol=1e-5)
    np.testing.assert_allclose(forces(damping=1e-8), forces(damping=0.0), atol=1e-5)


def test_a_stiff_robot_feels_spring_and_damper_directly():
    """C_R = 0: F = K z + D z' with z = -dx; a ramp gives exactly that."""
    speed, k, d = 0.01, 5900.0, 40.0
    block = CompliantContact(1, stiffness=k, damping=d)
    log = run_diagram(block, 0.1, period=0.002, inputs={"displacement": lambda t: -speed * t})
    np.testing.assert_allclose(log["contact_force"][1:, 0], k * speed * log.time[1:] + d * speed, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("d", [5.0, 50.0, 500.0])
def test_damping_agrees_with_a_fine_integration(d):
    """Backward Euler: close to the truth, and the error is of first order in the period."""
    k, c_r = 5900.0, 3.2e-5

    def dx(t: float) -> float:
        return -1e-3 * (1 - math.cos(20 * t))

    def error(period: float) -> float:
        block = CompliantContact(1, stiffness=k, damping=d, robot_compliance=c_r, period=period)
        log = run_diagram(block, 0.4, period=period, inputs={"displacement": dx})
        truth, _ = fine_contact(dx, 0.4, period, k=k, d=d, c_r=c_r, steps=max(20, round(period / 1e-5)))
        return float(np.max(np.abs(log["contact_force"][:, 0] - truth)) / np.max(truth))

    assert error(0.002) < 0.03
    assert error(0.0002) < 0.003
    assert error(0.0002) == pytest.approx(error(0.0004) / 2, rel=0.25)


def test_contact_is_lost_and_found_again():
    """Quick withdrawal: the damper cannot pull, the surface comes back by itself and is met further in."""
    k, d, c_r, period = 5900.0, 300.0, 3.2e-5, 0.0005

    def dx(t: float) -> float:
        if t < 0.2:
            return -2e-3
        return 1e-3 if t < 0.22 else -2e-3 * math.sin(30 * (t - 0.22))

    block = CompliantContact(1, stiffness=k, damping=d, robot_compliance=c_r, period=period)
    log = run_diagram(block, 0.4, period=period, inputs={"displacement": dx})
    force = log["contact_force"][:, 0]
    truth, z = fine_contact(dx, 0.4, period, k=k, d=d, c_r=c_r, steps=50)
    assert np.all(force >= 0.0)
    away = (log.time > 0.2005) & (log.time < 0.22)
    assert np.all(force[away] == 0.0)
    # The surface was left 2 mm in and relaxes with d/k = 51 ms; the tool meets it where it is by then, not at 0.
    met = np.flatnonzero((log.time > 0.22) & (force > 0.0))[0]
    assert -dx(log.time[met]) == pytest.approx(z[met], abs=1e-4)
    assert -dx(log.time[met]) > 5e-4
    # The step at 0.2 s apart, where a single tick differs, both forces agree.
    settled = np.abs(log.time - 0.2) > 0.002
    assert np.max(np.abs(force - truth)[settled]) < 0.05 * np.max(truth[settled])


@pytest.mark.slow
def test_left_alone_the_surface_relaxes_exponentially():
    """Seen through the force of a probe that touches again at a known depth."""
    k, d, period = 5900.0, 300.0, 1e-4
    for pause in (0.02, 0.05, 0.1):
        z = 2e-3 * math.exp(-pause * k / d)

        def dx(t: float, pause: float = pause) -> float:
            if t < 0.3:
                return -2e-3
            return 1e-2 if t < 0.3 + pause else -2e-3

        block = CompliantContact(1, stiffness=k, damping=d, robot_compliance=1e-3, period=period)
        log = run_diagram(block, 0.3 + pause, period=period, inputs={"displacement": dx})
        # F = (-dx - z)/C_R; one implicit step of the damper is already in z, hence the tolerance.
        held = 2e-3 * k * 1e-3 / (1 + k * 1e-3)  # C_R F while pressing at rest
        z_rest = 2e-3 - held
        expected = (2e-3 - z_rest * z / 2e-3) / 1e-3
        assert log["contact_force"][-1, 0] == pytest.approx(expected, rel=0.01)


def test_no_contact_gives_exactly_zero():
    for block in (
        CompliantContact(3, stiffness=[1e3, 1e5, 1e6], robot_compliance=3e-5),
        CompliantContact(3, stiffness=[1e3, 1e5, 1e6], damping=50.0),
    ):
        log = run_diagram(block, 0.1, period=0.002, inputs={"displacement": lambda t: [0.0, 1e-9, t]})
        assert np.all(log["contact_force"] == 0.0)


def test_parameters_act_at_once():
    block = CompliantContact(2, stiffness=1000.0, robot_compliance=0.0)
    context = block.CreateDefaultContext()
    block.GetInputPort("displacement").FixValue(context, [-1e-3, -1e-3])
    output = block.GetOutputPort("contact_force")
    np.testing.assert_allclose(output.Eval(context), [1.0, 1.0])
    block.set_parameter(context, "stiffness", [2000.0, 3000.0])
    np.testing.assert_allclose(output.Eval(context), [2.0, 3.0])
    block.set_parameter(context, "robot_compliance", [1 / 2000, 1 / 1000])
    np.testing.assert_allclose(output.Eval(context), [1.0, 0.75])


def test_an_undamped_contact_has_no_state_and_refuses_damping_later():
    block = CompliantContact(1, stiffness=1000.0)
    context = block.CreateDefaultContext()
    assert context.num_discrete_state_groups() == 0
    with pytest.raises(BadInputError, match="damping"):
        block.set_parameter(context, "damping", 3.0)


def test_ports():
    assert_ports(CompliantContact(2, stiffness=1e3), {"displacement": 2}, {"contact_force": 2})


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"stiffness": 0.0}, "stiffness"),
        ({"stiffness": math.inf}, "stiffness"),
        ({"stiffness": 1e3, "robot_compliance": -1e-5}, "robot_compliance"),
        ({"stiffness": [1e3, 1e4, 1e5]}, "stiffness"),
    ],
)
@pytest.mark.parametrize("kind", [CompliantContact, LinearContact])
def test_bad_arguments_are_refused(kind, arguments, told):
    with pytest.raises(BadInputError, match=told):
        kind(2, **arguments)


@pytest.mark.parametrize(
    ("name", "value"),
    [("stiffness", 0.0), ("stiffness", -5.0), ("stiffness", math.nan), ("stiffness", math.inf), ("damping", -1.0)],
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        EnvironmentConfig(**{name: value})


def test_a_two_sided_contact_with_a_damper_is_that_of_the_torque_on_a_peg():
    """F = -(K dx + D dx') (6.1), of a rigid robot on a flat surface."""
    config = EnvironmentConfig(stiffness=500.0, damping=100.0, one_sided=False)
    block = config.add_to(DiagramBuilder(), 2, 0.004)
    context = block.CreateDefaultContext()
    block.GetInputPort("displacement").FixValue(context, [-0.2, 0.1])
    block.GetInputPort("displacement_velocity").FixValue(context, [0.5, 0.0])
    np.testing.assert_allclose(block.GetOutputPort("contact_force").Eval(context), [100.0 - 50.0, -50.0])
    np.testing.assert_allclose(config.sampled_response(500.0, 0.0, 0.004).D, [[-500.0, -100.0]])
    with pytest.raises(
        BadInputError, match=r"damping .* must be 0 with one_sided = false, unless elastic_joints = false"
    ):
        config.add_to(DiagramBuilder(), 1, 0.004, robot_compliance=1e-5)
    with pytest.raises(BadInputError, match=r"damping = 100.0: must be 0 with one_sided = false and heights"):
        EnvironmentConfig(damping=100.0, one_sided=False, surface=SurfaceConfig(slope=0.1))


def test_a_pressed_surface_is_one_of_its_segments_and_its_dissipation_is_damping():
    """F = K z (1 + d z') about F_0 = K z_0 is F_0 + K dz + F_0 d z'."""
    dissipative = EnvironmentConfig(stiffness=5e3, dissipation=20.0).pressed("stiffness", 15.0)
    plain = EnvironmentConfig(stiffness=5e3, damping=300.0).sampled_response(5e3, 3e-5, 0.002)
    np.testing.assert_array_equal(dissipative.sampled_response(5e3, 3e-5, 0.002).D, plain.D)
    halves = [
        SegmentConfig(material="custom", start=-0.1, end=0.0, stiffness=1e3, damping=0.0),
        SegmentConfig(material="custom", start=0.0, end=0.1, stiffness=5e3, damping=300.0),
    ]
    config = EnvironmentConfig(surface=SurfaceConfig(materials=MaterialsConfig(segments=halves)))
    second = config.pressed(list(config.stiffnesses())[1], 15.0)
    assert second.stiffnesses() == {"stiffness": 5e3}
    np.testing.assert_array_equal(second.sampled_response(5e3, 3e-5, 0.002).D, plain.D)
    assert len(config.stiffnesses()) == 2, "the configuration itself is as before"


@pytest.mark.parametrize(("one_sided", "kind"), [(True, CompliantContact), (False, LinearContact)])
def test_config_adds_the_block(one_sided, kind):
    builder = DiagramBuilder()
    block = EnvironmentConfig(stiffness=2e4, one_sided=one_sided).add_to(builder, 2, 0.002, robot_compliance=5e-5)
    assert isinstance(block, kind)
    np.testing.assert_allclose(force_at(block, [-1e-3, -2e-3]), [10.0, 20.0])
    np.testing.assert_allclose(force_at(block, [1e-3, 0.0]), [0.0 if one_sided else -10.0, 0.0])


def test_a_two_sided_spring_cannot_start_away_from_the_tool():
    with pytest.raises(BadInputError, match=r"one_sided = False: must be true with surface.gap"):
        EnvironmentConfig(one_sided=False, surface=SurfaceConfig(gap=0.01))


@given(displacements, st.floats(0.0, 1e-2), stiffnesses, st.floats(0.1, 1e3), compliances)
@settings(max_examples=50)
def test_a_step_with_dissipation_fulfils_its_own_equations(dx, z, k, rate, c_r):
    """-dx = C_R F + z+ while touching and F = K z+ (1 + d/h (z+ - z)); never pulling; free relaxation when lost."""
    force, after = dissipative_contact(dx, z, k, rate, c_r)
    assert force >= 0.0
    if force > 0.0:
        assert -dx == pytest.approx(c_r * force + after, abs=1e-11)
        assert force == pytest.approx(k * after * (1 + rate * (after - z)), rel=1e-9, abs=1e-9)
    else:
        assert after == pytest.approx(max(z - 1 / rate, 0.0))
        assert after >= -dx - 1e-12, "the surface has not passed through the tool"


@pytest.mark.parametrize("c_r", [0.0, 3.2e-5])
def test_dissipation_agrees_with_the_law_of_hunt_and_crossley(c_r):
    """Pressed by a known force law: z(t) given, dx = -(C_R F + z), F = K z (1 + d z')."""
    k, d, period = 5900.0, 20.0, 1e-4

    def z(t: float) -> float:
        return 1e-3 * (1 - math.cos(20 * t))

    def truth(t: float) -> float:
        return k * z(t) * (1 + d * 20e-3 * math.sin(20 * t))

    block = CompliantContact(1, stiffness=k, dissipation=d, robot_compliance=c_r, period=period)
    log = run_diagram(block, 0.3, period=period, inputs={"displacement": lambda t: -(c_r * truth(t) + z(t))})
    expected = np.array([truth(t) for t in log.time])
    assert expected.max() > 1.1 * 2e-3 * k  # beside the spring alone
    np.testing.assert_allclose(log["contact_force"][:, 0], expected, atol=0.005 * expected.max())


def test_a_surface_with_dissipation_takes_energy_begins_at_zero_and_never_pulls():
    speed, k, d, period = 0.1, 1e4, 5.0, 1e-4

    def dx(t: float) -> float:
        return 1e-3 * math.cos(speed / 1e-3 * t)  # in and out of the surface, 0.1 m/s at the touch

    block = CompliantContact(1, stiffness=k, dissipation=d, period=period)
    log = run_diagram(block, 0.06, period=period, inputs={"displacement": dx})
    force = log["contact_force"][:, 0]
    assert force.min() == 0.0
    assert np.diff(force).max() < 2 * k * speed * period * (1 + d * speed)
    depth = np.array([-dx(t) for t in log.time])
    taken = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(depth))
    # Over one cycle of a sine: the integral of K d z z'^2.
    assert taken == pytest.approx(k * d * 1e-3**3 * (speed / 1e-3) * 2 / 3, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({"damping": 10.0}, "dissipation = 2.0: must be 0 with damping"),
        ({"one_sided": False}, "dissipation = 2.0: must be 0 with one_sided = false"),
    ],
)
def test_dissipation_stands_in_place_of_other_laws(changes, refused):
    with pytest.raises(BadInputError, match=refused):
        EnvironmentConfig(dissipation=2.0, **changes)


def test_a_block_has_damping_or_dissipation():
    with pytest.raises(BadInputError, match=r"dissipation = 2.0: must be 0 with damping"):
        CompliantContact(1, stiffness=5900.0, damping=10.0, dissipation=2.0)
