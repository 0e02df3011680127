"""The sensors of a station: `!WristForce` and `!JointReadings`; and `!ContactTruth`, for simulation only."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.diagrams.mechanics.site import Site
from forcectl.errors import BadInputError, check_distinct, invalid
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import export_all_inputs, export_outputs, made_by, output_names, split, through
from forcectl.plant.contact.contact_truth import ContactWrench, bodies_named, frame_called
from forcectl.plant.sensors.force_fault import FaultyForce, ForceFaultConfig, check_acts, clashing
from forcectl.plant.sensors.force_sensor import ForceSensorConfig
from forcectl.plant.sensors.joint_sensors import JointSensors, ReadingFault
from forcectl.plant.sensors.wrist_sensor import WristSensor, random_cross_talk
from forcectl.plant.tip_kinematics import ForceToWrench

_LARGEST_NOISE = 10.0  # largest noise of a fault, as a multiple of the sensor's range
_SMALLEST_NOISE = 0.01  # smallest noise of a fault, as a share of the sensor's own noise or quantum, which hide less


@dataclass(kw_only=True)
class WristForceConfig(ForceSensorConfig, in_batches=True):
    """Scenario part `!WristForce`: six-axis force sensor between flange and tool of the arm that presses."""

    cross_talk: float = key(
        0.0,
        "largest cross-talk: output of a channel, as a share of its range, while another channel is at the end of its "
        "own range (Multibody only)",
        unit="1",
        bounds="not negative and at most 0.2",
    )
    faults: list[ForceFaultConfig] = key([], "faults of the measured force, over time")

    def __post_init__(self) -> None:
        super().__post_init__()
        for i, j in clashing(self.faults):
            one, other = self.faults[i], self.faults[j]
            allowed = f"before or after the fault {one.kind} from {one.start:g} s to {one.end:g} s"
            raise invalid(f"faults.{j}.start", other.start, allowed)
        for i, fault in enumerate(self.faults):
            if fault.kind == "noise" and fault.value > (most := _LARGEST_NOISE * self.range):
                raise invalid(f"faults.{i}.value", fault.value, f"at most {most:g} N, {_LARGEST_NOISE:g} times range")
            if fault.kind == "noise" and fault.value < (least := _SMALLEST_NOISE * max(self.noise_std, self.quantum)):
                raise invalid(
                    f"faults.{i}.value",
                    fault.value,
                    f"at least {least:g} N: the sensor's own noise and quantum hide a smaller one",
                )

    def add_to(self, builder: DiagramBuilder, site: Site) -> Diagram:
        """Add the block `force_sensor`.

        Raises:
            BadInputError: cross-talk of a station without dynamics, whose sensor measures one force only; a fault that
                acts at no tick.
        """
        if self.cross_talk and not site.workcell.has_dynamics:
            raise invalid("cross_talk", self.cross_talk, "0, or have a fidelity with dynamics, such as Multibody")
        for i, fault in enumerate(self.faults):
            check_acts(f"faults.{i}.duration", fault.start, fault.duration, site.period)
            if fault.kind == "jitter" and not fault.ticks(site.period):
                raise invalid(f"faults.{i}.value", fault.value, f"at least a control tick, {site.period:g} s")
        made: Diagram = WristForce(self, site) if site.workcell.has_dynamics else NormalForce(self, site)
        if self.faults:
            made = FaultySensor(made, self.faults, site)
        return builder.AddNamedSystem("force_sensor", made)


class FaultySensor(PythonDiagram):
    """A force sensor whose measured force has faults.

    ```
    name: FaultySensor
    input_ports: [(further inputs of the sensor)]
    output_ports: [(further outputs of the sensor)]
    ```

    The ports are those of the sensor. All outputs are feedthrough of all inputs when those of the sensor are.

    Sampling: every `period` [s] of the workcell.

    Args:
        sensor: with the output measured_force.
        faults: see `FaultyForce`.
        site: of the sensor.
    """

    def __init__(self, sensor: Diagram, faults: list[ForceFaultConfig], site: Site):
        super().__init__()
        builder = DiagramBuilder()
        builder.AddNamedSystem("sensor", sensor)
        faulty = builder.AddNamedSystem("faults", FaultyForce(1, faults, period=site.period, seed=site.seed))
        reading = sensor.GetOutputPort("measured_force")
        builder.Connect(reading, faulty.GetInputPort("reading"))
        export_all_inputs(builder, sensor)
        outputs = {name: sensor.GetOutputPort(name) for name in output_names(sensor)}
        export_outputs(builder, outputs | {"measured_force": faulty.GetOutputPort("measured_force")})
        builder.BuildInto(self)


class NormalForce(PythonDiagram):
    """Force sensor of a station without dynamics: it measures the contact force along the normal, and no weight.

    ```
    name: NormalForce
    input_ports: [contact_force, motor_position]
    output_ports: [measured_wrench, measured_force]
    ```

    contact_force: shape (1,), true, along n [N]. motor_position: shape (n,) [rad].
    measured_force: shape (1,) [N]. Feedthrough of contact_force when `delay` is 0.
    measured_wrench: shape (6,), the same as a wrench, [torque; force] at the sensor frame S in S [Nm, N]. Feedthrough
    of motor_position. Feedthrough of contact_force when `delay` is 0.

    Sampling: every `period` [s] of the workcell. Delay: `delay` [s] plus the lag of the filter, see `ForceSensor`.

    Args:
        config: of the sensor.
        site: in a workcell with one surface.
    """

    def __init__(self, config: ForceSensorConfig, site: Site):
        super().__init__()
        contact, builder = site.workcell.contact, DiagramBuilder()
        sensor = config.add_channels(builder, site.period, seed=site.seed)
        wrench = builder.AddNamedSystem("wrench", ForceToWrench(contact.robot, contact.n))
        builder.Connect(sensor.GetOutputPort("measured_force"), wrench.GetInputPort("measured_force"))
        builder.ExportInput(sensor.GetInputPort("force"), "contact_force")
        builder.ExportInput(wrench.GetInputPort("motor_position"), "motor_position")
        builder.ExportOutput(wrench.GetOutputPort("measured_wrench"), "measured_wrench")
        builder.ExportOutput(sensor.GetOutputPort("measured_force"), "measured_force")
        builder.BuildInto(self)


class WristForce(PythonDiagram):
    """Wrist sensor of a multibody station: the wrench at the weld between sensor and tool, tool weight included.

    ```
    name: WristForce
    input_ports: [reaction_forces, motor_position]
    output_ports: [measured_wrench, measured_force, contact_force]
    ```

    reaction_forces: abstract, of the plant's joints. motor_position: shape (n,) [rad].
    measured_wrench: shape (6,), of the environment on the tool at S in S, [torque; force] [Nm, N]. Feedthrough of
    reaction_forces when `delay` is 0.
    measured_force: shape (1,), along n [N]. Feedthrough of reaction_forces when `delay` is 0.
    contact_force: shape (1,), true, along n [N]. Feedthrough of reaction_forces.

    Sampling: every `period` [s] of the workcell the filter; every `posture_period` [s] of the workcell the orientation
    of the sensor. Delay: `delay` [s] plus the lag of the filter, see `WristSensor`.

    Args:
        config: of the sensor.
        site: with a plant, in a workcell with one surface.

    Raises:
        BadInputError: the tool has no wrist sensor.
    """

    def __init__(self, config: WristForceConfig, site: Site):
        super().__init__()
        workcell, contact, plant, parts = site.workcell, site.workcell.contact, site.plant, site.parts
        weld = None if parts is None else parts.arms[contact.arm].sensor_weld
        if plant is None or weld is None:
            raise BadInputError(
                "has no sensor_weld: must name one for a wrist sensor in station.fidelity = Multibody", key="tool"
            )
        mounting = site.mountings[0]
        if mounting is None:
            other = "must be a sensor of contact_force, as for every block of one's own in station.fidelity = Multibody"
            raise BadInputError(
                f"environment {contact.name!r} has no body whose force a wrist sensor could measure: {other}"
            )
        scale = config.channel_scale()
        builder = DiagramBuilder()
        sensor = builder.AddNamedSystem(
            "wrist_sensor",
            WristSensor(
                plant,
                weld,
                mounting,
                contact.robot,
                contact.n,
                workcell.motor_start,
                posture_period=workcell.posture_period,
                cross_talk=random_cross_talk(config.cross_talk, scale, site.seed) if config.cross_talk else None,
                electronics={
                    "bias": config.bias * scale,
                    "drift": config.drift * scale,
                    "noise_std": config.noise_std * scale,
                    "quantum": config.quantum * scale,
                    "range": config.range * scale,
                    "tare": config.tare,
                    "seed": site.seed,
                    "period": site.period,
                },
            ),
        )
        readings, truth = split(builder, "readings_and_truth", [7, 1], sensor.GetOutputPort("readings"))
        filtered = through(builder, "sensor_filter", config.filter(7, site.period), readings)
        wrench, force = split(builder, "wrench_and_force", [6, 1], filtered)
        builder.ExportInput(sensor.GetInputPort("reaction_forces"), "reaction_forces")
        builder.ExportInput(sensor.GetInputPort("motor_position"), "motor_position")
        builder.ExportOutput(wrench, "measured_wrench")
        builder.ExportOutput(force, "measured_force")
        builder.ExportOutput(truth, "contact_force")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class JointReadingsConfig(Config):
    """Scenario part `!JointReadings`: joint positions, speeds and motor torques as a robot's interface reports them."""

    quantum: float = key(
        1e-6,
        "resolution of the joint positions; assumed: 16 bits per motor turn and a gear ratio of 100",
        unit="rad",
        bounds="from 0 to 0.01",
    )
    position_noise: float = key(
        0.0, "standard deviation of the noise of the joint positions, per tick", unit="rad", bounds="from 0 to 0.01"
    )
    torque_noise: float = key(
        0.1,
        "standard deviation of the noise of the motor torques, per tick; assumed",
        unit="Nm",
        bounds="from 0 to 100",
    )
    velocity_bandwidth: float = key(
        250.0,
        "bandwidth of the filter that computes joint speeds from position differences",
        unit="rad/s",
        bounds="from 0.1 to 1e+06",
    )

    def add_to(self, builder: DiagramBuilder, site: Site) -> JointSensors:
        """Add the block `joint_sensors`."""
        workcell, joints = site.workcell, site.workcell.robot.parameters.arm_joints
        block = JointSensors(
            workcell.num_joints,
            start=workcell.motor_start,
            period=site.period,
            bandwidth=self.velocity_bandwidth,
            torque=getattr(workcell.config.drive, "resting_torque", lambda workcell: workcell.gravity_torque)(workcell),
            quantum=self.quantum,
            position_noise=self.position_noise,
            torque_noise=self.torque_noise,
            seed=site.seed,
            faults=[
                made_by(part, "fault", f"faults.{i}", ReadingFault, "a ReadingFault", joints)
                for i, part in enumerate(workcell.config.faults)
            ],
        )
        return builder.AddNamedSystem("joint_sensors", block)


