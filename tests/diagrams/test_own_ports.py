"""Ports and block names of the user's parts: connected by name, or refused in one line that names the part."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

import forcectl as fc
from forcectl.framework.yaml_tree import Tagged

FORCES = {"desired_force": 1, "measured_force": 1}


class Block(LeafSystem):
    """Reads all of its inputs at every tick, and puts out a constant."""

    def __init__(self, inputs: dict[str, int], outputs: dict[str, int], value: float, optional: tuple[str, ...]):
        super().__init__()
        self.optional_inputs = optional
        ports = [self.DeclareVectorInputPort(name, size) for name, size in inputs.items()]

        def read(context: Any, state: Any) -> None:
            state.set_value([sum(float(np.sum(p.Eval(context) ** 2)) for p in ports if p.HasValue(context))])

        total = self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(0.002, 0.0, read)
        for name, size in outputs.items():
            if name == "sum_of_inputs":
                self.DeclareStateOutputPort(name, total)
            else:
                self._declare(name, np.full(size, value))

    def _declare(self, name: str, value: Any) -> None:
        self.DeclareVectorOutputPort(name, len(value), lambda c, o: o.SetFromVector(value), {self.nothing_ticket()})


class Part:
    """Fills the slots of parts that only have to add a block."""

    def __init__(
        self,
        inputs: dict[str, int],
        outputs: dict[str, int],
        *,
        value: float = 0.0,
        name: str = "mine",
        optional: tuple[str, ...] = (),
    ):
        self.inputs, self.outputs, self.value, self.name, self.optional = inputs, outputs, value, name, optional

    def largest_force(self) -> float:
        return self.value

    def add_to(self, builder: Any, *arguments: Any) -> Any:
        made = Block(self.inputs, self.outputs, self.value, self.optional)
        return builder.AddNamedSystem(self.name, made)


def law(further: dict[str, int], **named: Any) -> Part:
    outputs = {"displacement_command": 1, "sum_of_inputs": 1}
    return Part(FORCES | further, outputs, value=-1e-4, **named)


def force(value: float = 0.0, name: str = "cell", size: int = 1) -> Part:
    return Part({"contact_force": 1}, {"measured_force": size}, value=value, name=name)


def scenario(station: dict[str, Any] | None = None, **parts: Any) -> dict[str, Any]:
    return {"station": {"fidelity": "Kinematic"} | (station or {}), "duration": 0.02} | parts


def refusal(parts: dict[str, Any]) -> str:
    with pytest.raises(fc.BadInputError) as caught:
        fc.build(parts)
    assert "\n" not in str(caught.value)
    return str(caught.value)


OWN = {"estimators": {"mine": Part({"measured_force": 1}, {"own_signal": 2}, value=3.0)}}


@pytest.mark.parametrize("guard", [{}, {"guard": None}])
@pytest.mark.parametrize(
    ("further", "expected"),
    [
        ({"motor_position": 6}, None),
        ({"motor_velocity": 6}, 0.0),
        ({"unconstrained_reference": 6}, 0.0),
        ({"measured_wrench": 6}, None),
        ({"own_signal": 2}, 18.0),
    ],
)
def test_a_further_input_of_a_law_is_the_signal_of_its_name(further: Any, expected: float | None, guard: Any) -> None:
    plain = fc.run(scenario(controller=law({}), **OWN, **guard)).log["sum_of_inputs"].values[5]
    read = fc.run(scenario(controller=law(further), **OWN, **guard)).log["sum_of_inputs"].values[5] - plain
    if expected is None:
        assert read != 0.0
    else:
        assert read == pytest.approx(expected, abs=0.1)


def test_an_input_that_nothing_puts_out_is_refused_for_a_law_and_a_reference() -> None:
    nothing = "reads hope, which no part outputs: must be one of "
    assert f"controller {nothing}" in refusal(scenario(controller=law({"hope": 1})))
    reference = Part({"hope": 1}, {"desired_force": 1})
    assert f"reference {nothing}" in refusal(scenario(reference=reference))
    fc.build(scenario(controller=law({"hope": 1}, optional=("hope",))))
    fc.build(scenario(reference=Part({"hope": 1}, {"desired_force": 1}, optional=("hope",))))


WITH_OPTIONAL = law({"hope": 1}, optional=("hope",))


@pytest.mark.parametrize(
    ("tag", "keys"),
    [
        ("PerArm", {"laws": {"arm": WITH_OPTIONAL}}),
        ("Approach", {"law": WITH_OPTIONAL}),
        ("Governed", {"law": WITH_OPTIONAL, "inner_bandwidth": 1.5}),
        ("Passive", {"law": WITH_OPTIONAL}),
        ("InvarianceControl", {"nominal": WITH_OPTIONAL}),
    ],
)
def test_what_a_law_needs_not_it_needs_not_within_others(tag: str, keys: dict[str, Any]) -> None:
    fc.build(scenario(controller=Tagged(keys, tag)))


@pytest.mark.parametrize("name", ["a/b", ".", "time", "x\ny"])
def test_an_output_whose_name_no_log_can_hold_is_refused_before_the_run(name: str) -> None:
    told = refusal(scenario(estimators={"mine": Part({"measured_force": 1}, {name: 1})}))
    assert "a name to be logged must be printable characters without '/', and not one of time, variant, ." in told


def test_an_input_of_a_reference_is_the_signal_of_its_name() -> None:
    reference = Part({"own_signal": 2}, {"desired_force": 1, "sum_of_inputs": 1})
    diagram = fc.run(scenario(reference=reference, **OWN)).diagram
    block = diagram.GetSubsystemByName("mine")
    assert (block, block.GetInputPort("own_signal").get_index()) in diagram.connection_map()


def test_a_law_of_an_arm_reads_the_signals_of_the_loop() -> None:
    laws = Tagged({"laws": {"arm": law({"motor_position": 6})}}, "PerArm")
    told = refusal(scenario(controller=Tagged({"laws": {"arm": law({"hope": 1})}}, "PerArm")))
    assert "controller reads hope, which no part outputs" in told
    fc.build(scenario(controller=laws))


def test_one_of_two_sensors_of_the_same_is_chosen() -> None:
    sensors = {"a": force(1.0, "one"), "b": force(2.0, "two")}
    told = refusal(scenario({"sensors": sensors}))
    assert "controller reads measured_force, which the sensors 'a', 'b' output: must have signals.measured_f" in told
    for choice, value in (({}, 1.0), ({"signal": "b_measured_force"}, 2.0)):
        signals = {"measured_force": Tagged({"part": "station"} | choice, "From")}
        log = fc.run(scenario({"sensors": sensors}, signals=signals)).log
        assert float(log["measured_force"][3]) == value
        assert float(log["b_measured_force"][3]) == 2.0


def estimator(output: str, size: int = 1) -> Part:
    return Part({"measured_force": 1}, {output: size}, value=7.0)


@pytest.mark.parametrize(
    ("estimators", "told"),
    [
        (
            {"a": estimator("contact_force")},
            "estimators.a outputs contact_force, a true signal that only the simulation has: must be another name",
        ),
        (
            {"a": estimator("motor_position", 6)},
            "estimators.a outputs motor_position, as station does: must be another name, or have signals.motor_pos",
        ),
        (
            {"a": estimator("desired_force")},
            "controller reads desired_force, which 'reference', 'a' output: must have",
        ),
        ({"a": estimator("status")}, "estimators.a outputs status, as controller does: must be another name"),
        (
            {"a": estimator("mine"), "b": estimator("mine")},
            "estimators.b outputs mine, as estimators.a does: must be another name, or have signals.mine to choose",
        ),
        ({"a": estimator("estimated_wrench", 3)}, "estimators.a outputs estimated_wrench of size 3: must be 6 (6a)"),
    ],
)
def test_an_estimator_does_not_put_out_what_another_part_does(estimators: Any, told: str) -> None:
    controller = Part(FORCES, {"joint_position_command": 6})  # which reads no motor position
    assert told in refusal(scenario(estimators=estimators, controller=controller))


def test_two_estimators_of_the_same_are_chosen_from() -> None:
    estimators = {"a": estimator("mine"), "b": estimator("mine")}
    signals = {"mine": Tagged({"part": "b"}, "From")}
    assert float(fc.run(scenario(estimators=estimators, signals=signals)).log["mine"][2]) == 7.0


def test_a_controller_does_not_put_out_the_truth() -> None:
    controller = Part(FORCES, {"displacement_command": 1, "contact_force": 1})
    told = "controller outputs contact_force, a true signal that only the simulation has: must be another name"
    assert told in refusal(scenario(controller=controller))


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"reference": Part({}, {"desired_force": 2})}, "reference outputs desired_force of size 2: must be 1 (k)"),
        (
            {"station": {"fidelity": "Kinematic", "sensors": {"force": force(size=6)}}},
            "station.sensors.force outputs measured_force of size 6: must be 1 (k)",
        ),
        (
            {"controller": Part(FORCES, {"displacement_command": 6})},
            "controller has the output displacement_command of size 6: must be 1, one per surface",
        ),
        ({"controller": law({"motor_position": 3})}, "controller reads motor_position of size 3: must be 6"),
    ],
)
def test_a_size_is_refused_of_the_part_that_has_it(parts: Any, told: str) -> None:
    assert told in refusal(scenario() | parts)


class Surface(Part):
    """A surface whose block has a name of the station's."""

    first_stiffness = 2.0e4

    def add_to(self, builder: Any, size: int, period: float, *, robot_compliance: float) -> Any:
        return super().add_to(builder)


