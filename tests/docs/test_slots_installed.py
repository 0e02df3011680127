"""The parts of docs/slots.md and a Hunt-Crossley surface as an installed package: short tags for the command line."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from forcectl.scenario.catalog import CONTRACTS
from tests.examples.commands import run_command
from tests.examples.pages import blocks, page_text

ROOT = Path(__file__).parents[2]
PAGE = page_text("slots.md")

HUNT_CROSSLEY = '''
"""F = k d^1.5 (1 + c d'), with d' from sample to sample."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import LeafSystem


class Contact(LeafSystem):
    def __init__(self, k, c, period):
        super().__init__()
        self.k, self.c, self.period = k, c, period
        self.u = self.DeclareVectorInputPort("displacement", 1)
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.keep)
        reads = {self.u.ticket(), self.xd_ticket()}
        self.DeclareVectorOutputPort("contact_force", 1, self.calc, prerequisites_of_calc=reads)

    def depth(self, context):
        return max(-self.u.Eval(context)[0], 0.0)

    def keep(self, context, state):
        state.set_value([self.depth(context)])

    def calc(self, context, output):
        d = self.depth(context)
        rate = (d - context.get_discrete_state_vector()[0]) / self.period
        output.SetAtIndex(0, max(self.k * d**1.5 * (1 + self.c * rate), 0.0))


@dataclass
class HuntCrossley:
    stiffness: float = 2.0e6
    damping: float = 0.5
    first_stiffness = 2.0e4

    def add_to(self, builder, size, period, *, robot_compliance):
        return builder.AddNamedSystem("hunt_crossley", Contact(self.stiffness, self.damping, period))
