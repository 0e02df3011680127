"""Every command that the help texts, README and the pages print is run, and does what it is for, by its output.

In this process, as printed. What would take minutes is shortened, see `Step.also` and `short_sweep`; simulations are
shared with the tests of the session.
"""

import ast
import json
import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.docs.commands.printed import ROOT, helps, printed, write_files
from tests.docs.commands.stories import ELSEWHERE, STORIES, Step, Story
from tests.examples.pages import page_text

STEPS = [step for story in STORIES.values() for step in story.steps]


def test_every_command_has_an_example():
    names = [name for name in helps() if name]
    assert {"run", "sweep", "merge", "faults", "tune", "tune vrft"} <= set(names)
    examples = {name: example for example, places in printed().items() for name in places}
    for name in names:
        assert examples[f"forcectl {name} --help"].startswith(f"forcectl {name} ")


def test_every_printed_command_is_in_a_story_and_none_is_made_up():
    stories = {step.command for step in STEPS}
    unknown = {command: places for command, places in printed().items() if command not in stories | set(ELSEWHERE)}
    assert unknown == {}
    # Shards 2, 3 and 4 are what the page says "elsewhere" of.
    assert [command for command in stories - set(printed()) if "--shard" not in command] == []


def test_what_is_shortened_has_a_reason_and_every_command_shows_something():
    for step in STEPS:
        assert bool(step.also) == bool(step.reason)
        assert step.shows or step.check or step.says


@pytest.mark.parametrize(("file", "test"), ELSEWHERE.values())
def test_what_runs_elsewhere_is_there(file, test):
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.fixture
def shared_simulations(monkeypatch):
    """What another test of the session has simulated is not simulated again."""
    from tests.examples.experiment_runs import simulated

    def simulate(scenario, loop, variant, realtime_rate=0.0, progress=None):
        done = simulated(scenario, variant, loop)
        log = done.log.assign_coords(variant=variant)
        return replace(done, variant=variant, log=log, diagram=loop.diagram, realtime_factor=1.0)

    monkeypatch.setattr("forcectl.runs.run.simulate", simulate)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder, with modules of the reader's own."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "docs").mkdir()
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def short_sweep(text: str) -> str:
    """A sweep of the first value of each key, one seed and the first arm, of 20 ms a trial; cases are all there."""
    from forcectl.framework.yaml_tree import Tagged, dump, parse

    tree = parse(text, "sweep")
    overrides = tree.setdefault("overrides", Tagged())
    overrides.pop("motion.start_time", None)  # nothing begins after the end
    overrides["duration"] = 0.02
    drawn = tree.get("design") not in (None, "grid")
    for name, values in tree.get("keys", {}).items():
        tree["keys"][name] = values if drawn else values[:1]
    if "arms" in tree:
        tree["arms"] = Tagged(dict(list(tree["arms"].items())[:1]))
    for name, value in {"trials": 1, "seeds": [7]}.items():
        if name in tree:
            tree[name] = value
    for name in ("constraints", "worst", "repeat", "compare", "share_over"):
        tree.pop(name, None)
    return dump(tree)


@pytest.fixture
def prepared(request, folder, monkeypatch, warm, plants_identified_once, shared_simulations):
    """A story with all that it needs."""
    story: Story = STORIES[request.param]
    if story.page:
        write_files(story.page, folder)
    for name, text in story.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    if story.prepare:
        story.prepare(folder)
    if not story.pictures:
        request.getfixturevalue("without_pictures")
    if not story.logs:
        request.getfixturevalue("without_logs")
    if story.short == "sweeps":
        shipped = folder / "shipped" / "sweeps"
        shipped.mkdir(parents=True)
        for file in (ROOT / "experiments" / "sweeps").glob("*.yaml"):
            text = file.read_text(encoding="utf-8")
            shipped.joinpath(file.name).write_text(short_sweep(text), encoding="utf-8")
        monkeypatch.setattr("forcectl.sweeps.sweep_config.experiments_folder", lambda: folder / "shipped")
    if story.short == "experiments":
        monkeypatch.setattr("forcectl.scenario.catalog.list_experiments", lambda: ["fig_2_8"])
    return story


def equal_variants(directory: Path) -> list[str]:
    """The variants of a run that have the metrics of another one: their names are all that differs."""
    found = json.loads((directory / "metrics.json").read_text(encoding="utf-8"))
    return [name for name, metrics in found.items() if list(found.values()).count(metrics) > 1]


def given(step: Step, folder: Path) -> tuple[list[str], Path | None]:
    """The words of a command, as a shell makes them for a job of an array, and where its output goes."""
    text = step.command.replace("$SLURM_ARRAY_TASK_ID", "2").replace("$((JOB_COMPLETION_INDEX + 1))", "3")
    text = text.replace("/data/part-$JOB_COMPLETION_INDEX", str(folder / "data"))
    words, target = shlex.split(text)[1:], None
    if ">" in words:
        words, target = words[:-2], folder / words[-1]
    return words + shlex.split(step.also), target


@pytest.mark.slow
@pytest.mark.parametrize("prepared", STORIES, indirect=True)
def test_commands_print_what_they_are_for(prepared, forcectl, folder):
    for step in prepared.steps:
        words, target = given(step, folder)
        code, out, err = forcectl(*words)
        assert code == step.code, (step.command, out[-1000:], err[-1000:])
        if target:
            target.write_text(out, encoding="utf-8")
        if step.says == "shown":
            (error,) = re.findall(r"^error: .*$", page_text(prepared.page), re.MULTILINE)
            assert err == f"{error}\n"
        else:
            assert "Traceback" not in err
        text = " ".join(out.split())
        assert [shown for shown in step.shows if shown not in text] == [], (step.command, out)
        if step.check:
            step.check(folder, out)
        for place in re.findall(r"results in (\S+): log.nc", text):
            if "duration" not in step.also:  # the beginning alone may be the same
                assert equal_variants(folder / place) == list(step.equal), step.command
