"""What a machine must be: each mistake is one line that names the key."""

from dataclasses import replace

import pytest

from forcectl.errors import BadInputError
from forcectl.tasks.machine.chart import ChartArrow
from forcectl.tasks.machine.modes import ExitConfig, MachineModeConfig, check_modes, machine_chart
from forcectl.tasks.machine.state_machine import StateMachine
from tests.examples.machines import PEG_SIGNALS, cap, end, exit_to, mode, peg


def changed(name, **changes):
    return lambda modes: modes | {name: replace(modes[name], **changes)}


def without(*names):
    return lambda modes: {name: mode for name, mode in modes.items() if name not in names}


def stopping(**changes):
    """The first exit of that mode, changed."""
    first, second = peg()["stopping"].exits
    return changed("stopping", exits=[replace(first, **changes), second])


BAD = {
    "no such target": (stopping(to="complaint"), "modes.stopping.exits.0.to: unknown mode 'complaint': did you mean "),
    "no such mode at a timeout": (changed("stopping", on_timeout="stick"), "modes.stopping.on_timeout: unknown mode"),
    "no mode at a timeout": (changed("stopping", on_timeout=""), "modes.stopping.on_timeout is missing: must be the "),
    "back to itself": (stopping(to="stopping"), "modes.stopping.exits.0.to = 'stopping': must be another mode"),
    "times out to itself": (changed("stopping", on_timeout="stopping"), "modes.stopping.on_timeout = 'stopping'"),
    "not reached": (lambda modes: modes | {"idle": mode(on_timeout="stuck")}, "modes.idle: cannot be reached from"),
    "dead end": (changed("stopping", exits=[], timeout=None, on_timeout=""), "modes.stopping is a dead end"),
    "no timeout": (changed("stopping", timeout=None), "modes.stopping.timeout = None: must be given"),
    "an end with exits": (changed("stuck", exits=[exit_to("missed", "time > 1")]), "modes.stuck.exits = "),
    "an end with a timeout": (changed("stuck", timeout=1.0), "modes.stuck.timeout = 1.0: must be left out"),
    "no reason": (changed("stuck", reason=" "), "modes.stuck.reason = ' ': must be given in words in a failure"),
    "a reason of no failure": (changed("inserted", reason="why"), "modes.inserted.reason = 'why': must be left out"),
    "a guard that holds too long": (stopping(hold=1.0), "modes.stopping.exits.0.hold = 1.0: must be below the timeout"),
    "a guard twice": (
        lambda modes: changed("stopping", exits=[modes["stopping"].exits[0]] * 2)(modes),
        "modes.stopping.exits.1.when = 'abs(touch.force_z) < 0.5': must be another guard than that of 0",
    ),
    "no success": (changed("inserted", end="failure", reason="why"), "modes: one of them must have end: success"),
    "a ring of timeouts": (
        lambda modes: without("no_contact")(
            changed("stopping", on_timeout="compliant")(changed("compliant", on_timeout="stopping")(modes))
        ),
        "modes.stopping.on_timeout = 'compliant': must lead to an end by timeouts alone, "
        "not in a loop through compliant, stop",
    ),
    "visits of a mode that begins once": (
        changed("approach", exits=[exit_to("compliant", "insert.z < 0.002 and visits > 3")]),
        "modes.approach.exits.0.when = 'insert.z < 0.002 and visits > 3': 'visits > 3' is always false, as nothing le",
    ),
    "a success that is one anyway": (
        changed("opening", on_timeout="inserted"),
        "modes.opening.on_timeout = 'inserted': must be another than the success that a guard leads to",
    ),
    "a success that other modes lead to, too": (
        lambda modes: without("no_contact")(changed("compliant", on_timeout="inserted")(modes)),
        "modes.compliant.on_timeout = 'inserted': must be another than the success that a guard leads to",
    ),
    "a success of time alone": (
        lambda modes: without("missed")(
            changed("approach", on_timeout="resting")(modes) | {"resting": mode(on_timeout="inserted")}
        ),
        "modes.resting.on_timeout = 'inserted': must be a failure: timeouts alone lead there from the start",
    ),
    "a gripper ajar": (changed("opening", grippers={"right": "ajar"}), "modes.opening.grippers.right = 'ajar'"),
    "a name with a blank": (lambda modes: modes | {"hold on": end("success")}, "modes = 'hold on': must be named by"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_machine_is_refused_with_the_key(case):
    change, message = BAD[case]
    with pytest.raises(BadInputError) as error:
        check_modes(change(peg()), "approach")
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["start", "on_bad_signal"])
def test_a_mode_that_the_machine_does_not_have(key):
    with pytest.raises(BadInputError, match=f"^{key}: unknown mode 'aproach': did you mean 'approach'"):
        check_modes(peg(), **{"start": "approach", key: "aproach"})


def test_what_is_watched_in_every_mode_is_an_exit_of_each_and_a_note_in_the_picture():
    watched = [exit_to("too_hard", "abs(touch.force_z) > 20", 0.01)]
    modes = peg() | {"too_hard": end("failure", "the force was too large")}
    with pytest.raises(BadInputError, match=r"^modes\.too_hard: cannot be reached"):
        check_modes(modes, "approach")
    chart = machine_chart("peg", modes, "approach", always=watched)
    (drawn,) = [mode for mode in chart.modes if mode.name == "too_hard"]
    assert "from any mode: abs(touch.force_z) > 20 for 0.01 s" in drawn.notes
    with pytest.raises(BadInputError, match=r"^always\.0\.to: unknown mode 'to_hard': did you mean 'too_hard'"):
        check_modes(modes, "approach", always=[exit_to("to_hard", "time > 1")])
    with pytest.raises(BadInputError, match=r"^always\.0\.when: unknown signal 'touch.forcez'"):
        StateMachine(modes, start="approach", signals=PEG_SIGNALS, always=[exit_to("too_hard", "touch.forcez > 1")])


def test_a_machine_that_is_one_is_not_refused():
    """Rings of guards are allowed, and timeouts that lead back where others lead on."""
    check_modes(peg(), "approach")
    check_modes(changed("stopping", on_timeout="approach")(peg()), "approach")


def test_a_success_needs_something_that_happens():
    with pytest.raises(BadInputError, match=r"^modes\.inserted is the start mode: must not be an end"):
        check_modes({"inserted": end("success")}, "inserted")
    modes = {"rest": mode(on_timeout="done"), "done": end("success")}
    with pytest.raises(
        BadInputError, match=r"^modes: one of them must have exits: without them no signal has an effect"
    ):
        check_modes(modes, "rest")
    with pytest.raises(
        BadInputError, match=r"^modes\.rest\.on_timeout = 'done': must be a failure: timeouts alone lead"
    ):
        check_modes(modes | {"bad": end("failure", "x")}, "rest", always=[exit_to("bad", "x > 1")])
    holding = mode(exit_to("stopping", "touch.force_z < 1"), on_timeout="inserted")
    stopping = mode(exit_to("opening", "touch.force_z > 1"), on_timeout="stuck")
    check_modes(peg() | {"opening": holding, "stopping": stopping}, "approach")  # the guard leads back only


@pytest.mark.parametrize("modes", [cap(), cap() | {"no_reading": mode(on_timeout="locked")}])
def test_missing_signals_are_no_success(modes):
    name = "no_reading" if modes["no_reading"].timeout else "locked"
    modes = modes if name == "no_reading" else without("no_reading")(modes)
    with pytest.raises(BadInputError, match=f"^on_bad_signal = '{name}': must be a failure, or a mode whose"):
        check_modes(modes, "approach", name)


def test_visits_are_counted_where_something_leads_back():
    again = exit_to("stuck", "visits > 3")
    with pytest.raises(BadInputError, match=r"^always\.0\.when = 'visits > 3' is always false, as nothing leads back"):
        check_modes(cap(), "approach", "no_reading", [replace(again, to="failed")])
    check_modes(peg(), "approach", always=[again])
    modes = changed("approach", exits=[exit_to("compliant", "insert.z < 0.002"), again])(peg())
    check_modes(changed("stopping", on_timeout="approach")(modes), "approach")
    check_modes(changed("opening", exits=[], on_timeout="inserted")(peg()), "approach")  # as long as the timeout


def test_the_mode_of_bad_signals_is_reached_without_an_exit():
    check_modes(cap(), "approach", "no_reading")
    with pytest.raises(BadInputError, match=r"^modes.no_reading: cannot be reached from 'approach'"):
        check_modes(cap(), "approach")


GUARDS = {
    "abs(touch.force_z) > time": " = .*'abs.touch.force_z.' in N and 'time' in s: must be of the same unit",
    "touch.forcez > 1": "unknown signal 'touch.forcez': did you mean 'touch.force_z'. known: touch.force_x, ",
    "tuch > 1": "unknown signal 'tuch'",
    "touch > 1": "unknown signal 'touch'",
    "touch.force_z == 'high'": ".*must be a condition on signals and numbers, without texts",
    "open(touch.force_z)": ".*cannot stand here",
    "touch.force_z": r".*must be a comparison of a name, such as time > 0\.5$",
    "touch.force_z >": r".*must be an expression such as time > 0\.5 and abs\(touch\.force_z\) > 1$",
    "1 > 0": ".*must be a comparison of a name",
    "1 / 0 > time": ".*'1 / 0' must be a number",
    "9 ** 9 ** 9 ** 9 > time": ".*must be a number",
    "time > 3 and time < 2": ".*true for no time: must be possible",
    "abs(touch.force_z) < 0": r".*true for no abs\(touch.force_z\): must be",
    "reached > 5": ".*reached is 0 or 1: must be able to hold",
    "time < 0": ".*must be true before the timeout, 1 s",
    "touch.force_z > 1 and time >= 5": ".*must be true before the timeout, 1 s",
    "time > -1": ".*time > -1' is always true: must be able to be false, such as time > 0 for a transition at once",
    "time >= 0": ".*is always true",
    "abs(touch.force_z) > -1": ".*is always true",
    "elapsed > 0": ".*is always true",
    "visits > 0.5": ".*is always true",
    "time > 0.5 and abs(touch.force_z) > -1": ".*: 'abs\\(touch.force_z\\) > -1' is always true",
    "not (max(visits, time) > 0)": ".*: 'max\\(visits, time\\) > 0' is always true",
    "touch.force_z > 1 or gripper_holds.left < -0.5": ".*: 'gripper_holds.left < -0.5' is always false: must be able",
    "touch.force_z / 0 > 2": ".*'touch.force_z / 0' has no value",
    "touch.force_z - touch.force_z > 1": ".*is always false",
    "reached == 0.5": ".*reached is 0 or 1: must be able to hold",
    "touch.force_z > 2 or touch.force_z < 3": ".*: true for every touch.force_z: must not be",
    "time > 0.501 and time < 0.503": ".*must be true at a tick, every 0.004 s",
    "holding > 2": ".*holding is 0 or 1: must be able to hold",
    "reached <= 1": ".*is always true",
    "time < 0.5": ".*is true from the first tick on: must be false there",
    "time > 0.5 or time < 2": ".*: true for every time: must not be",
}


@pytest.mark.parametrize("guard", GUARDS)
def test_a_bad_guard_is_refused_with_the_key(guard):
    with pytest.raises(BadInputError, match=r"^modes\.stopping\.exits\.0\.when:? ?" + GUARDS[guard]) as error:
        StateMachine(stopping(when=guard)(peg()), start="approach", signals=PEG_SIGNALS, arms=("left", "right"))
    assert "\n" not in str(error.value)


GOOD_GUARDS = [
    "time > 0",
    "visits > 1",
    "visits < 2",
    "elapsed < 12",
    "time > 0.2 + 0.1 * visits",
    "time < 0.5 and abs(touch.force_z) < 1",
    "not (touch.force_z > 0)",
    "touch.force_z > 3 or touch.force_z < 2",
    "touch.force_x / (1 + time) > 2",
    "2 / touch.force_z > 1 or touch.force_z ** 2 > -1 - touch.force_x",
]


@pytest.mark.parametrize("guard", GOOD_GUARDS)
def test_a_guard_that_depends_on_something_is_not_refused(guard):
    StateMachine(stopping(when=guard)(peg()), start="approach", signals=PEG_SIGNALS, arms=("left", "right"))


@pytest.mark.parametrize("guard", ["elapsed < 12", "time < 0.5", "visits < 2"])
def test_what_is_watched_in_every_mode_is_false_at_the_start(guard):
    with pytest.raises(
        BadInputError, match=r"^always\.0\.when = .* is true from the first tick on: must be false there"
    ):
        check_modes(peg(), "approach", always=[exit_to("stuck", guard)])
    check_modes(peg(), "approach", always=[exit_to("stuck", f"{guard} and touch.force_z > 3")])


@pytest.mark.parametrize(
    ("first", "second", "covered"),
    [
        ("touch.force_z > 2", "touch.force_z > 3", True),
        ("touch.force_z > 2", "2 < touch.force_z", True),
        ("touch.force_z > 2", "touch.force_z > 4 and time > 0.3", True),
        ("touch.force_z > 2", "touch.force_z > 1", False),
        ("touch.force_z > 2 and time > 0.3", "touch.force_z > 3", False),
        ("touch.force_z > 2", "touch.force_x > 3", False),
        ("touch.force_z > 2 or time > 0.3", "touch.force_z > 3", False),
        ("touch.force_z != 2", "touch.force_z > 3", False),
    ],
)
def test_a_guard_that_one_before_it_covers_is_refused(first, second, covered):
    modes = changed("stopping", exits=[exit_to("compliant", first), exit_to("opening", second)])(peg())
    if not covered:
        check_modes(modes, "approach")
        return
    with pytest.raises(
        BadInputError,
        match=r"^modes\.stopping\.exits\.1\.when = .*another guard than that of 0, which is checked first",
    ):
        check_modes(modes, "approach")
    modes["stopping"].exits[0].hold = 0.1  # the second one may be sooner
    check_modes(modes, "approach")


def test_a_timeout_lasts_a_tick():
    quick = changed("stopping", timeout=0.001)(peg())
    with pytest.raises(BadInputError, match=r"^modes\.stopping\.timeout = 0\.001: must be at least a tick, 0\.004 s"):
        StateMachine(quick, start="approach", signals=PEG_SIGNALS, arms=("left", "right"))


def test_what_is_watched_in_every_mode_can_hold_before_the_timeouts():
    once = changed("stopping", exits=peg()["stopping"].exits[1:])(peg())
    together = sum(mode.timeout or 0.0 for mode in once.values())
    message = rf"^always\.0\.hold = {together}: must be below the sum of all timeouts, {together:g} s"
    with pytest.raises(BadInputError, match=message):
        check_modes(once, "approach", always=[exit_to("stuck", "touch.force_z > 3", together)])
    check_modes(once, "approach", always=[exit_to("stuck", "touch.force_z > 3", together - 1.0)])
    check_modes(peg(), "approach", always=[exit_to("stuck", "touch.force_z > 3", 99.0)])  # to and fro
    message = r"^always\.0\.when = 'time > 6': must be true within the longest timeout of a mode, 5 s; the time since"
    with pytest.raises(BadInputError, match=message):
        check_modes(peg(), "approach", always=[exit_to("stuck", "time > 6")])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("opening", grippers={"rigth": "open"}), "modes.opening.grippers: unknown arm 'rigth': did you mean"),
        (
            changed("approach", grippers={"left": "open"}),
            "modes.approach.grippers: must have an entry for every arm: 'right' is",
        ),
    ],
)
def test_a_bad_gripper_is_refused(change, message):
    with pytest.raises(BadInputError, match=f"^{message}"):
        StateMachine(change(peg()), start="approach", signals=PEG_SIGNALS, arms=("left", "right"))


