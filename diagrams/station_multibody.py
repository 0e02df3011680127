"""Multibody station: the robot as a MultibodyPlant on elastic joints, pressing on a compliant environment body.

    joint_position_command -> position loop -> drives (motor side) -> joint springs -> links -> tool -> contact
                                                     ^ spring torque        wrist sensor <-'

The joint springs are actuator PD laws whose desired state is the motor side, and the contact is Drake's compliant point
contact with linear (Kelvin-Voigt) dissipation; the discrete SAP solver integrates both implicitly, so an environment
from 1e3 to 1e6 N/m and the joints stay stable at the default 1 ms. The step is an implicit Euler step: it damps a mode
of angular frequency w by an extra damping ratio of about w dt/2.

Delays beside the configured ones: the command delay is at least one plant step, and the motor state reaches the
springs one plant step late, because simultaneous events read the state before them.
"""

from __future__ import annotations

import math

import numpy as np
from pydrake.geometry import Role, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import Joint, PdControllerGains
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Demultiplexer, LinearSystem, MatrixGain

from forcectl.diagrams.environment_body import BALL_COMPLIANCE, add_environment, contact_material, drive_surface
from forcectl.diagrams.parts import export_outputs
from forcectl.diagrams.station import Cell
from forcectl.diagrams.station_surface import add_surface
from forcectl.diagrams.torque_interface import TorqueInterface
from forcectl.diagrams.truth import add_contact_state
from forcectl.errors import BadInputError
from forcectl.plant.drives.drive import Drive, joint_to_motor
from forcectl.plant.drives.joint_impedance import JointImpedanceConfig
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.plant.sensors.wrist_sensor import WristSensor
from forcectl.plant.tip_kinematics import TipDisplacement, Vector
from forcectl.robot.model import RobotParts, add_robot

_LARGEST_DRIVE_STEP = 0.5e-3  # [s] friction sticks and slips with a time of its own


def add_ball(plant: MultibodyPlant, parts: RobotParts, R_TW: RotationMatrix, n: Vector) -> None:
    """The ball of the tool as the only thing that touches the environment, with the TCP as its outermost point.

    Inclined tools would touch with another point of the ball than the one whose kinematics the controllers know; the
    ball sits one radius along n from the TCP in the start posture, so that force and displacement are those of the TCP.
    """
    if parts.contact_ball_frame is None or parts.tool_facts is None:
        raise BadInputError("tool: has no contact_ball_frame: must name one for station.fidelity = Multibody")
    radius = max(parts.tool_facts.contact_ball_radius, 1e-3)
    tcp = parts.tcp_frame
    plant.RegisterCollisionGeometry(
        tcp.body(),
        tcp.GetFixedPoseInBodyFrame() @ RigidTransform(radius * (R_TW @ n)),
        Sphere(radius),
        "contact_ball",
        contact_material(1 / BALL_COMPLIANCE, 0.0),
    )


