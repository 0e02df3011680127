"""Examples of the stations and of their parts: drives, sensors, the truth of contacts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.diagrams.drives.joint_interface import JointInterface
from forcectl.diagrams.drives.motor_side import MotorSide
from forcectl.diagrams.drives.position_drive import JointImpedanceDriveConfig, PositionDrive, PositionDriveConfig
from forcectl.diagrams.fidelities.light import LightStation
from forcectl.diagrams.fidelities.multibody import MountingForces, MultibodyStation
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.mechanics.world import add_world
from forcectl.diagrams.sensors import NormalForce, WristForce, WristForceConfig
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.models import add_packages
from forcectl.plant.contact.compliant_contact import CompliantContact, EnvironmentConfig
from forcectl.plant.contact.contact_truth import ContactWrench, bodies_named
from forcectl.plant.contact.gripper_opening import Grasp, GripperOpening
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.pairs.peg_contact import PegContact
from forcectl.plant.contact.pairs.peg_in_bore import PegInBoreConfig
from forcectl.plant.contact.part import GraspConfig, PartConfig
from forcectl.plant.contact.part_pose import PartPose
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.contact.surface_materials import MaterialsConfig, SegmentConfig
from forcectl.plant.drives.position_loop import PositionLoopConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.plant.sensors.force_sensor import ForceSensorConfig
from forcectl.testing.runs import Input
from tests.examples import insertion
from tests.examples.block_example import Example, each
from tests.examples.held_parts import beside_the_bore
from tests.examples.stations import free, pressing

ARM = "yumi/left"
PERIOD = {"period": 0.002}  # of the stations that press
POSTURE = PERIOD | {"posture_period": 0.04}
STEP = {"time_step": 0.001}
TICKS = PERIOD | STEP
INTERFACE = {"period": 0.004} | STEP  # of the stations behind the joint interface


@dataclass(kw_only=True)
class Foam:
    """A surface of a user's own: no body, no sides, nothing but its force."""

    softness: float = 2e-4  # [m/N]
    arm: str = ""

    @property
    def first_stiffness(self) -> float:
        return 1 / self.softness

    def add_to(
        self, builder: DiagramBuilder, size: int, period: float, *, robot_compliance: ArrayLike = 0.0
    ) -> CompliantContact:
        block = CompliantContact(
            size, stiffness=self.first_stiffness, damping=10.0, robot_compliance=robot_compliance, period=period
        )
        return builder.AddNamedSystem("foam", block)


@cache
def pressing_workcell(fidelity: str, **options: Any) -> Workcell:
    return describe(pressing(fidelity=fidelity, **options))


@cache
def arm_workcell(**options: Any) -> Workcell:
    return describe(free(robot=ARM, tool=None, **options))


@cache
def touching_workcell(elastic_joints: bool) -> Workcell:
    """The arm with its tip 2 mm inside a box, and friction that sticks."""
    robot = arm_workcell().robot
    p = robot.pose(arm_workcell().start_context()).translation()
    box = ObstacleConfig(size=[0.2, 0.2, 0.2], position=[p[0], p[1], p[2] - 0.1])
    return describe(free(robot=ARM, tool=None, elastic_joints=elastic_joints, obstacles=[box]))


def both_arms_on(second: Any) -> Workcell:
    parts = {"table": EnvironmentConfig(arm="left"), "second": second}
    return describe(free(environment=EnvironmentPartsConfig(parts=parts)))


@cache
def two_tables() -> Workcell:
    return both_arms_on(EnvironmentConfig(arm="right", stiffness=1e4))


@cache
def table_and_foam() -> Workcell:
    return both_arms_on(Foam(arm="right"))


def uneven() -> EnvironmentConfig:
    """A slope of two damped materials."""
    segments = [
        SegmentConfig(material="plastic", start=-0.1, end=0.02, damping=10.0),
        SegmentConfig(material="wood", start=0.02, end=0.1, damping=20.0),
    ]
    return EnvironmentConfig(surface=SurfaceConfig(slope=0.01, materials=MaterialsConfig(segments=segments)))


