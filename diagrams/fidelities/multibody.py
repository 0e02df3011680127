"""Fidelity `Multibody`: the robot as a MultibodyPlant, with drives, contact and sensors::

    joint_position_command -> drives (motor side) -> joint springs -> links -> tool -> contact
                                  ^ spring torque        wrist sensor <-'

The joint springs are actuator PD laws whose desired state is the motor side, and the contact is Drake's compliant point
contact with linear (Kelvin-Voigt) dissipation; the discrete SAP solver integrates both implicitly, so an environment
from 1e3 to 1e6 N/m and the joints stay stable at the default 1 ms. The step is an implicit Euler step: it damps a mode
of angular frequency w by an extra damping ratio of about w dt/2. A surface of a user's class acts by its force at the
TCP, one step old; a `!PegInBore` by the force that it predicts for the end of the step.

All arms share one plant. Links collide with each other as `self_collision` states; by default only with several arms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import (
    ConstantVectorSource,
    DiscreteTimeIntegrator,
    MatrixGain,
    Multiplexer,
    PassThrough,
)

from forcectl.arrays import Vector
from forcectl.diagrams.fidelities.light import add_sensors, check_one_sided
from forcectl.diagrams.mechanics.assembly import Assembly, selector
from forcectl.diagrams.mechanics.environment_body import drive_surface
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.mechanics.station_parts import add_pairs, add_parts, apply_forces
from forcectl.diagrams.mechanics.station_surface import add_contact_monitor, add_surface, feed_contact, is_uniform
from forcectl.diagrams.mechanics.world import add_world
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about
from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.framework.wiring import Enclosed, add_part, stacked, through
from forcectl.motion.loads import add_loads, loaded_frames
from forcectl.plant.drives.joint_friction import FrictionRest, actuation_gain, desired_state_gain
from forcectl.plant.tip_kinematics import TipDisplacement
from forcectl.plant.tip_load import HeldPart, LoadTruth, TipLoad


@dataclass(kw_only=True)
class MultibodyFidelity:
    """Scenario part `fidelity: Multibody`: rigid bodies, elastic joints with drives, contact and sensors."""

    has_dynamics = True
    constant_jacobian = False

    def check(self, workcell: Workcell) -> None:
        """Check that this fidelity can simulate the workcell.

        Raises:
            BadInputError: it has a two-sided spring, or a surface with a block of its own that has friction or turns.
        """
        check_one_sided(workcell)
        for contact in workcell.contacts:
            if contact.own_force and hasattr(contact.environment, "check_own_block"):
                with about(contact.environment):
                    contact.environment.check_own_block()

    def build(self, workcell: Workcell, seed: int) -> Diagram:
        """The station."""
        return MultibodyStation(workcell, seed)


class MultibodyStation(PythonDiagram):
    """The station with a full MultibodyPlant; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: MultibodyStation
    input_ports: [joint_position_command, joint_velocity_command (optional), joint_torque_feedforward (optional),
    gripper_command (optional), external_wrench (optional)]
    output_ports: [link_position, link_velocity, motor_position, motor_velocity, (further outputs of drive and
    sensors; in any order), measured_wrench (optional), measured_force (optional), joint_position (optional),
    joint_velocity (optional), motor_torque (optional), contact_force (optional), surface_height (optional),
    surface_tilt (optional), surface_damping (optional), surface_stiffness (optional), contact_displacement
    (optional), contact_state (optional), contact_losses (optional), applied_wrench (optional), external_torque
    (optional), tip_wrench (optional), arm_contact_force (optional), part_released (optional), gripper_holds
    (optional), part_position (optional), part_orientation (optional)]
    ```

    joint_position_command, joint_velocity_command, joint_torque_feedforward: shape (n,) [rad, rad/s, Nm]; the last two
    of drives that take them, and zero when they are not connected.
    gripper_command: shape (a,), of stations with parts that arms can hold, see `GripperOpening` [1].
    external_wrench: shape (6a,), on the robot at each TCP in the world, [torque; force] [Nm, N]; of stations with
    external_torque and without loads of their own, and zero when it is not connected.
    link_position, link_velocity: shape (n,), truth [rad, rad/s]. State.
    motor_position, motor_velocity: shape (n,), joint side [rad, rad/s]. State.
    measured_wrench: shape (6,), of the environment on the tool, at S in S, [torque; force] [Nm, N]. State.
    measured_force: shape (1,), along n [N]. State.
    joint_position, joint_velocity, motor_torque: shape (n,), readings [rad, rad/s, Nm]. State.
    contact_force: shape (k,), truth along each normal [N]. Feedthrough of external_wrench when a surface is a body.
    contact_state, contact_losses: shape (k,), see `ContactMonitor` [1]. State.
    contact_displacement: shape (k,), truth along each normal, of the motors [m]. State.
    surface_height, surface_damping, surface_stiffness: shape (1,), under the tool [m, N s/m, N/m]; the ports exist
    where the surface is uneven, and of several materials. State.
    surface_tilt: shape (1,), see `TurningSurface` [rad]; the port exists where the normal turns. State.
    applied_wrench: shape (6a,), of the station's loads, as external_wrench [Nm, N]. State.
    external_torque: shape (n,), truth [Nm]. Feedthrough of external_wrench.
    tip_wrench: shape (6a,), truth, at each TCP in the world, [torque; force] [Nm, N]. Feedthrough of external_wrench.
    arm_contact_force: shape (a,), truth, sum of magnitudes [N]. Feedthrough of external_wrench.
    part_released: shape (h,), truth, of the parts that arms can hold, see `GripperOpening` [1]. State.
    gripper_holds: shape (a,), readings, see `GripperOpening` [1]. State.
    part_position, part_orientation: shape (3m,), (4m,), truth, of m parts of assemblies in the world, see `PartPose`
    [m, 1]. State.
    All outputs are state, as far as those of further sensors are.

    Sampling: every `time_step` [s] of the workcell the plant and its drives; every `period` [s] commands and readings;
    every `posture_period` [s] what depends on the posture only.

    Args:
        workcell: the workcell.
        seed: of every random number of the station.

    Attributes:
        plant: of the station, for visualisation and tests.
        scene_graph: None where nothing can touch.
    """

    optional_inputs = ("joint_velocity_command", "joint_torque_feedforward", "gripper_command", "external_wrench")

    def __init__(self, workcell: Workcell, seed: int):
        super().__init__()
        builder = DiagramBuilder()
        assembly = Assembly(builder, workcell)
        site = add_world(builder, workcell, seed)
        plant, parts = site.plant, site.parts
        self.plant, self.scene_graph = plant, site.scene_graph
        size, n_q = plant.num_multibody_states(), plant.num_positions()
        for name, rows in (
            ("link_position", [joint.position_start() for joint in parts.joints]),
            ("link_velocity", [n_q + joint.velocity_start() for joint in parts.joints]),
        ):
            assembly.offer(name, through(builder, name, selector(size, rows, name), plant.get_state_output_port()))
        _add_drive(assembly, site)
        assembly.offer("reaction_forces", plant.get_reaction_forces_output_port())
        assembly.offer("contact_results", plant.get_contact_results_output_port())
        assembly.offer("body_poses", plant.get_body_poses_output_port())
        add_parts(assembly, site)
        forces = add_pairs(assembly, site)
        add_sensors(assembly, site)
        own = _add_surfaces(assembly, site)
        if "motor_torque" in assembly.signals or workcell.config.loads or own is not None:
            forces.append(_add_loads(assembly, site, own))
        apply_forces(builder, plant, forces)
        assembly.finish(self)


def _add_drive(assembly: Assembly, site: Site) -> None:
    """The drive, and its coupling to the plant."""
    builder, workcell, plant, parts = assembly.builder, site.workcell, site.plant, site.parts
    drive = add_part(workcell.config.drive, "drive", builder, site)
    assembly.add(drive, workcell.config.drive)
    signals, instance = assembly.signals, parts.instance
    n, elastic = workcell.num_joints, workcell.config.elastic_joints
    if elastic:
        ordered = _ordering(actuation_gain(plant, instance, parts.actuators).D().T)
        torque = through(builder, "spring_torque", ordered, plant.get_net_actuation_output_port(instance))
        assembly.offer("spring_torque", torque)
    elif drive.HasInputPort("spring_torque"):
        # Springs that model rigid joints are too stiff for the explicit step of the drives, which therefore have no
        # load, as in the stations without dynamics.
        rest = builder.AddNamedSystem("no_load", ConstantVectorSource(np.zeros(n)))
        assembly.offer("spring_torque", rest.get_output_port())
    if "joint_torque" in signals:
        _connect_rigid(assembly, site)
    elif "motor_position" in signals and "motor_velocity" in signals:
        if "motor_state" not in signals:
            both = builder.AddNamedSystem("motor_state", Multiplexer([n, n]))
            for i, name in enumerate(("motor_position", "motor_velocity")):
                builder.Connect(signals[name], both.get_input_port(i))
            assembly.offer("motor_state", both.get_output_port())
        ordered = _ordering(desired_state_gain(plant, instance, parts.actuators).D())
        springs = through(builder, "motor_side", ordered, signals["motor_state"])
        builder.Connect(springs, plant.get_desired_state_input_port(instance))
    else:
        raise BadInputError("must have the outputs motor_position and motor_velocity", key="drive")
    for name, link in (("motor_position", "link_position"), ("motor_velocity", "link_velocity")):
        if name not in signals:
            assembly.offer(name, signals[link])
    if "torque_integral" not in signals and elastic:
        # Torque sensors in the joints; a block that nothing reads costs nothing.
        integrator = DiscreteTimeIntegrator(n, workcell.config.time_step)
        assembly.offer("torque_integral", through(builder, "torque_integral", integrator, signals["spring_torque"]))


def _ordering(matrix: Vector) -> System:
    """A block with this gain, which sorts a vector into the order of a robot's actuators."""
    return PassThrough(len(matrix)) if np.array_equal(matrix, np.eye(len(matrix))) else MatrixGain(matrix)


def _connect_rigid(assembly: Assembly, site: Site) -> None:
    """Connect motor torque and friction of joints without springs."""
    builder, workcell, plant, parts = assembly.builder, site.workcell, site.plant, site.parts
    connect, instance = builder.Connect, parts.instance
    torque = actuation_gain(plant, instance, parts.actuators)
    motors = through(builder, "motors", torque, assembly.signals["joint_torque"])
    connect(motors, plant.get_actuation_input_port(instance))
    rest = builder.AddNamedSystem("at_rest", ConstantVectorSource(np.zeros(2 * workcell.num_joints)))
    no_motion = desired_state_gain(plant, instance, site.friction)
    sticking = through(builder, "sticking", no_motion, rest.get_output_port())
    connect(sticking, plant.get_desired_state_input_port(instance))
    n_q, n_v = plant.num_positions(), plant.num_velocities()
    every = selector(n_q + n_v, list(range(n_q, n_q + n_v)), "velocity")
    speeds = through(builder, "speeds", every, plant.get_state_output_port())
    friction = FrictionRest(plant, parts.joints, workcell.config.drive.true_friction(workcell.robot))
    drag = through(builder, "friction", friction, speeds)
    connect(drag, plant.get_applied_generalized_force_input_port())


def _add_surfaces(assembly: Assembly, site: Site) -> OutputPort | None:
    """Add uneven surfaces, surfaces with a force block of their own, and the truth of all contacts.

    Returns:
        the wrenches of surfaces with their own block at the TCPs, shape (6a,) [Nm, N]; None without such surfaces.
    """
    builder, workcell, signals = assembly.builder, site.workcell, assembly.signals
    forces: dict[int, OutputPort] = {}
    displacements = []
    for i, (contact, mounting) in enumerate(zip(workcell.contacts, site.mountings, strict=True)):
        label = contact.name if len(workcell.contacts) > 1 else ""
        # The height of an uneven surface is that at the position of the links.
        if len(workcell.contacts) > 1 and not is_uniform(contact):
            with about(contact.environment):
                raise BadInputError(" must be flat and of one material where there are other surfaces", key="surface")
        surface = add_surface(builder, workcell, contact, signals["link_position"], workcell.start)
        if mounting is not None:
            drive_surface(builder, workcell, contact, site.plant, mounting, surface)
        else:
            forces[i] = _add_own_surface(assembly, workcell, contact, surface)
        for name, port in surface.items():
            if name != "plane_state":
                assembly.offer(name, port)
        tip = TipDisplacement(contact.robot, contact.n, workcell.motor_start, period=None)
        name = "_".join(filter(None, ("tip_displacement", label)))
        displacements.append(through(builder, name, tip, signals["motor_position"]))
    if not workcell.contacts:
        return None
    assembly.offer("contact_displacement", stacked(builder, "contact_displacements", displacements))
    if "contact_force" not in signals:
        mounted = [mounting for mounting in site.mountings if mounting is not None]
        if mounted:
            truth = builder.AddNamedSystem("contact_truth", MountingForces(site.plant, mounted))
            builder.Connect(signals["reaction_forces"], truth.get_input_port())
            rows = iter(range(len(mounted)))
            for i, mounting in enumerate(site.mountings):
                if mounting is not None:
                    forces[i] = truth.get_output_port(next(rows))
        ordered = [forces[i] for i in range(len(workcell.contacts))]
        assembly.offer("contact_force", stacked(builder, "contact_forces", ordered))
    add_contact_monitor(assembly, workcell, signals["contact_force"])
    return _own_wrenches(builder, workcell, {i: port for i, port in forces.items() if site.mountings[i] is None})


def _add_own_surface(
    assembly: Assembly, workcell: Workcell, contact: Contact, uneven: Mapping[str, OutputPort]
) -> OutputPort:
    """Add a surface of a user's class: its force from the displacement of the links."""
    builder = assembly.builder
    place = TipDisplacement(contact.robot, contact.n, workcell.start, period=None)
    displacement = through(builder, f"place_on_{contact.name}", place, assembly.signals["link_position"])
    inner = DiagramBuilder()
    own = contact.add_to(inner, workcell.config.time_step, robot_compliance=0.0)
    surface = builder.AddNamedSystem(f"surface_{contact.name}", Enclosed(inner, own))
    return feed_contact(assembly, contact, surface, {"displacement": displacement}, uneven)


def _own_wrenches(builder: DiagramBuilder, workcell: Workcell, forces: dict[int, OutputPort]) -> OutputPort | None:
    if not forces:
        return None
    arms = list(workcell.robot.parts.arms)
    gain = np.zeros((6 * len(arms), len(forces)))
    for column, i in enumerate(forces):
        row = 6 * arms.index(workcell.contacts[i].arm) + 3
        gain[row : row + 3, column] = workcell.contacts[i].n
    return through(builder, "contact_wrench", MatrixGain(gain), stacked(builder, "own_forces", list(forces.values())))


def _add_loads(assembly: Assembly, site: Site, own: OutputPort | None) -> OutputPort:
    """Add loads and the joint torques that loads and contacts cause; returns the loads as forces on the plant."""
    builder, workcell, plant, parts = assembly.builder, site.workcell, site.plant, site.parts
    loads, signals = workcell.config.loads, assembly.signals
    frames = loaded_frames(loads, workcell.robot)
    in_plant = [plant.GetFrameByName(name, parts.instance) for name in frames]
    load = builder.AddNamedSystem("load", TipLoad(parts, in_plant))
    arms = list(parts.arms)
    held = [HeldPart(arms.index(part.config.arm), part.bodies) for part in site.held]
    pairs = len(site.pairs)
    block = LoadTruth(workcell.robot, plant, parts, list(frames.values()), held, pairs)
    truth = builder.AddNamedSystem("truth", block)
    for name in (f"contact_pair_{i + 1}" for i in range(pairs)):
        builder.Connect(signals[name], truth.GetInputPort(name))
    if held:
        builder.Connect(signals["part_released"], truth.GetInputPort("part_released"))
    if loads:
        for name, port in add_loads(builder, loads, workcell.robot, workcell.period).items():
            for block in (load, truth):
                builder.Connect(port, block.GetInputPort(name))
            if name == "external_wrench":
                assembly.offer("applied_wrench", port)
    else:
        assembly.require("external_wrench", load.GetInputPort("external_wrench"))
        assembly.require("external_wrench", truth.GetInputPort("external_wrench"))
    if own is not None:
        for block in (load, truth):
            builder.Connect(own, block.GetInputPort("contact_wrench"))
    builder.Connect(signals["link_position"], truth.GetInputPort("link_position"))
    if site.scene_graph is not None:
        builder.Connect(signals["contact_results"], truth.GetInputPort("contact_results"))
        torque = plant.get_generalized_contact_forces_output_port(parts.instance)
        builder.Connect(torque, truth.GetInputPort("contact_torque"))
    for name in ("external_torque", "tip_wrench", "arm_contact_force"):
        assembly.offer(name, truth.GetOutputPort(name))
    return load.GetOutputPort("spatial_forces")


class MountingForces(PythonBlock):
    """True contact forces along the normals: the reactions at the mountings of the surfaces.

    ```
    name: MountingForces
    input_ports: [reaction_forces]
    output_ports: [contact_force_1, (further ones of the same kind)]
    ```

    reaction_forces: abstract, list of SpatialForce of the plant's joints.
    contact_force_1: shape (1,), of the first surface [N]; contact_force_2 of the second, and so on. All outputs are
    feedthrough of reaction_forces.

    Sampling: none; evaluated when read.

    Args:
        plant: finalized.
        mountings: welds of the surfaces, which are massless, their normals +z.
    """

    def __init__(self, plant: MultibodyPlant, mountings: list[Joint]):
        super().__init__()
        joints = list(plant.GetJointIndices())
        self._reactions = self.DeclareAbstractInputPort("reaction_forces", AbstractValue.Make([SpatialForce.Zero()]))
        self.port_units = {f"contact_force_{i + 1}": "N" for i in range(len(mountings))}
        for i, mounting in enumerate(mountings):
            self._declare(f"contact_force_{i + 1}", joints.index(mounting.index()))

    def _declare(self, name: str, row: int) -> None:
        reactions = self._reactions

        def show(context: Context, output: BasicVector) -> None:
            output.SetAtIndex(0, reactions.Eval(context)[row].translational()[2])

        self.DeclareVectorOutputPort(name, 1, show, prerequisites_of_calc={reactions.ticket()})