@dataclass(kw_only=True)
class ContactTruthConfig(Config):
    """Scenario part `!ContactTruth`: the true wrench of contacts between named bodies, for log and analyses.

    A body is named as in the plant, "left_link_7" or "left_yumi_gripper::base"; the name of a model stands for all its
    bodies. Every `!Box` belongs to the body "world".
    """

    on: list[str] = key(meaning="bodies that the contact wrench acts on")
    by: list[str] = key([], "bodies that exert the contact wrench; empty: all others")
    frame: str = key("world", "frame whose origin and axes the contact wrench is given in")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.on:
            raise invalid("on", self.on, "at least one body")
        for name in ("on", "by"):
            check_distinct(name, getattr(self, name))

    def add_to(self, builder: DiagramBuilder, site: Site) -> ContactWrench:
        """Add the block `contact_wrench`.

        Raises:
            BadInputError: the plant has no such body or frame, or a body is on both sides.
        """
        if site.plant is None:
            raise BadInputError("contacts between bodies need the fidelity Multibody")
        for key_name, names in (("on", self.on), ("by", self.by)):
            if boxes := [name for name in names if name in site.workcell.obstacles]:
                raise invalid(key_name, names, f"bodies; the box {boxes[0]!r} is of the body 'world', as all boxes are")
        on = bodies_named(site.plant, self.on, "on")
        by = bodies_named(site.plant, self.by, "by") if self.by else None
        if by is not None and on & by:
            raise invalid("by", self.by, "other bodies than those of on")
        for part in site.held:
            if by is not None and part.bodies >= on and part.config.hand:
                for other in site.held:
                    if other.bodies >= by and other.config.hand == part.config.hand:
                        allowed = f"held by another arm than {self.on}: both are in the {part.config.hand} hand"
                        raise invalid("by", self.by, allowed)
        frame = frame_called(site.plant, self.frame, "frame")
        return builder.AddNamedSystem("contact_wrench", ContactWrench(site.plant, on, by, frame, len(site.pairs)))
