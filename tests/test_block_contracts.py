"""What every block promises: ports as in its docstring, feedthrough, checked parameters, no state outside the Context.

A new block is found by walking the packages and has to be added to `EXAMPLES`.
"""

from __future__ import annotations

import inspect
import math
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.control.adaptive_integral import AdaptiveIntegralForceLaw
from forcectl.control.integral import IntegralConfig, IntegralForceLaw, LinearIntegralForceLaw
from forcectl.control.kinematic_inversion import ConstantKinematicInversion, KinematicInversion
from forcectl.control.sampled_law import SampledLaw
from forcectl.diagrams.force_controller import ForceController
from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.station import STATION_INPUTS, STATION_OUTPUTS, Cell, StationConfig, describe
from forcectl.diagrams.station_kinematic import KinematicStation
from forcectl.diagrams.station_multibody import MultibodyStation
from forcectl.diagrams.station_one_dimensional import OneDimensionalStation
from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.lanes import LaneBlock
from forcectl.motion.references import Reference, held_trajectory
from forcectl.plant.compliance import RobotCompliance
from forcectl.plant.compliant_contact import CompliantContact, LinearContact
from forcectl.plant.contact_monitor import ContactMonitor, ContactMonitorCore
from forcectl.plant.drive import Drive
from forcectl.plant.force_sensor import ForceDigitiser, ForceSensor
from forcectl.plant.position_loop import PositionLoop
from forcectl.plant.servo import Servo, ServoCore
from forcectl.plant.tip_kinematics import ForceToWrench, LinkPosition, TipDisplacement
from forcectl.plant.wrist_sensor import ToolCompensation, WeldWrenches
from forcectl.robot import RobotModel, add_robot
from forcectl.testing import assert_docstring_matches, assert_feedthrough, assert_same_after_reset_and_clone
from forcectl.testing.runs import Input

Z = np.array([0.0, 0.0, 1.0])
START = np.deg2rad([0, 0, -90, 0, 90, 0])
NAN = math.nan


@cache
def robot() -> RobotModel:
    return RobotModel.load()


@cache
def cell(fidelity: str) -> Cell:
    return describe(StationConfig(fidelity=fidelity))


def posture(t: float) -> np.ndarray:
    return START + 0.05 * np.sin(np.arange(1, 7) * (3 * t + 0.1))


def push(t: float) -> np.ndarray:
    """A displacement of two lanes that goes into the surface and leaves it again [m]."""
    return np.array([-2e-3, -1e-3]) * math.sin(60 * t)


def force(t: float) -> np.ndarray:
    return np.array([12.0, 7.0]) * (1 + math.sin(50 * t))


def spectral(t: float) -> np.ndarray:
    return np.concatenate([0.01 * np.array([math.sin(30 * t), t]), [0.3 * math.cos(30 * t), 0.01]])


def law() -> IntegralForceLaw:
    return IntegralForceLaw(2, integral_gain=[1.5, 3.0], period=0.002)


def adaptive() -> AdaptiveIntegralForceLaw:
    estimator = EnvironmentComplianceEstimator(2, initial_compliance=1e-4, robot_compliance=3e-5)
    return AdaptiveIntegralForceLaw(
        law(), estimator, filter_bandwidth=12.6, filter_damping_ratio=1.0, filter_delay_ticks=1, period=0.002
    )


def drive() -> Drive:
    return Drive(
        [2.0, 3.0],
        np.array([[1.0, 0.0], [-0.1, 1.0]]),
        period=0.0005,
        substeps=2,
        position_gain=25.0,
        velocity_gain=200.0,
        integral_gain=15.0,
        coulomb_friction=[5.0, 2.0],
        viscous_friction=[1.0, 0.5],
        initial_position=np.array([0.0, 0.0]),
        initial_torque=np.array([1.0, -1.0]),
    )


