"""Multibody station: the robot as a MultibodyPlant on elastic joints, pressing on a compliant environment body.

    joint_position_command -> position loop -> drives (motor side) -> joint springs -> links -> tool -> contact
                                                     ^ spring torque        wrist sensor <-'

The joint springs are actuator PD laws whose desired state is the motor side, and the contact is Drake's compliant point
contact with linear (Kelvin-Voigt) dissipation; the discrete SAP solver integrates both implicitly, so an environment
from 1e3 to 1e6 N/m and the joints stay stable at the default 1 ms. The step is an implicit Euler step: it damps a mode
of angular frequency w by an extra damping ratio of about w dt/2.

Delays of one plant step each: motor state to spring (the plant reads the state before the step), spring torque to motor.
"""

from __future__ import annotations

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    ProximityProperties,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import Joint, PdControllerGains
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, MatrixGain

from forcectl.diagrams.parts import export_outputs
from forcectl.diagrams.station import Cell
from forcectl.errors import BadInputError
from forcectl.models import add_packages
from forcectl.plant.contact_monitor import ContactMonitor
from forcectl.plant.drive import Drive, DriveCore, joint_to_motor
from forcectl.plant.tip_kinematics import TipDisplacement, Vector
from forcectl.plant.wrist_sensor import ToolCompensation, WeldWrench, tool_load, weight_wrench
from forcectl.robot import RobotParts, add_robot

# Compliance of the ball of the tool [m/N]: small beside any environment, and in series with it (taken out again below).
_BALL_COMPLIANCE = 1e-7
_RIGID = 1e8  # [Nm/rad] joints with `elastic_joints: false`; the solver bounds what it can resolve


def add_environment(plant: MultibodyPlant, cell: Cell, tip: Vector) -> Joint:
    """The environment body, its top face through `tip` with outward normal n; returns its weld to the world."""
    config = cell.config.environment
    parser = Parser(plant)
    add_packages(parser.package_map())
    (instance,) = parser.AddModelsFromUrl("package://spring_plate/spring_plate.sdf")
    side = np.eye(3)[int(np.argmin(np.abs(cell.n)))]
    y = np.cross(cell.n, side) / np.linalg.norm(np.cross(cell.n, side))
    R_WE = RotationMatrix(np.column_stack([np.cross(y, cell.n), y, cell.n]))
    surface = plant.GetFrameByName("surface", instance)
    weld = plant.WeldFrames(plant.world_frame(), surface, RigidTransform(R_WE, tip))
    plant.set_gravity_enabled(instance, False)
    link = _link_compliance(cell)
    stiffness = 1 / (1 / config.stiffness + link - _BALL_COMPLIANCE)
    if not stiffness > 0:
        raise BadInputError(f"stiffness = {config.stiffness:g}: must be below {1 / _BALL_COMPLIANCE:g} N/m in Multibody")
    # Thick, so that the ball never comes out of the other side of a soft surface.
    depth = 0.5
    block = RigidTransform([0.0, 0.0, -depth / 2])
    X_BS = surface.GetFixedPoseInBodyFrame()
    plant.RegisterCollisionGeometry(
        surface.body(), X_BS @ block, Box(1.0, 1.0, depth), "contact_surface", _material(stiffness, config.damping)
    )
    return weld


def _link_compliance(cell: Cell) -> float:
    """The part n'C_L n of the robot's compliance [m/N]: links are rigid bodies here, so the contact carries it."""
    if not cell.config.elastic_joints:
        return 0.0
    context = cell.robot.create_context()
    cell.robot.set_positions(context, cell.start)
    row = cell.n @ cell.robot.jacobian(context)[3:]
    return max(0.0, cell.robot_compliance - float(np.sum(row**2 / cell.robot.joint_stiffness)))


def _material(stiffness: float, damping: float) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(friction=CoulombFriction(0.0, 0.0), point_stiffness=float(stiffness), properties=properties)
    properties.AddProperty("material", "relaxation_time", float(damping / stiffness))
    return properties


def add_ball(plant: MultibodyPlant, parts: RobotParts) -> None:
    """The ball of the tool as the only thing that touches the environment."""
    frame = parts.contact_ball_frame
    if frame is None or parts.tool_facts is None:
        raise BadInputError("tool: has no contact_ball_frame: must name one for station.fidelity = Multibody")
    plant.RegisterCollisionGeometry(
        frame.body(),
        frame.GetFixedPoseInBodyFrame(),
        Sphere(max(parts.tool_facts.contact_ball_radius, 1e-3)),
        "contact_ball",
        _material(1 / _BALL_COMPLIANCE, 0.0),
    )


def keep_contact_only(scene_graph: SceneGraph) -> None:
    """Filter every collision but the one between ball and environment: the cell is free of other obstacles."""
    inspector = scene_graph.model_inspector()
    everything = inspector.GetAllGeometryIds(Role.kProximity)
    wanted = [g for g in everything if inspector.GetName(g).split("::")[-1] in ("contact_ball", "contact_surface")]
    others = GeometrySet([g for g in everything if g not in wanted])
    manager = scene_graph.collision_filter_manager()
    manager.Apply(CollisionFilterDeclaration().ExcludeWithin(others))
    manager.Apply(CollisionFilterDeclaration().ExcludeBetween(others, GeometrySet(wanted)))


