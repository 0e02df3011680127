"""Scenario part `!TaskMachine`: modes follow guards on motion, force, grippers and controller; what is refused."""

import itertools
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse
from forcectl.tasks.controllers.task_machine import TaskMachine
from forcectl.testing.runs import Log, run_diagram
from tests.examples.task_machines import LOWER, MODES, config, model, task_machine

TICK = 0.004
RIGHT_FORCE_Z = 11
MET = 0.3  # [s]
STATION = """
station:
  fidelity: Multibody
  robot: yumi
  tool: null
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {}
estimators: {force: !ForceEstimator {}}
"""


def run(duration: float = 0.8, machine: TaskMachine | None = None, **inputs: Any) -> Log:
    def wrench(t: float) -> np.ndarray:
        return 3.0 * (np.arange(12) == RIGHT_FORCE_Z) * (t > MET - TICK / 2)

    def reading(t: float) -> np.ndarray:  # no encoder is frozen
        return model().start + 1e-4 * np.sin(30.0 * t)

    given = {"joint_position": reading, "estimated_wrench": wrench, "gripper_holds": [1.0, 1.0]}
    return run_diagram(machine or task_machine(), duration, period=TICK, inputs=given | inputs)


def way(log: Log) -> list[str]:
    """Names of the modes in their order."""
    numbers = log["mode"][:, 0]
    return [MODES[int(numbers[0])]] + [MODES[int(b)] for a, b in itertools.pairwise(numbers) if a != b]


@pytest.mark.slow
def test_modes_follow_time_force_and_what_the_controller_tells() -> None:
    log = run()
    assert way(log) == ["wait", "lower", "press", "let_go"]
    numbers, z = log["mode"][:, 0], log["task_position"][:, 2]
    begins = {name: log.time[np.argmax(numbers == i)] for i, name in enumerate(MODES[:4])}
    assert begins["lower"] == pytest.approx(0.05, abs=1.5 * TICK)
    assert begins["press"] == pytest.approx(MET, abs=TICK / 2)  # at the tick that the force is felt
    speed = np.diff(z) / TICK
    assert speed[(log.time[1:] > 0.25) & (log.time[1:] < MET)] == pytest.approx(-0.05, abs=1e-6)
    assert z[-1] - z[numbers == 2][0] == pytest.approx(-0.002, abs=5e-4)
    assert log["transition_value"][numbers == 2, 0] == pytest.approx(3.0)
    assert log["machine_end"][-1, 0] == 1.0


@pytest.mark.slow
def test_grippers_keep_what_they_were_told_and_taring_is_told_a_tick_later() -> None:
    log = run()
    numbers = log["mode"][:, 0]
    assert (log["gripper_command"][:, 0] == 1.0).all()
    assert (log["gripper_command"][:, 1] == (numbers < 3)).all()
    assert log["tare"][0, 0] == 0.0
    assert (log["tare"][1:, 0] == (numbers[:-1] == 0)).all()


@pytest.mark.slow
def test_a_coordinate_complies_in_its_mode_only() -> None:
    """2 N along x and as much along y: only x moves, and only while the mode lasts."""
    pushed = 2.0 * ((np.arange(12) == 9) | (np.arange(12) == 10))
    log = run(0.5, estimated_wrench=pushed)
    numbers, (x, y, _) = log["mode"][:, 0], log["task_position"].T[:3]
    lower = numbers == 1
    assert np.abs(x[numbers == 0] - x[0]).max() < 1e-6
    assert x[lower][-1] - x[0] > 1e-3
    assert np.abs(y - y[0]).max() < 1e-5


BAND = """      constraints:
        - !ForceBand
          {task: !ArmTask {arm: right, coordinates: [z]}, force: [0.5, 2.0], stiffness: [1000, 1000], braking: 0.03}
"""


@pytest.mark.slow
def test_a_force_band_reads_the_force_along_its_own_task() -> None:
    """3 N push up, of which 2 are allowed: from the switch on it gives way upwards, as fast as it may brake."""
    text = LOWER.replace("      references: {touch: {z: {by: -0.002}}}\n", BAND)
    text = text.replace("when: reached > 0.5", "when: time > 0.5")
    log = run_diagram(
        task_machine(text),
        0.5,
        period=TICK,
        inputs={
            "joint_position": lambda t: model().start + 1e-4 * np.sin(30.0 * t),
            "estimated_wrench": lambda t: 3.0 * (np.arange(12) == RIGHT_FORCE_Z) * (t > MET - TICK / 2),
            "gripper_holds": [1.0, 1.0],
        },
    )
    press = log["mode"][:, 0] == MODES.index("press")
    assert log["constraint_violation"].max() == 0.0
    robot = model().known_robot()
    heights = [
        robot.parts.arms["right"].tcp_frame.CalcPoseInWorld(robot.context_at(q)).translation()[2]
        for q in log["joint_position_command"][press]
    ]
    speeds = np.diff(heights) / TICK
    assert speeds[0] < -0.03  # it came down
    assert np.diff(speeds)[-10:] / TICK == pytest.approx(0.03, rel=0.05)


