"""The parts do in contact what they are for: a plunger finds the bore, a bayonet locks."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from forcectl.models import add_packages
from forcectl.models.make_parts import CLEARANCES
from forcectl.plant import ContactWrench
from tests.examples.insertion import insert, misalignments


@pytest.mark.slow
@pytest.mark.parametrize("clearance", CLEARANCES)
def test_a_misaligned_plunger_is_led_into_the_bore(clearance):
    """The deeper it is the less it can tilt: by two clearances over what is engaged, and what the contact gives way."""
    run = insert(clearance, misalignments(1)[0], duration=0.8, time_step=0.002)
    assert run.depth[-1] > 0.05
    play = 2 * CLEARANCES[clearance] / (run.depth[-1] - 0.012)
    assert run.tilt[-1] < 1.1 * play + np.radians(0.1)
    assert run.tilt[-1] < 0.6 * run.tilt[0]
    assert not run.force[:, run.depth < -1e-4].any()
    assert 0.5 < run.force[2].max() < 10.0


class Lock:
    """A cap that is fixed, and a mount above it on springs along and about the axis; in steps of 2 ms."""

    def __init__(self) -> None:
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
        plant.SetUseSampledOutputPorts(False)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        parser = Parser(plant)
        add_packages(parser.package_map())
        parser.AddModelsFromUrl("package://parts/bayonet_cap.urdf")
        parser.AddModelsFromUrl("package://parts/bayonet_mount.urdf")
        mouth = plant.GetFrameByName("mouth")
        plant.WeldFrames(plant.world_frame(), mouth)
        grasp, parent = plant.AddModelInstance("grasp"), plant.world_frame()
        for name, kind, gains in (("slide", PrismaticJoint, (3000.0, 20.0)), ("turn", RevoluteJoint, (3.0, 0.02))):
            child = plant.AddRigidBody(name, grasp, SpatialInertia.SolidSphereWithMass(0.05, 0.02)).body_frame()
            joint = plant.AddJoint(kind(name, parent, child, [0.0, 0.0, 1.0]))
            plant.AddJointActuator(name, joint).set_controller_gains(PdControllerGains(p=gains[0], d=gains[1]))
            parent = child
        plant.WeldFrames(parent, plant.GetFrameByName("tip"), RigidTransform())
        plant.Finalize()
        mount = frozenset({int(plant.GetBodyByName("mount").index())})
        truth = builder.AddNamedSystem("truth", ContactWrench(plant, mount, None, mouth))
        builder.Connect(plant.get_contact_results_output_port(), truth.GetInputPort("contact_results"))
        builder.Connect(plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
        self._simulator = Simulator(builder.Build())
        root = self._simulator.get_mutable_context()
        self._plant, self._plant_context = plant, plant.GetMyMutableContextFromRoot(root)
        self._command, self._wrench = plant.get_desired_state_input_port(grasp), truth.get_output_port()
        self._truth_context = truth.GetMyContextFromRoot(root)
        self._at = np.array([-0.0075, 0.0])  # the pins 2.5 mm deep in the slots
        plant.SetPositions(self._plant_context, self._at)

    def move(self, depth: float, degrees: float, duration: float) -> np.ndarray:
        """To a depth of the tip and an angle, steadily; rows of depth, angle [deg], torque [Nm] and force [N]."""
        goal, count = np.array([-depth, np.radians(degrees)]), round(duration / 0.01)
        rows = []
        for i in range(count):
            there = self._at + (goal - self._at) * (i + 1) / count
            self._command.FixValue(self._plant_context, np.concatenate([there, (goal - self._at) / duration]))
            self._simulator.AdvanceTo(self._simulator.get_context().get_time() + 0.01)
            z, angle = self._plant.GetPositions(self._plant_context)
            wrench = self._wrench.Eval(self._truth_context)
            rows.append([-z, np.degrees(angle), -wrench[2], -wrench[5]])
        self._at = goal
        return np.array(rows)


@pytest.mark.slow
def test_a_bayonet_locks_with_a_rise_of_torque():
    lock = Lock()
    lock.move(0.0082, 0.0, 0.1)
    turning = lock.move(0.0082, 76.0, 1.0)
    _, angle, torque, _ = turning.T
    assert np.abs(torque[angle < 20]).max() < 2e-3  # free
    on_the_ramp = torque[(angle > 45) & (angle < 59)].max()
    assert 0.015 < on_the_ramp < 0.05
    assert torque[(angle > 62) & (angle < 69)].max() < 0.5 * on_the_ramp  # in the notches
    assert torque[-1] > 0.1  # at their ends
    assert angle.max() < 75.0
    assert turning[:, 0].max() > 0.0087  # pulled in, against the springs of the grasp
    lock.move(0.0082, 70.0, 0.2)
    pulled = lock.move(0.003, 70.0, 0.3)
    assert pulled[-1, 3] > 12.0  # [N]
    assert pulled[-1, 0] > 0.0085


def test_a_bayonet_that_is_not_turned_comes_off():
    lock = Lock()
    lock.move(0.0082, 0.0, 0.1)
    assert lock.move(-0.001, 0.0, 0.3)[-1, 0] < 0.0