def in_plant(workcell: Workcell) -> Site:
    """The site of a part in the station's plant; its builder is kept alive by the plant."""
    return add_world(DiagramBuilder(), workcell, 3)


def moved(workcell: Workcell):
    """A swing of all joints around the start."""
    n = workcell.num_joints
    return lambda t: workcell.start + 0.05 * np.sin(np.arange(1, n + 1) * 10 * t)


def speeds(workcell: Workcell):
    n = workcell.num_joints
    return lambda t: 0.5 * np.arange(1, n + 1) * np.cos(np.arange(1, n + 1) * 10 * t)


def wrench(arms: int):
    return lambda t: np.tile([0.1, 0.0, 0.2, 5.0, -3.0, 4.0], arms) * min(1.0, 50 * t)


def swing(size: float):
    return lambda t: size * np.sin(40 * t + np.arange(6))


def motor_side(ideal: bool) -> MotorSide:
    return MotorSide(pressing_workcell("OneDimensional"), PositionLoopConfig(), ServoConfig(ideal=ideal))


def position_drive(**servo: Any) -> PositionDrive:
    workcell = pressing_workcell("Multibody")
    made = PositionDriveConfig(servo=ServoConfig(**servo)).add_to(DiagramBuilder(), Site(workcell, 3))
    assert isinstance(made, PositionDrive)
    return made


def impedance_drive() -> PositionDrive:
    workcell = describe(pressing(fidelity="Multibody", drive=JointImpedanceDriveConfig()))
    made = workcell.config.drive.add_to(DiagramBuilder(), Site(workcell, 3))
    assert isinstance(made, PositionDrive)
    return made


def joint_interface(elastic_joints: bool) -> JointInterface:
    workcell = arm_workcell(elastic_joints=elastic_joints)
    return JointInterface(workcell, workcell.config.drive)


def mounting_forces() -> MountingForces:
    site = in_plant(two_tables())
    return MountingForces(site.plant, list(site.mountings))


def contact_wrench() -> ContactWrench:
    plant = in_plant(touching_workcell(False)).plant
    return ContactWrench(plant, bodies_named(plant, ["left_link_7"], "on"), None, plant.world_frame())


@cache
def holding_workcell() -> Workcell:
    """An arm that holds a cap, lets go of it after 20 ms, and a mount that is fixed."""
    cap = PartConfig(model="bayonet_cap", arm="left", grasp=GraspConfig(released_at=0.02))
    parts = {"cap": cap, "mount": PartConfig(model="bayonet_mount", position=[0.5, 0.0, 0.0])}
    return describe(free(robot=ARM, tool=None, environment=EnvironmentPartsConfig(parts=parts)))


@cache
def inserting_workcell() -> Workcell:
    """An arm that holds a plunger, askew in a bore, without the contact of their shapes."""
    config = beside_the_bore(1e-3, shapes=False).config
    return describe(replace(config, sensors={"joints": config.sensors["joints"]}))


def wrench_in_the_bore() -> ContactWrench:
    plant = in_plant(inserting_workcell()).plant
    return ContactWrench(plant, bodies_named(plant, ["plunger"], "on"), None, plant.world_frame(), pairs=1)


def gripper_opening() -> GripperOpening:
    grasps = [Grasp(0, GraspConfig()), Grasp(1, GraspConfig(released_at=0.04), held=False)]
    return GripperOpening(grasps, 2, period=0.002)


def part_pose() -> PartPose:
    return PartPose([part.frame for part in in_plant(holding_workcell()).placed])


def plant_of_parts(*names: str) -> MultibodyPlant:
    """Shipped parts, free, with nothing else."""
    plant = MultibodyPlant(0.001)
    parser = Parser(plant)
    add_packages(parser.package_map())
    for name in names:
        parser.AddModelsFromUrl(f"package://parts/{name}.urdf")
    plant.Finalize()
    return plant