@pytest.mark.slow
def test_what_gives_way_on_the_way_to_a_place_has_not_reached_it_at_once() -> None:
    said = "exits: [{when: time > 0.05, to: lower}]\n      timeout: 0.2"
    goes = "references: {touch: {z: {by: -0.03, comply: true}}}\n      exits: [{when: reached > 0.5, to: lower}]"
    assert said in LOWER
    machine = task_machine(LOWER.replace(said, f"{goes}\n      timeout: 0.6"))
    log = run(machine=machine, estimated_wrench=np.zeros(12))
    begun = int(np.flatnonzero(log["mode"][:, 0])[0])
    assert MODES[int(log["mode"][begun, 0])] == "lower"
    assert log["task_position"][begun, 2] - log["task_position"][0, 2] == pytest.approx(-0.03, abs=6e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inputs", "last"),
    [
        ({"gripper_holds": lambda t: [1.0, float(t < 0.15)]}, "lost"),
        ({"estimated_wrench": np.zeros(12)}, "late"),
        ({"estimated_wrench": lambda t: np.full(12, np.nan if t > 0.1 else 0.0)}, "blind"),
    ],
)
def test_what_goes_wrong_ends_in_a_mode_of_its_own(inputs: dict[str, Any], last: str) -> None:
    log = run(0.7, **inputs)
    assert way(log)[-1] == last
    assert log["machine_end"][-1, 0] == 2.0
    ended = log["mode"][:, 0] == MODES.index(last)
    still = np.abs(np.diff(log["joint_position_command"][ended], axis=0))
    assert still[-10:].max() < 1e-4  # the arms come to rest


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (("touch_force.force_z", "touch_force.forcez"), "did you mean 'touch_force.force_z'?"),
        (("touch.speed_z", "tuch.speed_z"), "modes.lower.exits.0.when: unknown signal 'tuch.speed_z'"),
        (("z: {velocity: -0.05}", "phi: {velocity: -0.05}"), "modes.lower.references.touch.phi: unknown coordinate"),
        (
            ("{velocity: -0.05}", "{velocity: -0.05, swing: {frequency: 1, amplitude: 5}}"),
            "swing.amplitude = 5.0: must be at",
        ),
        (
            ("{velocity: -0.05}", "{velocity: -0.05, swing: {frequency: 1, amplitude: 0.01, delay: 90}}"),
            "modes.lower.references.touch.z.swing.delay = 90.0: must be below",
        ),
        (("references: {touch: {z: {by", "references: {tuch: {z: {by"), "modes.press.references.tuch: unknown task"),
        (("    hold: !Arm", "    touch_force: !Arm"), "in guards 'touch_force' is the force on 'touch'"),
        (("    hold: !Arm", "    stalled: !Arm"), "tasks.stalled: must have another name: in guards"),
        (("gripper_holds.right", "gripper_holds.middle"), "unknown signal 'gripper_holds.middle'"),
        (
            ("{left: closed, right: closed}", "{left: closed}"),
            "modes.wait.grippers: must have an entry for every arm: 'right'",
        ),
    ],
)
def test_a_mode_that_does_not_fit_is_told_by_its_key(changed: tuple[str, str], told: str) -> None:
    assert changed[0] in LOWER
    with pytest.raises(BadInputError) as error:
        task_machine(LOWER.replace(*changed))
    assert told in str(error.value)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (("to: press}", "to: pres}"), "controller.modes.lower.exits.0.to: unknown mode 'pres'"),
        (("{arm: left}", "{arm: left, targets: [{value: [0.1]}]}"), "controller.tasks.hold.targets: must be left out"),
        (("timeout: 1.0", "timeout: null"), "controller.modes.press.timeout = None: must be given"),
        (
            ("    hold: !Arm", "    give up: !Arm"),
            "controller.tasks = 'give up': must be named by letters, digits and _",
        ),
        (("    hold: !Arm", "    pass: !Arm"), "controller.tasks = 'pass': must be named by letters, digits and _"),
        (("hold: 0.02", "hold: 0.4"), "controller.modes.lower.exits.1.hold = 0.4: must be below duration = 0.3 s"),
        (("{by: -0.002}", "{by: -0.002, velocity: 0.1}"), "controller.modes.press.references.touch.z.by and velocity"),
    ],
)
def test_a_machine_that_is_none_is_told_by_its_key(changed: tuple[str, str], told: str) -> None:
    assert changed[0] in LOWER
    with pytest.raises(BadInputError) as error:
        config(LOWER.replace(*changed) + "duration: 0.3\n")
    assert told in str(error.value)


