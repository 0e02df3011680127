"""A rig that pushes a plunger into the bore of a pipette's body, held by a compliant grasp.

The body is fixed with its mouth upwards. The plunger hangs on the grasp: springs across and along the axis and against
tilting, 100 mm behind its tip. The grasp goes down at a constant speed, beside the axis and askew.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from forcectl.models import add_packages
from forcectl.models.make_parts import CLEARANCES
from forcectl.plant import ContactWrench, PegContact, PegInBoreConfig

Array = np.ndarray
ABOVE = 0.005  # [m] of the tip over the mouth at the start
HELD = 0.1  # [m] of the grasp behind the tip
ACROSS, ALONG, TILTING = (1000.0, 30.0), (2000.0, 60.0), (3.0, 0.1)  # stiffness and damping of the grasp [N/m, Nm/rad]


@dataclass(frozen=True)
class Misalignment:
    """Of the grasp: offset across the axis [m], tilt about x and y [rad]."""

    offset: tuple[float, float]
    tilt: tuple[float, float]


def misalignments(count: int, offset: float = 3e-3, tilt: float = np.radians(5.0), seed: int = 0) -> list[Misalignment]:
    """Random directions and sizes, from a third to the whole of the largest."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        sizes, angles = rng.uniform(1 / 3, 1.0, 2), rng.uniform(0, 2 * np.pi, 2)
        along, across = np.array([offset, tilt]) * sizes * np.array([np.cos(angles), np.sin(angles)])
        found.append(Misalignment((along[0], across[0]), (along[1], across[1])))
    return found


def at_tip(misaligned: Misalignment) -> Misalignment:
    """Of a grasp whose plunger has this misalignment at its tip.

    Turned by 5 degrees about the grasp alone, the tip would come beside the mouth.
    """
    x_tilt, y_tilt = misaligned.tilt
    turned = RotationMatrix.MakeXRotation(x_tilt) @ RotationMatrix.MakeYRotation(y_tilt)
    x, y, _ = np.array([*misaligned.offset, 0.0]) - turned @ [0.0, 0.0, -HELD]
    return Misalignment((x, y), misaligned.tilt)


class Descent(LeafSystem):
    """Desired state of the grasp's springs: down at a constant speed [m/s] until a time [s], the rest as misaligned."""

    def __init__(self, start: Array, speed: float, until: float):
        super().__init__()
        n = len(start)

        def show(context, output):
            desired = np.concatenate([start, np.zeros(n)])
            desired[2] -= speed * min(context.get_time(), until)
            desired[n + 2] = -speed * (context.get_time() < until)
            output.SetFromVector(desired)

        self.DeclareVectorOutputPort("desired_state", 2 * n, show, {self.time_ticket()})


@dataclass
class Run:
    """What a run shows over time.

    Attributes:
        depth: of the tip below the mouth [m].
        force: of the bore on the plunger in the mouth frame, shape (3, samples) [N].
        tilt: of the plunger [rad].
        place: of the grasp across the axis, shape (2, samples) [m].
    """

    time: Array
    depth: Array
    force: Array
    tilt: Array
    place: Array

    def insertion_force(self, depth: float) -> tuple[float, float]:
        """Along the axis down to a depth: its mean over the way, and the largest of its means over 10 steps [N]."""
        way = np.linspace(0.0, depth, 1001)
        smooth = np.convolve(self.force[2], np.full(10, 0.1), "same")
        within = (self.depth > 0) & (self.depth < depth)
        return float(np.interp(way, self.depth, self.force[2]).mean()), float(smooth[within].max())


AddContact = Callable[[DiagramBuilder, MultibodyPlant], OutputPort]