def keep_contact_only(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Leave ball and environment as the only things that can touch: the cell is free of other obstacles."""
    inspector = scene_graph.model_inspector()
    for geometry in inspector.GetAllGeometryIds(Role.kProximity):
        if inspector.GetName(geometry).split("::")[-1] not in ("contact_ball", "contact_surface"):
            scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kProximity)


def add_plant(builder: DiagramBuilder, cell: Cell) -> tuple[MultibodyPlant, SceneGraph, RobotParts, Joint]:
    """Robot on elastic joints, tool and environment in contact; also returns the weld of the environment to the world.

    The desired state of the robot's model instance is its motor side.
    """
    config, robot, posture = cell.config, cell.robot, cell.start_context()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, config.time_step)
    # Sampled outputs are abstract state, which would be copied at every event of the diagram.
    plant.SetUseSampledOutputPorts(False)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    parts = add_robot(plant, config.robot, config.tool)
    X_WT = robot.pose(posture)
    weld = add_environment(plant, cell, X_WT.translation())
    add_ball(plant, parts, X_WT.rotation().inverse(), cell.n)
    stiffness = cell.spring_stiffness
    damping = robot.facts.transmission_damping if config.elastic_joints else stiffness * config.time_step
    for actuator, k, d in zip(parts.actuators, stiffness, damping, strict=True):
        actuator.set_controller_gains(PdControllerGains(p=float(k), d=float(d)))
        # Drake would clamp the spring torque at the motor's limit otherwise.
        actuator.set_effort_limit(np.inf)
    for joint, position in zip(parts.joints, cell.start, strict=True):
        joint.set_default_positions(np.array([position]))
    plant.Finalize()
    keep_contact_only(plant, scene_graph)
    return plant, scene_graph, parts, weld


class MultibodyStation(Diagram):
    """The cell with a full MultibodyPlant; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: MultibodyStation
    input_ports: [joint_position_command]
    output_ports: [motor_position, motor_velocity, measured_wrench, measured_force, contact_force, contact_displacement,
      link_position, contact_state, surface_height (optional), surface_stiffness (optional),
      surface_damping (optional)]
    ```

    joint_position_command, motor_position, link_position: shape (n_q,) [rad]. motor_velocity: shape (n_q,) [rad/s].
    measured_wrench: shape (6,), of the environment on the tool, at S in S, [torque; force] [Nm, N].
    measured_force: shape (1,), along n [N]. contact_force: shape (1,), truth along n [N].
    contact_displacement: shape (1,), truth along n [m]. contact_state: shape (1,), see `ContactMonitor` [1].
    surface_height, surface_stiffness, surface_damping: shape (1,), under the tool [m, N/m, N s/m]; the ports exist
    where the surface is uneven, and of several materials.
    All outputs are state, no direct feedthrough.

    Sampling: every `time_step` [s] of the cell the plant and its drives; every `period` [s] commands and readings;
    every `posture_period` [s] what depends on the posture only.

    Attributes:
        plant, scene_graph: of the cell, for visualisation and tests.
    """

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config, robot, n_q, q_0 = cell.config, cell.robot, cell.robot.num_joints, cell.motor_start
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect

        plant, scene_graph, parts, weld = add_plant(builder, cell)
        self.plant, self.scene_graph = plant, scene_graph

        # The command is held for a tick, then everything runs on at the plant's rate. Reading the hold takes one plant
        # step, which counts towards the command delay.
        hold = add("command_hold", hold_line(config.period, q_0))
        builder.ExportInput(hold.get_input_port(), "joint_position_command")
        loop = add(
            "position_loop",
            PositionLoop(
                n_q,
                bandwidth=config.position_loop.bandwidth,
                damping_ratio=config.position_loop.damping_ratio,
                delay=max(0.0, config.position_loop.delay - config.time_step),
                period=config.time_step,
                initial_command=q_0,
            ),
        )
        connect(hold.get_output_port(), loop.GetInputPort("command"))
        reference = loop.GetOutputPort("reference")
        if config.servo.ideal:
            halves = add("position_and_velocity", Demultiplexer([n_q, n_q]))
            connect(reference, halves.get_input_port())
            motor_state, position, velocity = reference, halves.get_output_port(0), halves.get_output_port(1)
        else:
            drive = self._add_drive(builder, cell)
            connect(reference, drive.GetInputPort("reference"))
            if config.elastic_joints:
                torque = plant.get_net_actuation_output_port(parts.instance)
            else:
                # Springs that stand for rigid joints are too stiff for the explicit step of the drives: no load, as
                # in the light stations.
                torque = add("no_load", ConstantVectorSource(np.zeros(n_q))).get_output_port()
            connect(torque, drive.GetInputPort("spring_torque"))
            motor_state, position, velocity = (
                drive.GetOutputPort(name) for name in ("motor_state", "motor_position", "motor_velocity")
            )
        connect(motor_state, plant.get_desired_state_input_port(parts.instance))

        # Wrist sensor: the wrench at the weld between sensor and tool, tool weight included.
        if parts.sensor_weld is None:
            raise BadInputError("tool: has no sensor_weld: must name one for station.fidelity = Multibody")
        sensed = config.force_sensor
        scale = sensed.channel_scale()
        sensor = add(
            "wrist_sensor",
            WristSensor(
                plant,
                parts.sensor_weld,
                weld,
                robot,
                cell.n,
                q_0,
                posture_period=config.posture_period,
                electronics={
                    "bias": sensed.bias * scale,
                    "noise_std": sensed.noise_std * scale,
                    "quantum": sensed.quantum * scale,
                    "range": sensed.range * scale,
                    "tare": sensed.tare,
                    "seed": seed,
                    "period": config.period,
                },
            ),
        )
        readings_and_truth = add("readings_and_truth", Demultiplexer([7, 1]))
        filter_ = add("sensor_filter", sensed.filter(7, config.period))
        wrench_and_force = add("wrench_and_force", Demultiplexer([6, 1]))
        connect(plant.get_reaction_forces_output_port(), sensor.GetInputPort("reaction_forces"))
        connect(position, sensor.GetInputPort("motor_position"))
        connect(sensor.GetOutputPort("readings"), readings_and_truth.get_input_port())
        connect(readings_and_truth.get_output_port(0), filter_.get_input_port())
        connect(filter_.get_output_port(), wrench_and_force.get_input_port())
        force = readings_and_truth.get_output_port(1)

        # An uneven surface is raised to its height at the place of the links.
        links = add("link_state", _split_state(plant, parts))
        connect(plant.get_state_output_port(parts.instance), links.get_input_port())
        surface = add_surface(builder, cell, links.get_output_port(), cell.start)
        drive_surface(builder, cell, plant, weld, surface)

        tip = add("tip_displacement", TipDisplacement(robot, cell.n, q_0, period=None))
        connect(position, tip.GetInputPort("motor_position"))
        export_outputs(
            builder,
            {
                "motor_position": position,
                "motor_velocity": velocity,
                "measured_wrench": wrench_and_force.get_output_port(0),
                "measured_force": wrench_and_force.get_output_port(1),
                "contact_force": force,
                "contact_displacement": tip.GetOutputPort("displacement"),
                "link_position": links.get_output_port(),
                "contact_state": add_contact_state(builder, force),
                **surface,
            },
        )
        builder.BuildInto(self)

    @staticmethod
    def _add_drive(builder: DiagramBuilder, cell: Cell) -> Drive | TorqueInterface:
        if isinstance(cell.config.interface, JointImpedanceConfig):
            return builder.AddNamedSystem("torque_interface", TorqueInterface(cell))
        robot, gains, step = cell.robot, cell.config.servo, cell.config.time_step
        facts = robot.facts
        rotors = facts.rotor_inertia * facts.gear_ratio**2
        drive = Drive(
            rotors,
            joint_to_motor(robot),
            period=step,
            substeps=max(1, math.ceil(step / _LARGEST_DRIVE_STEP - 1e-9)),
            position_gain=gains.position_gain,
            velocity_gain=gains.rotor_velocity_gain(rotors, facts.velocity_loop_inertia),
            integral_gain=gains.integral_gain,
            coulomb_friction=gains.friction_scale * facts.coulomb_friction,
            viscous_friction=gains.friction_scale * facts.viscous_friction,
            initial_position=cell.motor_start,
            initial_torque=robot.gravity_torque(cell.start_context()) * cell.config.elastic_joints,
        )
        return builder.AddNamedSystem("drive", drive)


def hold_line(period: float, initial: Vector) -> LinearSystem:
    """Samples a signal every `period` [s] and holds it; `initial` (n,) at the start, where a ZeroOrderHold is zero."""
    n = len(initial)
    hold = LinearSystem(np.zeros((n, n)), np.eye(n), np.eye(n), np.zeros((n, n)), period)
    hold.configure_default_state(initial)
    return hold


def _split_state(plant: MultibodyPlant, parts: RobotParts) -> MatrixGain:
    """Positions of the arm joints out of the state of its model instance."""
    n = plant.num_positions(parts.instance) + plant.num_velocities(parts.instance)
    first = min(joint.position_start() for joint in plant_joints(plant, parts))
    rows = [joint.position_start() - first for joint in parts.joints]
    return MatrixGain(np.eye(n)[rows])


def plant_joints(plant: MultibodyPlant, parts: RobotParts) -> list[Joint]:
    """All moving joints of the robot's model instance."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(parts.instance)]
    return [joint for joint in joints if joint.num_positions() > 0]
