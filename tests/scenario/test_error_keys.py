"""Errors found while a loop is built name the file and the key of what is wrong."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from forcectl.errors import BadInputError, about, invalid, unknown
from forcectl.runs.run import run
from forcectl.scenario.error_keys import located
from forcectl.scenario.scenario import load_scenario

BAD = """
controller: !Governed
  law: !Integral {integral_gain: 3.0}
  delay: 0.08
duration: 0.1
variants:
  "late": {controller.delay: 0.0031}
  "hasty": {controller.inner_bandwidth: 900.0}
  "excited": {controller.law: !RecursiveVrft {excitation: !ExcitationFile {path: none.csv}}}
  "as it is": {}
"""


@pytest.mark.parametrize(
    ("arguments", "start"),
    [
        # `delay` is a key of the force sensor, too.
        (("--variant", "late"), "bad.yaml:7: variant 'late': controller.delay = 0.0031: must be"),
        (("--variant", "hasty"), "bad.yaml:8: variant 'hasty': controller.inner_bandwidth = 900.0: must be"),
        (("--variant", "as it is", "--set", "reference.force=1e6"), "override: reference.force = 1000000.0: must be"),
        (
            ("--variant", "as it is", "--set", "station.sensors.force.delay=0.0003"),
            "override: station.sensors.force.delay = 0.0003: must be",
        ),
        (("--variant", "excited"), "bad.yaml:9: variant 'excited': controller.law.excitation"),
    ],
)
def test_the_command_line_names_file_and_key(forcectl, tmp_path, arguments, start):
    (tmp_path / "bad.yaml").write_text(BAD)
    code, out, err = forcectl("run", "bad.yaml", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {start}")
    assert err.count("\n") == 1


def test_a_file_is_found_beside_the_scenario_wherever_it_is_named(tmp_path):
    rows = "\n".join(f"{0.002 * k:.3f},{-1e-4 * min(k, 50) / 50}" for k in range(100))
    (tmp_path / "moves.csv").write_text(f"time,displacement\n{rows}\n")
    (tmp_path / "bad.yaml").write_text(BAD.replace("none.csv", "moves.csv"))
    result = run(tmp_path / "bad.yaml", variant="excited")
    assert result.log["controller_output"].values.min() < 0


@dataclass
class Part:
    gain: float = 1.0
    limit: float = 2.0

    def use(self):
        with about(self):
            raise invalid("gain", self.gain, "something else")


@dataclass
class Whole:
    one: Part = field(default_factory=Part)
    other: Part = field(default_factory=Part)
    speed: float = 3.0


def caught(scenario, action):
    with pytest.raises(BadInputError) as error:
        action(scenario)
    found = located(scenario, error.value, lambda key: f"f.yaml, {key or 'nowhere'}")
    return found.key, str(found)


def raised(error):
    raise error


def test_the_part_that_was_at_work_is_named():
    text = "f.yaml, other.gain: other.gain = 1.0: must be something else"
    assert caught(Whole(), lambda w: w.other.use()) == ("other.gain", text)
    assert caught(Whole(), lambda w: w.one.use())[0] == "one.gain"


def test_a_part_within_another_comes_first_and_only_where_it_has_such_a_key():
    def use(whole, key):
        with about(whole.other), about(whole.one):
            raise invalid(key, 1, "2")

    whole = Whole(one=Part(), other=Whole())
    assert caught(whole, lambda w: use(w, "gain"))[0] == "one.gain"
    assert caught(whole, lambda w: use(w, "speed"))[0] == "other.speed"


def test_what_is_no_key_is_told_beside_the_part():
    def use(whole):
        with about(whole.one):
            raise invalid("Block.width", 1, "2")

    assert caught(Whole(), use) == ("one", "f.yaml, one: one: Block.width = 1: must be 2")


def test_a_key_written_in_full_is_left_as_it_is():
    error = invalid("one.limit", 2, "3")
    assert caught(Whole(), lambda w: raised(error)) == ("one.limit", "f.yaml, one.limit: one.limit = 2: must be 3")


def test_what_is_about_no_key_keeps_its_text():
    error = BadInputError("the parts do not fit")
    assert caught(Whole(), lambda w: raised(error)) == ("", "f.yaml, nowhere: the parts do not fit")
    error = invalid("gain", 1, "2")
    assert caught(Whole(), lambda w: raised(error)) == ("", "f.yaml, nowhere: gain = 1: must be 2")


def test_a_name_that_only_one_part_has_is_enough():
    @dataclass
    class Two:
        one: Part = field(default_factory=Part)
        other: Whole = field(default_factory=Whole)

    error = invalid("speed", 3, "4")
    key, text = caught(Two(), lambda w: raised(error))
    assert (key, text) == ("other.speed", "f.yaml, other.speed: other.speed = 3: must be 4")


def test_a_name_of_the_wrong_kind_is_about_the_key_of_that_kind():
    @dataclass
    class Robot:
        stiffness_set: str = "a"

    @dataclass
    class Cell:
        robot: Robot = field(default_factory=Robot)

    key, text = caught(Cell(), lambda w: raised(unknown("stiffness set", "b", ["a"])))
    assert key == "robot.stiffness_set"
    assert text == "f.yaml, robot.stiffness_set: robot.stiffness_set: unknown stiffness set 'b': known: a"


LAWS = """
from dataclasses import dataclass

@dataclass
class One:
    gain: float = 1.0
    def add_to(self, builder, model): ...

@dataclass
class Two:
    gain: float
    def add_to(self, builder, model): ...
"""


def test_a_key_that_a_part_lacks_is_not_looked_for_in_the_part_it_replaces(tmp_path):
    (tmp_path / "of_the_test_laws.py").write_text(LAWS)
    (tmp_path / "bad.yaml").write_text(
        "controller: !Import {path: of_the_test_laws:One, parameters: {gain: 1.0}}\n"
        "variants:\n"
        "  other: {controller: !Import {path: of_the_test_laws:Two}}\n"
        "  same: {controller.parameters.gain: high}\n"
    )
    missing = r"bad\.yaml:3: variant 'other': controller\.parameters\.gain is missing: must be a number"
    with pytest.raises(BadInputError, match=missing):
        load_scenario(tmp_path / "bad.yaml", "other")
    with pytest.raises(BadInputError, match=r"bad\.yaml:4: variant 'same': controller\.parameters\.gain = 'high'"):
        load_scenario(tmp_path / "bad.yaml", "same")