def weld_wrenches() -> Diagram:
    """The plant and the block that reads its welds, because the block's input carries no vector."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.001))
    plant.SetUseSampledOutputPorts(False)  # Drake 1.51 does not reset sampled outputs with the rest of its state
    parts = add_robot(plant, "comau_smart_six", "force_probe")
    plant.Finalize()
    read = builder.AddSystem(WeldWrenches(plant, {"sensor": parts.sensor_weld}))
    builder.Connect(plant.get_reaction_forces_output_port(), read.GetInputPort("reaction_forces"))
    builder.ExportOutput(read.GetOutputPort("sensor"), "sensor")
    builder.ExportInput(plant.get_actuation_input_port(), "actuation")
    return builder.Build()


@dataclass(frozen=True)
class Example:
    """One way to build a block; `runnable` is what is simulated when the block cannot run alone."""

    build: Callable[[], System]
    feedthrough: set[tuple[str, str]] = field(default_factory=set)
    inputs: Mapping[str, Input] = field(default_factory=dict)
    runnable: Callable[[], System] | None = None


def each(output: str, *inputs: str) -> set[tuple[str, str]]:
    return {(output, name) for name in inputs}


EXAMPLES: dict[type[System], list[Example]] = {
    CompliantContact: [
        Example(
            lambda: CompliantContact(2, stiffness=[5900, 1e5]),
            each("contact_force", "displacement"),
            {"displacement": push},
        ),
        Example(
            lambda: CompliantContact(2, stiffness=5900, damping=[0, 50], robot_compliance=3e-5),
            each("contact_force", "displacement"),
            {"displacement": push},
        ),
        Example(
            lambda: CompliantContact(2, stiffness=5900, damping=50, compliance_port=True),
            each("contact_force", "displacement", "robot_compliance"),
            {"displacement": push, "robot_compliance": 3e-5},
        ),
    ],
    LinearContact: [
        Example(
            lambda: LinearContact(2, stiffness=[5900, 1e5], robot_compliance=3e-5),
            each("contact_force", "displacement"),
            {"displacement": push},
        )
    ],
    ContactMonitorCore: [Example(lambda: ContactMonitorCore(2), inputs={"contact_force": force})],
    ContactMonitor: [Example(lambda: ContactMonitor(2), inputs={"contact_force": lambda t: force(t) - 8})],
    Drive: [Example(drive, inputs={"reference": spectral, "spring_torque": lambda t: 4 * push(t) / 1e-3})],
    ForceDigitiser: [
        Example(
            lambda: ForceDigitiser(2, noise_std=0.1, quantum=0.05, bias=0.3, range=20, seed=4),
            each("reading", "force"),
            {"force": force},
        )
    ],
    ForceSensor: [
        Example(
            lambda: ForceSensor(2, noise_std=0.1, quantum=0.05, bias=0.3, range=20, seed=[4, 5]),
            each("measured_force", "force"),
            {"force": force},
        ),
        Example(lambda: ForceSensor(2), each("measured_force", "force"), {"force": force}),
        Example(lambda: ForceSensor(2, noise_std=0.1, delay=0.004), inputs={"force": force}),
    ],
    PositionLoop: [
        Example(lambda: PositionLoop(2), inputs={"command": push}),
        Example(lambda: PositionLoop(2, delay=0.004, initial_command=[0.1, 0.2]), inputs={"command": push}),
        Example(lambda: PositionLoop(2, period=0.0), inputs={"command": push}),
    ],
    ServoCore: [Example(lambda: ServoCore(2, unit="m"), inputs={"reference": spectral})],
    Servo: [Example(lambda: Servo(ServoCore(2)), inputs={"reference": spectral})],
    RobotCompliance: [
        Example(
            lambda: RobotCompliance(robot(), Z),
            each("robot_compliance", "motor_position"),
            {"motor_position": posture},
        )
    ],
    TipDisplacement: [
        Example(
            lambda: TipDisplacement(robot(), Z, START),
            each("displacement", "motor_position"),
            {"motor_position": posture},
        )
    ],
    LinkPosition: [
        Example(
            lambda: LinkPosition(robot(), Z, robot().joint_stiffness),
            each("link_position", "motor_position", "contact_force"),
            {"motor_position": posture, "contact_force": lambda t: 15 * t},
        )
    ],
    ForceToWrench: [
        Example(
            lambda: ForceToWrench(robot(), Z),
            each("measured_wrench", "measured_force", "motor_position"),
            {"motor_position": posture, "measured_force": lambda t: 15 * t},
        )
    ],
    WeldWrenches: [
        Example(
            lambda: next(s for s in weld_wrenches().GetSystems() if isinstance(s, WeldWrenches)),
            each("sensor", "reaction_forces"),
            runnable=weld_wrenches,
        )
    ],
    ToolCompensation: [
        Example(
            lambda: ToolCompensation(robot(), Z, START, tared=True),
            each("measured_wrench", "wrench") | each("measured_force", "wrench"),
            {"wrench": lambda t: np.arange(6) * t, "motor_position": posture},
        )
    ],
    AdaptiveIntegralForceLaw: [
        Example(
            adaptive,
            each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "measured_force": force, "motor_displacement": push},
        )
    ],
    IntegralForceLaw: [
        Example(
            law,
            each("displacement_command", "desired_force", "measured_force", "compliance"),
            {"desired_force": 15.0, "measured_force": force, "compliance": [1e-4, 2e-4]},
        ),
        Example(
            lambda: IntegralForceLaw(2, integral_gain=1.5, compliance=1e-4, dead_zone=0.2),
            each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "measured_force": force},
        ),
    ],
    LinearIntegralForceLaw: [
        Example(
            lambda: LinearIntegralForceLaw(2, integral_gain=1.5, compliance=[1e-4, 2e-4], period=0.002),
            each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "measured_force": force},
        )
    ],
    KinematicInversion: [
        Example(
            lambda: KinematicInversion(robot(), Z, START),
            each("joint_position_command", "displacement_command", "unconstrained_reference"),
            {"displacement_command": lambda t: -0.01 * t, "motor_position": posture},
        )
    ],
    ConstantKinematicInversion: [
        Example(
            lambda: ConstantKinematicInversion(np.arange(1.0, 7.0), np.arange(6.0) / 70, START),
            each("joint_position_command", "displacement_command", "unconstrained_reference"),
            {"displacement_command": lambda t: -0.01 * t},
        )
    ],
    EnvironmentComplianceEstimator: [
        Example(
            lambda: EnvironmentComplianceEstimator(2, initial_compliance=1e-4),
            inputs={"measured_force": force, "displacement": push},
        )
    ],
    Reference: [
        Example(lambda: Reference("desired_force", held_trajectory([0, 0.02], [[0, 15], [1, 9]]))),
        Example(lambda: Reference("desired_force", [15.0, 3.0])),
    ],
    ForceController: [
        Example(
            lambda: ForceController(IntegralConfig(), cell("Kinematic")),
            each("joint_position_command", "desired_force", "measured_force", "unconstrained_reference")
            | each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "motor_position": posture},
        )
    ],
    MotorSide: [
        Example(
            lambda: MotorSide(cell("OneDimensional")),
            inputs={"joint_position_command": posture},
        )
    ],
    OneDimensionalStation: [
        Example(lambda: OneDimensionalStation(cell("OneDimensional"), 3), inputs={"joint_position_command": posture})
    ],
    KinematicStation: [
        Example(lambda: KinematicStation(cell("Kinematic"), 3), inputs={"joint_position_command": posture})
    ],
    MultibodyStation: [
        Example(lambda: MultibodyStation(cell("Multibody"), 3), inputs={"joint_position_command": posture})
    ],
}
CASES = [
    pytest.param(kind, example, id=f"{kind.__name__}-{i}")
    for kind, examples in EXAMPLES.items()
    for i, example in enumerate(examples)
]
STATIONS = {OneDimensionalStation, KinematicStation, MultibodyStation}


def declared_blocks() -> set[type[System]]:
    """Every system class of the packages that hold blocks, base classes apart."""
    found = set()
    for package in ("plant", "control", "estimation", "motion", "diagrams"):
        home = import_module(f"forcectl.{package}")
        for info in pkgutil.walk_packages(home.__path__, home.__name__ + "."):
            module = import_module(info.name)
            for kind in vars(module).values():
                if inspect.isclass(kind) and kind.__module__ == module.__name__ and issubclass(kind, System):
                    found.add(kind)
    return found - {SampledLaw}


def test_every_block_has_an_example():
    assert {kind.__name__ for kind in declared_blocks()} == {kind.__name__ for kind in EXAMPLES}


@pytest.mark.parametrize(("kind", "example"), [case for case in CASES if case.values[0] not in STATIONS])
def test_docstring_lists_the_ports(kind, example, monkeypatch):
    block = example.build()
    outputs = [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
    # Blocks whose outputs are named by their user say so in angle brackets.
    for placeholder in ("<one per weld>", "<name>"):
        monkeypatch.setattr(kind, "__doc__", kind.__doc__.replace(placeholder, ", ".join(outputs)))
    if kind is ForceController:  # `(further outputs of the law)`: this law has none
        monkeypatch.setattr(kind, "__doc__", kind.__doc__.replace(", (further outputs of the law)", ""))
    assert_docstring_matches(block)


@pytest.mark.parametrize("kind", STATIONS, ids=lambda kind: kind.__name__)
def test_stations_have_the_ports_of_their_slot(kind):
    station = EXAMPLES[kind][0].build()
    assert [station.get_input_port(i).get_name() for i in range(station.num_input_ports())] == list(STATION_INPUTS)
    assert [station.get_output_port(i).get_name() for i in range(station.num_output_ports())] == list(STATION_OUTPUTS)


@pytest.mark.parametrize("kind", sorted(EXAMPLES, key=lambda k: k.__name__), ids=lambda kind: kind.__name__)
def test_docstring_tells_units_and_sampling(kind):
    """Blocks with ports of their own say a unit in brackets for some port; events are announced under `Sampling:`."""
    text = inspect.getdoc(kind) or ""
    leaf = not issubclass(kind, Diagram)
    if leaf and "input_ports" in text:
        assert "[" in text.split("```")[2], "no unit after the list of ports"


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_feedthrough(kind, example):
    assert_feedthrough(example.build(), example.feedthrough)


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_everything_remembered_is_in_the_context(kind, example):
    system = (example.runnable or example.build)()
    assert_same_after_reset_and_clone(system, duration=0.05, period=0.001, inputs=example.inputs)


# --- parameters of the lane blocks -----------------------------------------------------------------------------------

POSITIVE, NOT_NEGATIVE, FINITE, NUMBER = "positive", "not negative", "finite", "number"
LANE_BLOCKS: dict[type[LaneBlock], tuple[Callable[..., LaneBlock], dict[str, str]]] = {
    CompliantContact: (
        lambda size=2, **changed: CompliantContact(
            size, **{"stiffness": 5900.0, "damping": 10.0, "robot_compliance": 3e-5, **changed}
        ),
        {"stiffness": POSITIVE, "damping": NOT_NEGATIVE, "robot_compliance": NOT_NEGATIVE},
    ),
    ForceDigitiser: (
        lambda size=2, **changed: ForceDigitiser(size, **changed),
        {"bias": FINITE, "noise_std": NOT_NEGATIVE, "quantum": NOT_NEGATIVE, "range": POSITIVE},
    ),
    ServoCore: (
        lambda size=2, **changed: ServoCore(size, **changed),
        {
            "position_gain": POSITIVE,
            "velocity_gain": POSITIVE,
            "integral_gain": NOT_NEGATIVE,
            "coulomb_friction": NOT_NEGATIVE,
            "viscous_friction": NOT_NEGATIVE,
        },
    ),
    IntegralForceLaw: (
        lambda size=2, **changed: IntegralForceLaw(size, **{"integral_gain": 1.5, "compliance": 1e-4, **changed}),
        {
            "integral_gain": NOT_NEGATIVE,
            "dead_zone": NOT_NEGATIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "compliance": POSITIVE,
        },
    ),
    EnvironmentComplianceEstimator: (
        lambda size=2, **changed: EnvironmentComplianceEstimator(size, **{"initial_compliance": 1e-4, **changed}),
        {
            "forgetting": POSITIVE,
            "robot_compliance": NOT_NEGATIVE,
            "minimum_force": NOT_NEGATIVE,
            "lower_bound": NUMBER,
            "upper_bound": NUMBER,
        },
    ),
    ContactMonitorCore: (lambda size=2, **changed: ContactMonitorCore(size, **changed), {}),
}
PARAMETERS = [
    pytest.param(kind, name, allowed, id=f"{kind.__name__}.{name}")
    for kind, (_, names) in LANE_BLOCKS.items()
    for name, allowed in names.items()
]


def bad_values(allowed: str) -> list[object]:
    """Values that no parameter of this kind may take; the bad one is in the second lane only."""
    values: list[object] = [[1.0, NAN], [1.0] * 3, "soft", None, [[1.0, 1.0]]]
    if allowed == POSITIVE:
        values += [[1.0, 0.0], [1.0, -1.0], -1.0]
    if allowed == NOT_NEGATIVE:
        values += [[1.0, -1.0], -1.0]
    return values


def test_every_lane_block_has_its_parameters_in_the_table():
    assert {kind for kind in declared_blocks() if issubclass(kind, LaneBlock)} == set(LANE_BLOCKS)
    for build, names in LANE_BLOCKS.values():
        assert list(build().parameter_names) == list(names)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_bad_parameter_is_refused_by_name_when_built(kind, name, allowed):
    build, _ = LANE_BLOCKS[kind]
    for value in bad_values(allowed):
        if value is None and name == "compliance":
            continue  # no compliance: the port takes its place
        with pytest.raises(BadInputError, match=name) as caught:
            build(**{name: value})
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_bad_parameter_is_refused_by_name_when_set(kind, name, allowed):
    block = LANE_BLOCKS[kind][0]()
    context = block.CreateDefaultContext()
    before = block.parameter(context, name)
    for value in bad_values(allowed):
        with pytest.raises(BadInputError, match=name):
            block.set_parameter(context, name, value)
    np.testing.assert_array_equal(block.parameter(context, name), before)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_parameter_lives_in_the_context(kind, name, allowed):
    block = LANE_BLOCKS[kind][0]()
    context, other = block.CreateDefaultContext(), block.CreateDefaultContext()
    before = block.parameter(other, name)
    wanted = before * 0.9 if np.all(np.isfinite(before)) and np.any(before) else np.array([0.5, 0.25])
    if name == "lower_limit":
        wanted = np.array([-0.5, -0.25])
    block.set_parameter(context, name, wanted)
    np.testing.assert_array_equal(block.parameter(context, name), wanted)
    np.testing.assert_array_equal(block.parameter(other, name), before)
    np.testing.assert_array_equal(block.parameter(context.Clone(), name), wanted)


@pytest.mark.parametrize("kind", LANE_BLOCKS, ids=lambda kind: kind.__name__)
def test_an_unknown_parameter_is_refused_with_the_nearest(kind):
    build, names = LANE_BLOCKS[kind]
    block = build()
    for name in names:
        with pytest.raises(BadInputError, match=name):
            block.set_parameter(block.CreateDefaultContext(), name[:-1] + "x", 1.0)
    with pytest.raises(BadInputError, match="nonsense"):
        block.parameter(block.CreateDefaultContext(), "nonsense")


@pytest.mark.parametrize("kind", LANE_BLOCKS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("size", [0, -1])
def test_a_block_without_lanes_is_refused(kind, size):
    with pytest.raises(BadInputError, match="size"):
        LANE_BLOCKS[kind][0](size)


@pytest.mark.parametrize("kind", LANE_BLOCKS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("period", [0.0, -0.002, NAN, math.inf])
def test_a_bad_period_is_refused(kind, period):
    with pytest.raises(BadInputError, match="period"):
        LANE_BLOCKS[kind][0](period=period)


@pytest.mark.parametrize(
    ("name", "value"), [("forgetting", 1.5), ("lower_bound", 1.0), ("upper_bound", 1e-9), ("upper_bound", -1.0)]
)
def test_the_estimator_keeps_its_own_limits_in_both_ways(name, value):
    """mu is at most 1; the bounds stay in order."""
    build = LANE_BLOCKS[EnvironmentComplianceEstimator][0]
    with pytest.raises(BadInputError, match=name):
        build(**{name: value})
    block = build()
    with pytest.raises(BadInputError, match=name):
        block.set_parameter(block.CreateDefaultContext(), name, value)


@pytest.mark.parametrize(("name", "value"), [("lower_limit", 0.3), ("upper_limit", -0.3)])
def test_the_limits_of_the_integral_law_stay_in_order(name, value):
    build = LANE_BLOCKS[IntegralForceLaw][0]
    with pytest.raises(BadInputError, match=name):
        build(**{"lower_limit": -0.2, "upper_limit": 0.2, name: value})
    block = build(lower_limit=-0.2, upper_limit=0.2)
    with pytest.raises(BadInputError, match=name):
        block.set_parameter(block.CreateDefaultContext(), name, value)
