"""The research station: a position-controlled robot with any number of arms behind its research interface.

    in     joint_position_reference, joint_velocity_reference (n,) [rad, rad/s]
           joint_torque_feedforward (n,) [Nm]
           external_wrench (6a,) [torque; force] on the robot at each TCP in the world [Nm, N]
           (all but the first are zero when they are not connected)
    out    joint_position (n,) [rad], joint_velocity (n,) [rad/s], motor_torque (n,) [Nm]: at the period of the facts
    truth  link_position, link_velocity (n,) [rad, rad/s], external_torque (n,) [Nm]
           tip_wrench (6a,) [Nm, N], contact_force (a,) [N]

There is no force sensor. References are taken every period, by servo loops of 2 kHz, of which the plant, at 1 kHz,
feels the mean: see `forcectl.plant.drives.joint_servo`. What is measured: `forcectl.plant.sensors.joint_sensors`.
Friction (5.2) sticks. The arms share one plant, so that they may touch each other and things.

Rigid joints    servo torque -> links with their rotors; friction is part of the plant's implicit step.
Elastic joints  servo torque -> rotors with friction -> springs -> links; positions are those of the motors.

Delays: a reference moves the motors one `time_step` after its tick, then with the lag of the servo: with a speed
reference that fits, 1/w^2 times the acceleration; without one, 2 zeta/w. The position is that of the tick, the speed is
T/2 + 1/w_v old, the torque the mean of the last period T.

Simplifications, each with its switch where it has one: links do not pass through each other only with `self_collision`;
joints are rigid without `elastic_joints`; motors are torque sources, limited with `servo.torque_limits`; couplings
between the rotors of different joints are left out; friction does not depend on load or temperature.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain

from forcectl.diagrams.parts import export_outputs
from forcectl.diagrams.research_cell import ResearchCell
from forcectl.diagrams.research_plant import ResearchPlant, add_research_plant
from forcectl.plant.drives.joint_friction import FrictionRest, actuation_gain, desired_state_gain
from forcectl.plant.drives.joint_servo import JointServo, servo_gains
from forcectl.plant.drives.motor_motion import MotorMotion
from forcectl.plant.sensors.joint_sensors import JointSensors
from forcectl.plant.tip_load import LoadTruth, TipLoad

RESEARCH_INPUTS = (
    "joint_position_reference",
    "joint_velocity_reference",
    "joint_torque_feedforward",
    "external_wrench",
)
RESEARCH_OUTPUTS = (
    "joint_position",
    "joint_velocity",
    "motor_torque",
    "link_position",
    "link_velocity",
    "external_torque",
    "tip_wrench",
    "contact_force",
)


class ResearchStation(Diagram):
    """A robot behind its research interface; see this module for what it does.

    ```
    name: ResearchStation
    input_ports: [joint_position_reference, joint_velocity_reference, joint_torque_feedforward, external_wrench]
    output_ports: [joint_position, joint_velocity, motor_torque, link_position, link_velocity, external_torque,
                   tip_wrench, contact_force]
    ```

    joint_position_reference, joint_velocity_reference, joint_torque_feedforward: shape (n,) [rad, rad/s, Nm]; the last
    two are zero when they are not connected.
    external_wrench: shape (6a,), on the robot at each TCP in the world, [torque; force] [Nm, N]; likewise.
    joint_position, joint_velocity, motor_torque: shape (n,), readings [rad, rad/s, Nm]. State.
    link_position, link_velocity: shape (n,), truth [rad, rad/s]. State.
    external_torque: shape (n,), truth [Nm]. Feedthrough of external_wrench.
    tip_wrench: shape (6a,), truth, at each TCP in the world, [torque; force] [Nm, N]. Feedthrough of external_wrench.
    contact_force: shape (a,), truth [N]. Feedthrough of external_wrench.

    Sampling: every `period` [s] references and readings, every `time_step` [s] plant and drives.

    Attributes:
        plant: for visualisation and tests. scene_graph: None when nothing can touch.
    """

    optional_inputs = RESEARCH_INPUTS[1:]

    def __init__(self, cell: ResearchCell, seed: int = 0):
        super().__init__()
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        config, robot = cell.config, cell.robot
        model = add_research_plant(builder, cell)
        plant, parts = model.plant, model.parts
        self.plant = plant
        self.scene_graph = model.scene_graph

        link_position = add("link_position", _pick(plant.num_multibody_states(), _positions(parts.joints)))
        link_velocity = add(
            "link_velocity", _pick(plant.num_multibody_states(), _velocities(plant.num_positions(), parts.joints))
        )
        for block in (link_position, link_velocity):
            connect(plant.get_state_output_port(), block.get_input_port())
        links = link_position.get_output_port(), link_velocity.get_output_port()

        servo = add("servo", _servo(cell))
        motors = _add_elastic(builder, cell, model, servo) if config.elastic_joints else links
        if not config.elastic_joints:
            _connect_rigid(builder, cell, model, servo)
        for name, port in zip(("position", "velocity"), motors, strict=True):
            connect(port, servo.GetInputPort(name))
        for name in RESEARCH_INPUTS[:3]:
            builder.ExportInput(servo.GetInputPort(name), name)

        sensed = config.sensors
        sensors = add(
            "sensors",
            JointSensors(
                cell.num_joints,
                start=cell.motor_start,
                period=cell.period,
                bandwidth=sensed.velocity_bandwidth,
                torque=cell.gravity_torque + cell.friction.offset,
                quantum=sensed.quantum,
                position_noise=sensed.position_noise,
                torque_noise=sensed.torque_noise,
                seed=seed,
                faults=[fault.fault(robot.facts.arm_joints) for fault in config.faults],
            ),
        )
        connect(motors[0], sensors.GetInputPort("position"))
        connect(servo.GetOutputPort("torque_integral"), sensors.GetInputPort("torque_integral"))

        load, truth = add("load", TipLoad(parts)), add("truth", LoadTruth(robot, plant, parts))
        wrench = builder.ExportInput(load.GetInputPort("external_wrench"), "external_wrench")
        builder.ConnectInput(wrench, truth.GetInputPort("external_wrench"))
        connect(load.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
        connect(links[0], truth.GetInputPort("link_position"))
        if model.scene_graph is not None:
            connect(plant.get_contact_results_output_port(), truth.GetInputPort("contact_results"))
            torque = plant.get_generalized_contact_forces_output_port(parts.instance)
            connect(torque, truth.GetInputPort("contact_torque"))
        export_outputs(
            builder,
            {
                **{name: sensors.GetOutputPort(name) for name in RESEARCH_OUTPUTS[:3]},
                "link_position": links[0],
                "link_velocity": links[1],
                **{name: truth.GetOutputPort(name) for name in RESEARCH_OUTPUTS[5:]},
            },
        )
        builder.BuildInto(self)


def _servo(cell: ResearchCell) -> JointServo:
    own, filter_ = cell.config.servo, cell.robot.facts.reference_filter
    bandwidth = filter_.natural_frequency if own.bandwidth is None else own.bandwidth
    damping_ratio = filter_.damping_ratio if own.damping_ratio is None else own.damping_ratio
    limit = cell.robot.limits.torque if own.torque_limits else np.full(cell.num_joints, np.inf)
    return JointServo(
        servo_gains(cell.servo_inertia, bandwidth, damping_ratio, own.integral_gain),
        limit,
        period=cell.period,
        time_step=cell.config.time_step,
        start=cell.motor_start,
        torque=cell.gravity_torque + cell.friction.offset,
        substeps=max(1, round(own.rate * cell.config.time_step)),
    )


def _connect_rigid(builder: DiagramBuilder, cell: ResearchCell, model: ResearchPlant, servo: JointServo) -> None:
    """Motor torque and friction of joints without springs."""
    plant, instance, connect = model.plant, model.parts.instance, builder.Connect
    motors = builder.AddNamedSystem("motors", actuation_gain(plant, instance, model.parts.actuators))
    connect(servo.GetOutputPort("motor_torque"), motors.get_input_port())
    connect(motors.get_output_port(), plant.get_actuation_input_port(instance))
    rest = builder.AddNamedSystem("at_rest", ConstantVectorSource(np.zeros(2 * cell.num_joints)))
    sticking = builder.AddNamedSystem("sticking", desired_state_gain(plant, instance, model.friction))
    connect(rest.get_output_port(), sticking.get_input_port())
    connect(sticking.get_output_port(), plant.get_desired_state_input_port(instance))
    n_q, n_v = plant.num_positions(), plant.num_velocities()
    speeds = builder.AddNamedSystem("speeds", _pick(n_q + n_v, list(range(n_q, n_q + n_v))))
    drag = builder.AddNamedSystem("friction", FrictionRest(plant, model.parts.joints, cell.friction))
    connect(plant.get_state_output_port(), speeds.get_input_port())
    connect(speeds.get_output_port(), drag.GetInputPort("velocity"))
    connect(drag.GetOutputPort("generalized_force"), plant.get_applied_generalized_force_input_port())


def _add_elastic(
    builder: DiagramBuilder, cell: ResearchCell, model: ResearchPlant, servo: JointServo
) -> tuple[OutputPort, OutputPort]:
    """Rotors with friction, and the springs to the links; returns position and velocity of the motors."""
    plant, parts, connect = model.plant, model.parts, builder.Connect
    motion = builder.AddNamedSystem(
        "motors",
        MotorMotion(cell.rotor_inertia, cell.friction, time_step=cell.config.time_step, start=cell.motor_start),
    )
    actuators = desired_state_gain(plant, parts.instance, parts.actuators)
    springs = builder.AddNamedSystem("motor_state", actuators)
    torque = builder.AddNamedSystem(
        "spring_torque", MatrixGain(actuation_gain(plant, parts.instance, parts.actuators).D().T)
    )
    connect(servo.GetOutputPort("motor_torque"), motion.GetInputPort("motor_torque"))
    connect(plant.get_net_actuation_output_port(parts.instance), torque.get_input_port())
    connect(torque.get_output_port(), motion.GetInputPort("spring_torque"))
    connect(motion.GetOutputPort("motor_state"), springs.get_input_port())
    connect(springs.get_output_port(), plant.get_desired_state_input_port(parts.instance))
    return motion.GetOutputPort("motor_position"), motion.GetOutputPort("motor_velocity")


def _pick(size: int, rows: Sequence[int]) -> MatrixGain:
    """Some elements of a vector."""
    return MatrixGain(np.eye(size)[list(rows)])


def _positions(joints: Sequence[Joint]) -> list[int]:
    return [joint.position_start() for joint in joints]


def _velocities(num_positions: int, joints: Sequence[Joint]) -> list[int]:
    return [num_positions + joint.velocity_start() for joint in joints]