def peg_contact_in_a_plant(config: PegInBoreConfig) -> tuple[PegContact, MultibodyPlant]:
    plant = plant_of_parts("pipette_body", "pipette_plunger_0p5")
    tip, mouth = plant.GetFrameByName("tip"), plant.GetFrameByName("mouth")
    return PegContact(plant, tip, mouth, config, time_step=0.001), plant


def peg_contact() -> PegContact:
    return peg_contact_in_a_plant(PegInBoreConfig())[0]


def example(workcell: Callable[[], Workcell], periods: dict[str, float], *truth: str) -> Example:
    """Of the station of a workcell; the truth feels the wrench from outside, where there is one."""
    workcell = cache(workcell)
    inputs: dict[str, Input] = {"joint_position_command": lambda t: moved(workcell())(t)}
    if truth:
        inputs["external_wrench"] = lambda t: wrench(len(workcell().robot.parts.arms))(t)
    return Example(
        lambda: build_station(workcell(), 3), {(name, "external_wrench") for name in truth}, inputs, periods=periods
    )


LOADED = ("external_torque", "tip_wrench", "arm_contact_force")
ONE_DIMENSIONAL, KINEMATIC, MULTIBODY = (
    partial(pressing_workcell, fidelity) for fidelity in ("OneDimensional", "Kinematic", "Multibody")
)