@pytest.mark.parametrize("name", ["time", "visits"])
def test_a_signal_with_a_name_that_has_a_meaning_is_refused(name):
    with pytest.raises(BadInputError, match=f"^signals: '{name}' is reserved: must be another name"):
        StateMachine(peg(), start="approach", signals=PEG_SIGNALS | {name: ("x",)}, arms=("left", "right"))


def test_a_number_out_of_bounds_is_refused():
    with pytest.raises(BadInputError, match=r"^hold = -0.1: must be not negative"):
        ExitConfig(when="time > 1", to="stuck", hold=-0.1)
    with pytest.raises(BadInputError, match=r"^end: unknown end 'win': .* success, failure"):
        MachineModeConfig(end="win")


def test_the_chart_of_a_machine():
    chart = machine_chart("cap", cap(), "approach", "no_reading")
    notes = {mode.name: mode.notes for mode in chart.modes}
    assert list(notes) == list(cap())
    assert notes["rotation"] == ("at most 20 s",)
    assert notes["no_reading"] == ("no force was estimated", "from any mode after 0.05 s without a signal")
    rotation = [arrow for arrow in chart.arrows if arrow.source == "rotation"]
    assert rotation == [
        ChartArrow("rotation", "stopping", "abs(touch.torque_z) > 0.08 for 0.04 s"),
        ChartArrow("rotation", "failed", "timeout"),
    ]
    assert {mode.name: mode.end for mode in chart.modes if mode.end} == {
        "locked": "success", "failed": "failure", "no_reading": "failure"
    }  # fmt: skip