def test_what_may_touch_before_an_end_may_touch_in_it() -> None:
    """Else the end would push it out, with a jump; an end that nothing leads to from there keeps it away."""
    pairs = [["left_yumi_gripper", "table"], ["right_yumi_gripper", "table"]]
    text = LOWER
    for name, pair in (("wait", pairs[0]), ("press", pairs[1])):
        text = text.replace(f"    {name}:\n", f"    {name}:\n      touching: [[{', '.join(pair)}]]\n")
    text = text.replace("hold: 0.02, to: lost", "hold: 0.02, to: blind").replace("    lost: {end", "    blind_2: {end")
    text = text.replace("      timeout: 0.5\n      on_timeout: late", "      timeout: 0.5\n      on_timeout: blind_2")
    touching = {name: mode.touching for name, mode in config(text).built_modes().items()}
    assert touching == {
        "wait": pairs[:1],
        "lower": [],
        "press": pairs[1:],
        "let_go": pairs[1:],
        "late": pairs,
        "blind_2": [],
        "blind": pairs,
    }


def test_a_force_that_guards_read_is_estimated() -> None:
    with pytest.raises(BadInputError) as error:
        fc.build(
            parse(STATION.replace("estimators: {force: !ForceEstimator {}}", "estimators: {}") + LOWER, "own.yaml")
        )
    assert "scenario: controller.modes.lower.exits.0.when reads estimated_wrench (estimated wrench of the" in str(
        error.value
    )
    assert str(error.value).endswith("outputs it, such as `estimators: {force: !ForceEstimator {}}`")


def test_the_machine_is_drawn() -> None:
    chart = config().machine()
    assert [mode.name for mode in chart.modes] == list(MODES)
    assert ("press", "let_go", "reached > 0.5") in [(arrow.source, arrow.target, arrow.label) for arrow in chart.arrows]


@pytest.mark.slow
def test_a_run_goes_on_for_as_long_as_asked_after_the_machine_ended() -> None:
    lines = [line for line in LOWER.splitlines() if "gripper_holds" not in line and " lost" not in line]
    scenario = STATION + "\n".join(lines) + "\nduration: 1.2\nafter_end: "

    def log(after_end: str) -> Any:
        done = fc.run(fc.load_scenario(parse(scenario + after_end + "\n", "machine.yaml")))
        assert not [one for one in done.findings["default"] if one.kind.startswith("machine")]
        return done.log

    whole, cut = log("null"), log("0.1")
    ended = float(whole["time"][whole["machine_end"] > 0][0])
    assert float(whole["time"][-1]) == pytest.approx(1.2)
    assert ended < 0.9
    assert float(cut["time"][-1]) == pytest.approx(ended + 0.1, abs=TICK / 2)
    np.testing.assert_array_equal(cut["joint_position"], whole["joint_position"][: cut.sizes["time"]])


@pytest.mark.slow
def test_in_a_loop_it_tares_the_estimator_and_asks_for_what_is_missing() -> None:
    """Without parts in the hands nothing says what the grippers hold; a machine that does not ask runs."""
    with pytest.raises(
        BadInputError, match=r"controller\.modes\.lower\.exits\.1\.when reads gripper_holds .*which no part outputs"
    ):
        fc.build(fc.load_scenario(parse(STATION + LOWER, "machine.yaml")))
    lines = [line for line in LOWER.splitlines() if "gripper_holds" not in line and " lost" not in line]
    done = fc.run(fc.load_scenario(parse(STATION + "\n".join(lines) + "\nduration: 0.2\n", "machine.yaml")))
    log = done.log
    assert done.findings == {"default": []}
    assert log["mode"].attrs["flag_meanings"].split() == [name for name in MODES if name != "lost"]
    tared = np.r_[False, log["mode"].values[:-1] == 0]
    assert (log["estimated_wrench"].values[tared] == 0).all()
    assert (log["estimated_wrench"].values[~tared][-5:] != 0).any()