SURFACE = Surface({"displacement": 1}, {"contact_force": 1}, name="drive")
DRIVE = Part({"joint_position_command": 6}, {"motor_position": 6, "motor_velocity": 6}, name="tip_displacement")


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"station": {"fidelity": "Kinematic", "environment": SURFACE}}, "station.environment adds a block named 'dri"),
        ({"station": {"fidelity": "Kinematic", "drive": DRIVE}}, "station.drive adds a block named 'tip_displacement'"),
        (
            {"station": {"fidelity": "Kinematic", "sensors": {"force": force(name="contact_monitor")}}},
            "station.sensors.force adds a block named 'contact_monitor'",
        ),
        ({"controller": law({}, name="guard")}, "controller adds a block named 'guard'"),
        ({"controller": law({}, name="kinematic_inversion")}, "controller adds a block named 'kinematic_inversion'"),
        (
            {"controller": Part({"motor_position": 6}, {"joint_position_command": 6}, name="guard")},
            "controller adds a block named 'guard'",
        ),
        ({"reference": Part({}, {"desired_force": 1}, name="controller")}, "reference adds a block named 'controller'"),
    ],
)
def test_a_name_that_another_block_has_is_refused_of_its_part(parts: Any, told: str) -> None:
    assert told in (text := refusal(scenario() | parts))
    assert text.endswith(": must be a name that no other block there has")


def test_a_signal_that_this_station_lacks_is_refused_with_what_it_has() -> None:
    text = refusal(scenario({"sensors": {"force": force(), "joints": Tagged({}, "JointReadings")}}))
    told, known = text.split(", which no part outputs: must be one of ")
    assert told.startswith("scenario: station.sensors.joints reads torque_integral (of the motor torque over time, ")
    assert {"motor_position", "joint_position_command"} <= set(known.split(", "))
    assert "torque_integral" not in known