def exits_set(**changes):
    """The first exit of a mode, changed after it was made."""

    def change(modes):
        for name, value in changes.items():
            setattr(modes["stopping"].exits[0], name, value)
        return modes

    return change


def late(name, value):
    def change(modes):
        setattr(modes["stopping"], name, value)
        return modes

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda modes: [*modes.values()], r"modes = .*: must be modes by name"),
        (lambda modes: modes | {"stuck": None}, r"modes\.stuck = None: must be a MachineModeConfig"),
        (lambda modes: modes | {"stuck": {"end": "failure"}}, r"modes\.stuck = .*: must be a MachineModeConfig"),
        (late("timeout", "5"), r"modes\.stopping\.timeout = '5': must be a finite number"),
        (late("timeout", True), r"modes\.stopping\.timeout = True: must be a finite number"),
        (exits_set(hold=float("nan")), r"modes\.stopping\.exits\.0\.hold = nan: must be"),
        (late("exits", [{"when": "time > 1", "to": "compliant"}]), r"modes\.stopping\.exits"),
    ],
)
def test_what_is_no_mode_is_refused(change, message):
    with pytest.raises(BadInputError, match=f"^{message}") as error:
        check_modes(change(peg()), "approach")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({"touch": "force_z"}, r"signals\.touch = 'force_z': must be a list of one name or more"),
        ({"touch": ()}, r"signals\.touch = \(\): must be a list of one name or more"),
        ({"touch": ("force_z", "force_z")}, r"signals\.touch\.1 = 'force_z': must be another one"),
        ({"a b": ("x",)}, r"signals = 'a b': must be named by letters"),
    ],
)
def test_what_is_no_signal_is_refused(signals, message):
    with pytest.raises(BadInputError, match=f"^{message}"):
        StateMachine(peg(), start="approach", signals=PEG_SIGNALS | signals, arms=("left", "right"))