def build(
    clearance: str,
    misaligned: Misalignment,
    *,
    speed: float = 0.075,
    until: float = np.inf,
    above: float = ABOVE,
    time_step: float = 0.001,
    contact: AddContact | None = None,
) -> tuple[Diagram, VectorLogSink, VectorLogSink]:
    """The rig; `contact` adds a contact in place of the geometry and returns its wrench on the plunger at the mouth."""
    builder = DiagramBuilder()
    if contact is None:
        plant, _ = AddMultibodyPlantSceneGraph(builder, time_step)
    else:
        plant = builder.AddNamedSystem("plant", MultibodyPlant(time_step))
    plant.SetUseSampledOutputPorts(False)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    parser = Parser(plant)
    add_packages(parser.package_map())
    bore = "pipette_body_fine" if clearance == "0p1" else "pipette_body"
    (tube,) = parser.AddModelsFromUrl(f"package://parts/{bore}.urdf")
    (plunger,) = parser.AddModelsFromUrl(f"package://parts/pipette_plunger_{clearance}.urdf")
    mouth, tip = plant.GetFrameByName("mouth", tube), plant.GetFrameByName("tip", plunger)
    plant.WeldFrames(plant.world_frame(), mouth)
    parent, inertia = plant.world_frame(), SpatialInertia.SolidSphereWithMass(0.005, 0.02)
    kinds = [(PrismaticJoint, axis, ACROSS if axis != 2 else ALONG) for axis in range(3)]
    kinds += [(RevoluteJoint, axis, TILTING) for axis in range(2)]
    carriers = plant.AddModelInstance("grasp")
    for i, (kind, axis, (stiffness, damping)) in enumerate(kinds):
        child = plant.AddRigidBody(f"carrier_{i}", carriers, inertia).body_frame()
        joint = plant.AddJoint(kind(f"grasp_{i}", parent, child, np.eye(3)[axis]))
        actuator = plant.AddJointActuator(f"spring_{i}", joint)
        actuator.set_controller_gains(PdControllerGains(p=stiffness, d=damping))
        parent = child
    plant.WeldFrames(parent, tip, RigidTransform([0.0, 0.0, -HELD]))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    start = np.array([*misaligned.offset, above + HELD, *misaligned.tilt])
    plant.SetDefaultPositions(start)
    descent = builder.AddNamedSystem("descent", Descent(start, speed, until))
    builder.Connect(descent.get_output_port(), plant.get_desired_state_input_port(carriers))
    force = (contact or _geometry)(builder, plant)
    state_log = LogVectorOutput(plant.get_state_output_port(), builder, time_step)
    force_log = LogVectorOutput(force, builder, time_step)
    builder.ExportOutput(plant.get_state_output_port(), "state")
    return builder.Build(), state_log, force_log


def analytic(clearance: str, time_step: float = 0.001, **coefficients: float) -> AddContact:
    """`PegContact` in place of the geometry."""

    def add(builder: DiagramBuilder, plant: MultibodyPlant) -> OutputPort:
        config = PegInBoreConfig(clearance=CLEARANCES[clearance], **coefficients)
        tip, mouth = plant.GetFrameByName("tip"), plant.GetFrameByName("mouth")
        block = builder.AddNamedSystem("peg_contact", PegContact(plant, tip, mouth, config, time_step=time_step))
        builder.Connect(plant.get_body_poses_output_port(), block.GetInputPort("body_poses"))
        builder.Connect(plant.get_body_spatial_velocities_output_port(), block.GetInputPort("body_velocities"))
        builder.Connect(block.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
        return block.GetOutputPort("body_contact_wrench")

    return add


def _geometry(builder: DiagramBuilder, plant: MultibodyPlant) -> OutputPort:
    on = frozenset({int(plant.GetBodyByName("plunger").index())})
    truth = builder.AddNamedSystem("truth", ContactWrench(plant, on, None, plant.GetFrameByName("mouth")))
    builder.Connect(plant.get_contact_results_output_port(), truth.GetInputPort("contact_results"))
    builder.Connect(plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    return truth.get_output_port()


def insert(clearance: str, misaligned: Misalignment, duration: float = 1.0, **options: Any) -> Run:
    """Push it in."""
    diagram, state_log, force_log = build(clearance, misaligned, **options)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(duration)
    context = simulator.get_context()
    states, forces = state_log.FindLog(context), force_log.FindLog(context)
    q = states.data()[:5]
    # Tip below the mouth: the grasp's height, minus what is held, turned.
    depth = HELD * np.cos(q[3]) * np.cos(q[4]) - q[2]
    return Run(states.sample_times(), depth, forces.data()[3:], np.hypot(q[3], q[4]), q[:2])