'''
# slot -> tag -> where it is in the package; every slot that the page fills.
ANNOUNCED = {
    "fidelity": {"Sketch": "my_parts:Sketch"},
    "environment": {"Hertz": "my_parts:HertzSurface", "HuntCrossley": "hunt_crossley:HuntCrossley"},
    "surface": {"Bump": "my_parts:Bump"},
    "drive": {"Lagging": "my_parts:LaggingDrive"},
    "sensor": {"Drifting": "my_parts:DriftingSensor"},
    "controller": {"Creep": "my_parts:Creep"},
    "reference": {"Constant": "my_parts:Constant"},
    "estimator": {"TorqueImpulse": "my_parts:TorqueImpulse"},
    "analysis": {"Peak": "my_parts:Peak"},
    "task": {"Height": "my_parts:Height"},
    "constraint": {"Cylinder": "my_parts:Cylinder"},
    "potential": {"JointTo": "my_parts:JointTo"},
    "null_space": {"Homewards": "my_parts:Homewards"},
    "load": {"Push": "my_parts:Push"},
    "fault": {"DeadEncoder": "my_parts:DeadEncoder"},
    "motion": {"Wiggle": "my_parts:Wiggle"},
    "signal": {"Share": "my_parts:Share"},
    "excitation": {"Humming": "my_parts:Humming"},
}
PRESS = """
station:
  fidelity: !Sketch {}
  environment: !HuntCrossley {stiffness: 1.5e6}
  drive: !Lagging {bandwidth: 50.0}
  sensors: {force: !Drifting {drift: 0.3}}
controller: !Creep {gain: 0.6}
reference: !Constant {force: 6.0}
analyses: {peak: !Peak {}}
duration: 0.5
"""
REACH = """
preset: ideal
station: {robot: yumi, tool: null, fidelity: Multibody, time_step: 0.002,
          drive: !JointInterface {}, sensors: {joints: !JointReadings {}}, environment: !Parts {},
          loads: [!Push {newton: 3.0}], faults: [!DeadEncoder {joint: left_joint_3, start: 0.2}]}
estimators: {impulse: !TorqueImpulse {}}
controller: !ReactiveReaching
  tasks: {lift: !Height {arm: left, to: 0.3}}
  constraints: [!Cylinder {axis: [0.0, 0.0], radius: 0.6}]
  null_space: !Evasive {potentials: [!JointTo {joint: 4, angle: 0.2}]}
duration: 0.3
"""
SLIDE = """
station: {environment: !Surface {surface: {heights: {bump: !Bump {at: 0.005}}}}}
motion: !Wiggle {joint: 5}
signals: {measured_force: !Share {factor: 0.9}}
duration: 0.5
"""
TUNE = "{controller: !RecursiveVrft {excitation: !Humming {depth: 2.0e-3}}, duration: 0.2}"
HOME = """
preset: ideal
station: {robot: yumi, tool: null, fidelity: Multibody, time_step: 0.002,
          drive: !JointInterface {}, sensors: {joints: !JointReadings {}}, environment: !Parts {}}
controller: !ReactiveReaching {null_space: !Homewards {gain: 2.0}}
duration: 0.1
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package installed by pip, from nothing but its own files."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    code = "\n\n".join(blocks(PAGE, "python"))
    (source / "my_parts.py").write_text(code, encoding="utf-8")
    (source / "hunt_crossley.py").write_text(HUNT_CROSSLEY, encoding="utf-8")
    points = [
        f'[project.entry-points."forcectl.{slot}"]\n' + "".join(f'{tag} = "{path}"\n' for tag, path in tags.items())
        for slot, tags in ANNOUNCED.items()
    ]
    (source / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n'
        '[project]\nname = "laboratory"\nversion = "1.0"\n'
        '[tool.setuptools]\npy-modules = ["my_parts", "hunt_crossley"]\n' + "".join(points),
        encoding="utf-8",
    )
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--target", str(target)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(source)], check=True, capture_output=True)
    return target


def command(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command of a user who has installed both packages, from another directory."""
    return run_command(arguments, folder, os.environ | {"COLUMNS": "200"}, paths=[str(site)])


def test_the_page_and_the_package_fill_the_slots() -> None:
    assert set(ANNOUNCED) == set(CONTRACTS)


@pytest.mark.parametrize(
    ("scenario", "has"),
    [
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((PRESS, "figure"), (REACH, ""), (SLIDE, ""))),
        (TUNE, ""),
        (HOME, ""),
    ],
)
def test_tags_of_an_installed_package_run(site: Path, tmp_path: Path, scenario: str, has: str) -> None:
    (tmp_path / "workcell.yaml").write_text(scenario)
    done = command(site, tmp_path, "run", "workcell.yaml", "--out", "result")
    assert done.returncode == 0, done.stderr[-2000:]
    written = (tmp_path / "result" / "scenario.yaml").read_text()
    tags = re.findall(r"!(\w+)", scenario)
    assert [tag for tag in tags if f"!{tag}" not in written] == []
    assert "!Import" not in written
    if has == "figure":
        (metrics,) = json.loads((tmp_path / "result" / "metrics.json").read_text()).values()
        assert metrics["my_peak_N"] > 1.0
        assert (tmp_path / "result" / "figures" / "my_figure.png").exists()


def announce(folder: Path, name: str, entry_points: str) -> None:
    """An installed package in a folder that announces these entry points."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)


@pytest.mark.slow
def test_they_are_listed_and_missed_by_name(site: Path, tmp_path: Path) -> None:
    listed = command(site, tmp_path, "list").stdout
    assert [tag for tags in ANNOUNCED.values() for tag in tags if tag not in listed] == []
    (tmp_path / "workcell.yaml").write_text("station: {environment: !HuntCrosley {}}\n")
    missed = command(site, tmp_path, "run", "workcell.yaml")
    assert missed.returncode != 0
    assert "station.environment: unknown tag '!HuntCrosley': did you mean '!HuntCrossley'?" in missed.stderr
    assert len(missed.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_package_that_announces_what_does_not_fit_is_told_in_one_line(site: Path, tmp_path: Path) -> None:
    """A tag that leads to a class of another slot, and one that leads nowhere."""
    announce(
        tmp_path,
        "broken",
        "[forcectl.reference]\nPeak = my_parts:Peak\nGone = my_parts:Gone\n[forcectl.drive]\nPeak = my_parts:Peak\n",
    )
    for text, told in (
        (
            "reference: !Peak {}",
            "reference = 'my_parts:Peak': must be a class that fills the slot reference, with add_to",
        ),
        ("reference: !Gone {}", "reference: 'my_parts:Gone' cannot be imported"),
        (
            "station: {drive: !Peak {}}",
            "station.drive = 'my_parts:Peak': must be a class that fills the slot drive, with add_to",
        ),
    ):
        (tmp_path / "workcell.yaml").write_text(f"{text}\nduration: 0.1\n")
        done = command(site, tmp_path, "run", "workcell.yaml")
        assert done.returncode != 0
        assert told in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr


@pytest.mark.slow
def test_what_a_package_announces_in_vain_is_told_and_the_rest_is_used(site: Path, tmp_path: Path) -> None:
    announce(
        tmp_path,
        "vain",
        "[forcectl.controller]\nIntegral = my_parts:Creep\nWeird Name = my_parts:Creep\nNowhere = my_parts:Nope\n"
        "[forcectl.sensors]\nDrifting = my_parts:DriftingSensor\n",
    )
    told = [
        "passed over: forcectl.controller: Integral = my_parts:Creep: !Integral is forcectl's own: must have",
        "passed over: forcectl.controller: Weird Name = my_parts:Creep: a tag must be letters, digits, and _ . -",
        "passed over: forcectl.sensors: Drifting = my_parts:DriftingSensor: unknown group 'forcectl.sensors': did you "
        "mean 'forcectl.sensor'? known: forcectl.controller, forcectl.reference, ",
        "passed over: slot controller, !Nowhere: 'my_parts:Nope' cannot be imported",
    ]
    for arguments, count in ((("list",), 3), (("check", "fig_2_7"), 3), (("schema",), 4)):
        done = command(site, tmp_path, *arguments)
        assert done.returncode == 0, done.stderr
        lines = done.stderr.strip().splitlines()
        assert len(lines) == count, done.stderr
        for line, begin in zip(lines, told, strict=False):
            assert line.startswith(begin)
    shown = json.loads(done.stdout)["$defs"]
    assert "controller !Creep" in shown
    assert "controller !Nowhere" not in shown


@pytest.mark.slow
def test_a_tag_that_two_packages_announce_is_none(site: Path, tmp_path: Path) -> None:
    announce(tmp_path, "one", "[forcectl.controller]\nTwice = my_parts:Creep\nSame = my_parts:Creep\n")
    announce(tmp_path, "two", "[forcectl.controller]\nTwice = my_parts:Peak\nSame = my_parts:Creep\n")
    done = command(site, tmp_path, "list", "controllers")
    assert "!Same" in done.stdout
    assert "!Twice" not in done.stdout
    words = "Twice = my_parts:Creep: announced as my_parts:Creep and my_parts:Peak: must be one, or named by `!Import`"
    assert words in command(site, tmp_path, "list").stderr
    (tmp_path / "workcell.yaml").write_text("controller: !Twice {}\n")
    assert "unknown tag '!Twice'" in command(site, tmp_path, "check", "workcell.yaml").stderr


@pytest.mark.slow
def test_the_page_and_the_list_name_the_groups(site: Path, tmp_path: Path) -> None:
    words = " ".join(command(site, tmp_path, "list").stdout.split())
    assert words.endswith(f"of the groups {', '.join(f'forcectl.{slot}' for slot in CONTRACTS)}.")
    named = PAGE.partition("The groups are")[2].partition(";")[0]
    assert re.findall(r"`(\w+)`", named) == list(CONTRACTS)
