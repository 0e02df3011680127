"""What makes no sense of machines, tasks and robots is refused in one line with the key as it is written."""

import pytest

from forcectl.cli.target import parse_settings
from forcectl.errors import BadInputError
from forcectl.scenario.scenario import build

ALIGN = "controller.modes.align"
WALL = "!Wall {point: [0, 0, 5], normal: [0, 0, 1], arm: left}"
NEAR = "jerk = 1e-08: must be enough for speed = 0.075 m/s within 100 s from rest"
MOVES = "controller=!JointMoves {postures: [{posture_deg: [0, 0, 0, 0, 0, 0], start: 5}, {start: 1}]}"
JOINT_9 = "!ReadingFault {joint: joint_9}"
# Experiment; what is set; how the message goes on after the option.
REFUSED = [
    # modes, constraints and tasks by their names and keys
    ("peg_in_hole", f"controller.constraints=[{WALL}]", "controller.constraints.0: is violated in the start posture"),
    (
        "peg_in_hole",
        f"controller.modes.settle.constraints=[{WALL}]",
        "controller.modes.settle.constraints.0: is violated in the start posture, by",
    ),
    ("peg_in_hole", "controller.link_distance=5", "controller.link_distance: is violated in the start posture, by"),
    ("peg_in_hole", f"{ALIGN}.touching=[[a, b]]", f"{ALIGN}.touching.0: unknown shape 'a': known: "),
    ("peg_in_hole", f"{ALIGN}.end=succes", f"{ALIGN}.end: unknown end 'succes': did you mean 'success'? known: '', s"),
    ("peg_in_hole", f"{ALIGN}.on_timeout=''", f"{ALIGN}.on_timeout is missing: must be the mode that begins after the"),
    (
        "peg_in_hole",
        "controller.modes.align.exits=[{when: insert_force.force_z > 5000, to: settle}]",
        "controller.modes.align.exits.0.when = 'insert_force.force_z > 5000' is always false, as the motors hold far ",
    ),
    (
        "peg_in_hole",
        f"{ALIGN}.references={{insert: {{z: {{position: -5.0}}}}}}",
        f"{ALIGN}.references.insert.z.position = -5.0: must be from -",
    ),
    (
        "peg_in_hole",
        f"{ALIGN}.references={{insert: {{phi: {{position: 10}}}}}}",
        f"{ALIGN}.references.insert.phi.position = 10.0: must be from -6.28 to 6.28: no arm gets farther",
    ),
    (
        "pipette",
        "controller.modes.lift_plunger.references={hand: {z: {by: 8}}}",
        "controller.modes.lift_plunger.references.hand.z.by = 8.0: must be at most ",
    ),
    (
        "peg_in_hole",
        f"{ALIGN}.exits=[{{when: insert.z < -81, to: settle}}]",
        f"{ALIGN}.exits.0.when = 'insert.z < -81' is always false, as no arm gets farther: must be able to hold",
    ),
    (
        "peg_in_hole",
        f"{ALIGN}.references.insert.phi={{comply: true, damping_over: {{coordinate: z, at: [-96], factor: [2]}}}}",
        f"{ALIGN}.references.insert.phi.damping_over.at.0 = -96.0: must be from -3.2 to 3.2: no arm gets farther",
    ),
    (
        "peg_in_hole",
        "station.environment.parts.tube.misplaced={offset: 0.003, direction_deg: 36000}",
        "station.environment.parts.tube.misplaced.direction_deg = 36000.0: must be from -360 to 360",
    ),
    (
        "peg_in_hole",
        "controller.tasks.insert.leader_position=[0, 0, 100]",
        "controller.tasks.insert.leader_position.2 = 100.0: must be from -3 to 3",
    ),
    (
        "peg_in_hole",
        "controller.tasks.insert.follower_rotation_deg=[0, 0, 4000]",
        "controller.tasks.insert.follower_rotation_deg.2 = 4000.0: must be from -360 to 360",
    ),
    (
        "peg_in_hole",
        "station.sensors.seat.on=[plunger, plunger]",
        "station.sensors.seat.on.1 = 'plunger': must be another one than those before it",
    ),
    ("peg_in_hole", "controller.longest_gap=100", "controller.longest_gap = 100.0: must be from 0 to 10"),
    (
        "usable_forces",
        "controller.random_moves.start=1000",
        "controller.random_moves.start = 1000.0: must be below duration = 31.5 s",
    ),
    (
        "usable_forces",
        "controller.random_moves.extent=[0, 0, 0]",
        "controller.random_moves.extent = [0.0, 0.0, 0.0]: must be not all zero",
    ),
    (
        "curved_surface",
        "controller.directions.z.law.dead_zone=20",
        "controller.directions.z.law.dead_zone = 20.0: must be below the largest desired force, 15 N",
    ),
    (
        "curved_surface",
        "controller.directions.z.law.integral_gain=2500",
        "controller.directions.z.law.integral_gain = 2500.0: must be below 1000 1/s, two over the control tick of",
    ),
    ("peg_in_hole", "controller.motion_limits.jerk=1e-8", f"controller.motion_limits.{NEAR}"),
    ("peg_in_hole", f"{ALIGN}.motion_limits={{speed: 0.075, jerk: 1e-8}}", f"{ALIGN}.motion_limits.{NEAR}"),
    (
        "peg_in_hole",
        "controller.motion_limits.turn_acceleration=1e-8",
        "controller.motion_limits.turn_acceleration = 1e-08: must be enough for turn_speed = 1.5 rad/s within 100 s",
    ),
    ("peg_in_hole", "controller.tasks.insert.leader=middle", "controller.tasks.insert.leader: unknown arm 'middle': k"),
    (
        "peg_in_hole",
        "controller.tasks.insert.coordinates=[x, q]",
        "controller.tasks.insert.coordinates.1: unknown coordinates 'q': known: x, y",
    ),
    (
        "fig_5_3",
        "controller.targets=[{arm: left, position: [0, 0, 0.5]}, {arm: middle, position: [0, 0, 0]}]",
        "controller.targets.1.arm: unknown arm 'middle': known: left, right",
    ),
    (
        "fig_5_3",
        "controller.targets=[{arm: left, position: [0, 0, 90]}]",
        "controller.targets.0.position = [0.0, 0.0, 90.0]: must be within 10 m or rad of the start",
    ),
    (
        "fig_5_3",
        "controller.targets=[{arm: left, position: [0, 0, 0.5]}, {arm: left, position: [0, 0.1, 0.5]}]",
        "controller.targets.1.time = 0.0: must be another one than that of targets.0, for the same left arm",
    ),
    (
        "fig_5_3",
        "controller.targets=[{arm: left, position: [0.4, 0, 0.3]}, {arm: right, position: [0.4, 0, 0.3]}]",
        "controller.targets.1.position = [0.4, 0.0, 0.3]: must be another place than that of targets.0, of the left a",
    ),
    (
        "fig_5_3",
        "controller={targets: [], tasks: {t: !ArmTask {arm: left}, u: !ArmTask {arm: left}}}",
        "controller.tasks.u is the last of tasks of the left arm with 12 coordinates at priority 1: must be at most t",
    ),
    (
        "fig_5_3",
        "controller={targets: [], tasks: {t: !ArmTask {arm: left, targets: [{value: [1]}, {value: [2]}]}}}",
        "controller.tasks.t.targets.1.time = 0.0: must be another one than that of targets.0",
    ),
    ("fig_3_4_robot", f"controller.constraints=[{WALL}]", "controller.constraints.0.arm: unknown arm 'left': known: a"),
    (
        "fig_3_4_robot",
        "controller.constraints=[!LinkDistance {minimum: 3}]",
        "controller.constraints.0: is violated in the start posture, by",
    ),
    ("fig_3_4", "station.posture_deg=[500, 0, 0, 0, 0, 0]", "station.posture_deg.0 = 500.0: must be from -170 to 170"),
    ("fig_2_7", MOVES, "controller.postures.1.start = 1.0: must be at least 6 s, after the move before"),
    # faster than half the rate of control
    (
        "fig_2_7",
        "controller=!JointMoves {dither: {amplitude_deg: 0.1, frequency: 400}}",
        "controller.dither.frequency = 400.0: must be below 250 Hz, half the rate of control with its tick of 0.002 s",
    ),
    ("fig_5_2", "controller.frequency=70", "controller.frequency = 70.0: must be below 69.44 Hz, half the rate of"),
    # what no motor holds
    (
        "peg_in_hole",
        "model.payload.left.mass=2000",
        "model.payload = {'left': 2000.0, 'right': 0.03}: must be held in the start posture: left_joint_4 needs 255",
    ),
    (
        "fig_2_7",
        "model.payload.arm.mass=2000",
        "model.payload = {'arm': 2000.0}: must be held in the start posture: joint_3 needs 127",
    ),
    (
        "usable_forces",
        "station.loads=[{wrenches: [[0, 0, 0, 0, 0, 2e4]]}]",
        "station.loads.0.wrenches.0 = [0.0, 0.0, 0.0, 0.0, 0.0, 20000.0]: must be held in the start posture: left_jo",
    ),
    (
        "usable_forces",
        "station.loads=[{body: left_link_4, wrenches: [[0, 0, 0, 0, 0, -20], [0, 0, 0, 0, 2000, 0]]}]",
        "station.loads.0.wrenches.1 = [0.0, 0.0, 0.0, 0.0, 2000.0, 0.0]: must be held in the start posture: left_join",
    ),
    (
        "usable_forces",
        "station.loads=[{wrenches: [[0, 0, 0, 0, 0, 1e5]]}]",
        "station.loads.0.wrenches.0.5 = 100000.0: must be from -30000 to 30000",
    ),
    # parts, boxes and faults
    (
        "peg_in_hole",
        "station={environment: {parts: {tube: {arm: left}}}, sensors: {seat: {by: [tube]}}}",
        "station.sensors.seat.by = ['tube']: must be held by another arm than ['plunger']: both are in the left hand",
    ),
    (
        "peg_in_hole",
        "station.environment.parts={seat: !PegInBore {peg: plunger, bore: tube}, tube: {arm: left}}",
        "station.environment.parts.seat.bore = 'tube': must be a part that another arm holds than peg = 'plunger'",
    ),
    (
        "fig_5_3",
        "station.environment.size=[2, 2, 2]",
        "station.environment of size [2.0, 2.0, 2.0] at [0.4, 0.34, 0.1325] has the origin of robot_base of the robot",
    ),
    ("fig_2_8", f"station.faults=[{JOINT_9}]", "station.faults.0.joint: unknown joint 'joint_9': did you mean"),
    ("peg_in_hole", f"station.faults=[{JOINT_9}]", "station.faults.0.joint: unknown joint 'joint_9': did you mean"),
    (
        "fig_2_8",
        "station.faults=[!ReadingFault {start: 0.1, duration: 0.4}, !ReadingFault {start: 0.2, kind: frozen}]",
        "station.faults.1.start = 0.2: must be outside of 0.1 to 0.5 s, where faults.0 changes the readings of the",
    ),
    # what has no effect
    ("fig_5_3", f"controller.constraints=[{WALL}, {WALL}]", "controller.constraints.1 = WallConfig(point=[0.0, 0.0, ."),
    (
        "peg_in_hole",
        f"{ALIGN}.constraints=[{WALL}, {WALL}]",
        f"{ALIGN}.constraints.1 = WallConfig(point=[0.0, 0.0, .",
    ),
    (
        "usable_forces",
        "station.loads=[{wrenches: [[0, 0, 0, 0, 0, 0]]}]",
        "station.loads.0.wrenches = [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]: must be at least 1e-06 somewhere, or",
    ),
    (
        "fig_5_3",
        "estimators={force: !ForceEstimator {limit_share: 1e-9}}",
        "estimators.force.limit_share = 1e-09: must be from 0.01 to 100",
    ),
    # names that analyses look for
    ("peg_in_hole", "analyses.insertion.peg=plungr", "analyses.insertion.peg: unknown part 'plungr': did you mean"),
    ("peg_in_hole", "analyses.insertion.task=7", "analyses.insertion.task = 7: must be at most 2, the number of tasks"),
    ("peg_in_hole", "analyses.insertion.coordinate=12", "analyses.insertion.coordinate = 12: must be at most 11, the"),
    (
        "peg_in_hole",
        "analyses.insertion.on_contact=[align, alig]",
        "analyses.insertion.on_contact.1: unknown mode 'alig': did you mean 'align'? known: settle, approach",
    ),
    ("cap_rotation", "analyses.kept.mode=rotatin", "analyses.kept.mode: unknown mode 'rotatin': did you mean"),
    ("cap_rotation", "analyses.kept.turn=99", "analyses.kept.turn = 99: must be at most"),
    ("pipette", "analyses.levels.cap=tub", "analyses.levels.cap: unknown part 'tub': did you mean 'tube'"),
]  # fmt: skip


def test_what_a_robot_can_hold_is_not_refused():
    settings = ["model.payload.left.mass=0.5", "station.loads=[{wrenches: [[0, 0, 0, 0, 0, 200]]}]"]
    assert build("usable_forces", overrides=parse_settings(settings)).workcell.num_joints == 14


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: f"{case[0]}: {case[1]}")
def test_nonsense_is_refused_by_the_key_that_was_written(case):
    experiment, setting, message = case
    with pytest.raises(BadInputError) as caught:
        build(experiment, overrides=parse_settings([setting]))
    assert str(caught.value).startswith(f"override: {message}")
    assert "\n" not in str(caught.value)