class MultibodyStation(Diagram):
    """The cell with a full MultibodyPlant; see `forcectl.diagrams.station` for the ports.

    Attributes:
        plant, scene_graph: of the cell, for visualisation and tests.
    """

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config, robot, n_q, q_0 = cell.config, cell.robot, cell.robot.num_joints, cell.motor_start
        posture = robot.create_context()
        robot.set_positions(posture, cell.start)
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect

        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, config.time_step)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        parts = add_robot(plant, config.robot, config.tool)
        weld = add_environment(plant, cell, robot.pose(posture).translation())
        add_ball(plant, parts)
        damping = robot.facts.transmission_damping
        for actuator, k, d in zip(parts.actuators, robot.joint_stiffness, damping, strict=True):
            p, d = (float(k), float(d)) if config.elastic_joints else (_RIGID, _RIGID * config.time_step)
            actuator.set_controller_gains(PdControllerGains(p=p, d=d))
            # Drake would clamp the spring torque at the motor's limit otherwise.
            actuator.set_effort_limit(np.inf)
        for joint, position in zip(parts.joints, cell.start, strict=True):
            joint.set_default_positions(np.array([position]))
        plant.Finalize()
        keep_contact_only(scene_graph)
        self.plant, self.scene_graph = plant, scene_graph

        # The position loop runs at the plant's rate: commands still change once per control tick.
        loop = config.position_loop.add_to(builder, n_q, config.time_step, initial_command=q_0)
        builder.ExportInput(loop.GetInputPort("command"), "joint_position_command")
        if config.servo.ideal:
            halves = add("position_and_velocity", Demultiplexer([n_q, n_q]))
            connect(loop.GetOutputPort("reference"), halves.get_input_port())
            motor_state, position, velocity = (
                loop.GetOutputPort("reference"),
                halves.get_output_port(0),
                halves.get_output_port(1),
            )
        else:
            drive = self._add_drive(builder, cell)
            connect(loop.GetOutputPort("reference"), drive.GetInputPort("reference"))
            torque = plant.get_net_actuation_output_port(parts.instance)
            connect(torque, drive.GetInputPort("spring_torque"))
            motor_state, position, velocity = (
                drive.GetOutputPort(name) for name in ("motor_state", "motor_position", "motor_velocity")
            )
        connect(motor_state, plant.get_desired_state_input_port(parts.instance))

        # Wrist sensor: the wrench at the weld between sensor and tool, tool weight included.
        if parts.sensor_weld is None or robot.parts.sensor_frame is None:
            raise BadInputError("tool: has no wrist sensor: must name one for station.fidelity = Multibody")
        mass, p_SScm, gravity = tool_load(robot)
        R_WS = robot.parts.sensor_frame.CalcPoseInWorld(posture).rotation()
        wrist = add("wrist", WeldWrench(plant, parts.sensor_weld, weight_wrench(R_WS, mass, p_SScm, gravity)))
        sensor = config.force_sensor.add_to(builder, config.period, wrench=True, seed=seed)
        compensation = add(
            "tool_compensation", ToolCompensation(robot, cell.n, q_0 if config.force_sensor.tare else None)
        )
        connect(plant.get_reaction_forces_output_port(), wrist.GetInputPort("reaction_forces"))
        connect(wrist.GetOutputPort("wrench"), sensor.GetInputPort("force"))
        connect(sensor.GetOutputPort("measured_force"), compensation.GetInputPort("wrench"))
        connect(position, compensation.GetInputPort("motor_position"))

        # Truth: the mounting of the (weightless) environment carries the contact force, along -z of its surface.
        mounting = add("mounting", WeldWrench(plant, weld, np.zeros(6)))
        force = add("contact_force", MatrixGain(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -1.0]])))
        monitor = add("contact_monitor", ContactMonitor(1, period=config.period))
        tip = add("tip_displacement", TipDisplacement(robot, cell.n, q_0))
        links = add("link_state", _split_state(plant, parts))
        connect(plant.get_reaction_forces_output_port(), mounting.GetInputPort("reaction_forces"))
        connect(mounting.GetOutputPort("wrench"), force.get_input_port())
        connect(force.get_output_port(), monitor.GetInputPort("contact_force"))
        connect(position, tip.GetInputPort("motor_position"))
        connect(plant.get_state_output_port(parts.instance), links.get_input_port())
        export_outputs(
            builder,
            {
                "motor_position": position,
                "motor_velocity": velocity,
                "measured_wrench": compensation.GetOutputPort("measured_wrench"),
                "measured_force": compensation.GetOutputPort("measured_force"),
                "contact_force": force.get_output_port(),
                "contact_displacement": tip.GetOutputPort("displacement"),
                "link_position": links.get_output_port(),
                "contact_state": monitor.GetOutputPort("contact_state"),
            },
        )
        builder.BuildInto(self)

    @staticmethod
    def _add_drive(builder: DiagramBuilder, cell: Cell) -> Drive:
        config, robot = cell.config, cell.robot
        facts, gains = robot.facts, config.servo
        posture = robot.create_context()
        robot.set_positions(posture, cell.start)
        to_motor = joint_to_motor(robot)
        core = DriveCore(
            facts.rotor_inertia * facts.gear_ratio**2,
            to_motor,
            period=config.time_step,
            substeps=max(1, round(gains.substeps * config.time_step / config.period)),
            position_gain=gains.position_gain,
            velocity_gain=gains.velocity_gain,
            integral_gain=gains.integral_gain,
            coulomb_friction=gains.friction_scale * facts.coulomb_friction,
            viscous_friction=gains.friction_scale * facts.viscous_friction,
            initial_position=cell.motor_start,
            initial_torque=robot.gravity_torque(posture),
        )
        drive: Drive = builder.AddNamedSystem("drive", Drive(core, to_motor))
        return drive


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