STATION_EXAMPLES: dict[type[System], list[Example]] = {
    LightStation: [
        example(ONE_DIMENSIONAL, PERIOD),
        example(lambda: describe(pressing(fidelity="OneDimensional", environment=uneven())), PERIOD),
        example(lambda: describe(pressing(fidelity="OneDimensional", environment=Foam())), PERIOD),
        example(KINEMATIC, POSTURE),
        example(lambda: describe(pressing(fidelity="Kinematic", environment=uneven())), POSTURE),
        example(lambda: describe(pressing(fidelity="Kinematic", environment=Foam())), PERIOD),
    ],
    MultibodyStation: [
        example(MULTIBODY, POSTURE | STEP),
        example(lambda: describe(pressing(fidelity="Multibody", environment=uneven())), POSTURE | STEP),
        example(lambda: describe(pressing(fidelity="Multibody", environment=Foam(), sensors={})), TICKS, *LOADED),
        example(lambda: describe(pressing(fidelity="Multibody", drive=JointImpedanceDriveConfig())), POSTURE | STEP),
        *(
            example(partial(workcell, elastic_joints=elastic), INTERFACE, *LOADED)
            for elastic in (False, True)
            for workcell in (arm_workcell, touching_workcell)
        ),
        example(two_tables, INTERFACE, "contact_force", *LOADED),
        example(table_and_foam, INTERFACE, "contact_force", *LOADED),
        example(holding_workcell, INTERFACE, *LOADED),
        example(inserting_workcell, INTERFACE, *LOADED),
    ],
    MotorSide: [
        Example(
            partial(motor_side, ideal),
            inputs={"joint_position_command": lambda t: moved(ONE_DIMENSIONAL())(t)},
            periods=PERIOD,
        )
        for ideal in (False, True)
    ],
    PositionDrive: [
        Example(
            build,
            inputs={"joint_position_command": lambda t: moved(MULTIBODY())(t), "spring_torque": swing(20.0)},
            periods=TICKS,
        )
        for build in (position_drive, impedance_drive)
    ]
    + [
        Example(
            partial(position_drive, ideal=True),
            inputs={"joint_position_command": lambda t: moved(MULTIBODY())(t)},
            periods=TICKS,
        )
    ],
    JointInterface: [
        Example(
            partial(joint_interface, False),
            each("joint_torque", "link_position", "link_velocity"),
            {
                "joint_position_command": lambda t: moved(arm_workcell())(t),
                "joint_velocity_command": lambda t: speeds(arm_workcell())(t),
                "link_position": lambda t: 0.9 * moved(arm_workcell())(t),
                "link_velocity": lambda t: 0.8 * speeds(arm_workcell())(t),
            },
            periods=INTERFACE,
        ),
        Example(
            partial(joint_interface, True),
            inputs={
                "joint_position_command": lambda t: moved(arm_workcell())(t),
                "joint_torque_feedforward": lambda t: speeds(arm_workcell())(t),
                "spring_torque": lambda t: speeds(arm_workcell())(t),
            },
            periods=INTERFACE,
        ),
    ],
    NormalForce: [
        Example(
            lambda: NormalForce(ForceSensorConfig(noise_std=0.1), Site(KINEMATIC(), 3)),
            each("measured_force", "contact_force") | each("measured_wrench", "contact_force", "motor_position"),
            {"contact_force": lambda t: 15 * t, "motor_position": lambda t: moved(KINEMATIC())(t)},
            periods=PERIOD,
        ),
        Example(
            lambda: NormalForce(ForceSensorConfig(delay=0.004), Site(KINEMATIC(), 3)),
            each("measured_wrench", "motor_position"),
            {"contact_force": lambda t: 15 * t, "motor_position": lambda t: moved(KINEMATIC())(t)},
            periods=PERIOD,
        ),
    ],
    WristForce: [
        Example(
            lambda: WristForce(WristForceConfig(noise_std=0.1), in_plant(MULTIBODY())),
            {(name, "reaction_forces") for name in ("measured_wrench", "measured_force", "contact_force")},
            {"joint_position_command": lambda t: moved(MULTIBODY())(t)},
            runnable=lambda: build_station(MULTIBODY(), 3),
            periods=POSTURE,
        ),
        Example(
            lambda: WristForce(WristForceConfig(delay=0.004), in_plant(MULTIBODY())),
            each("contact_force", "reaction_forces"),
            {"joint_position_command": lambda t: moved(MULTIBODY())(t)},
            runnable=lambda: build_station(MULTIBODY(), 3),
            periods=POSTURE,
        ),
    ],
    ContactWrench: [
        Example(
            contact_wrench,
            each("body_contact_wrench", "contact_results", "body_poses"),
            {"joint_position_command": lambda t: moved(touching_workcell(False))(t)},
            runnable=lambda: build_station(touching_workcell(False), 3),
        ),
        Example(
            wrench_in_the_bore,
            each("body_contact_wrench", "contact_results", "body_poses", "contact_pair_1"),
            {"joint_position_command": lambda t: moved(inserting_workcell())(t)},
            runnable=lambda: build_station(inserting_workcell(), 3),
        ),
    ],
    GripperOpening: [
        Example(
            gripper_opening,
            inputs={
                "gripper_command": lambda t: np.array([float(t < 0.02 or t > 0.05), 1.0]),
                "grasp_offset": lambda t: np.full(12, 1e-3),
            },
            periods=PERIOD,
        )
    ],
    PartPose: [
        Example(
            part_pose,
            each("part_position", "body_poses") | each("part_orientation", "body_poses"),
            {"joint_position_command": lambda t: moved(holding_workcell())(t)},
            runnable=lambda: build_station(holding_workcell(), 3),
        )
    ],
    PegContact: [
        Example(
            peg_contact,
            {
                pair
                for output in ("spatial_forces", "body_contact_wrench", "contact_pair")
                for pair in each(output, "body_poses", "body_velocities", "released")
            },
            runnable=lambda: insertion.build(
                "0p5", insertion.misalignments(1)[0], contact=insertion.analytic("0p5"), above=-0.01
            )[0],
            periods=STEP,
        )
    ],
    MountingForces: [
        Example(
            mounting_forces,
            each("contact_force_1", "reaction_forces") | each("contact_force_2", "reaction_forces"),
            {"joint_position_command": lambda t: moved(two_tables())(t)},
            runnable=lambda: build_station(two_tables(), 3),
        )
    ],
}
