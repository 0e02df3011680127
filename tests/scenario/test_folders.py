"""Files and folders that a scenario names are found beside its file."""

import pytest

from forcectl.errors import BadInputError
from forcectl.scenario.scenario import build, load_scenario


def write(folder, text, name="own.yaml"):
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(text)
    return path


def test_a_reference_file_beside_the_scenario_is_found_from_anywhere(tmp_path, monkeypatch):
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "force.csv").write_text("time,force\n0,0\n1,10\n2,10\n")
    path = write(folder, "reference: !File {path: force.csv}\n")
    monkeypatch.chdir(tmp_path)
    assert load_scenario(path).reference.largest_force() == 10.0


@pytest.mark.parametrize(("robot", "found"), [("own", "study/own"), ("own/left", "study/own/left"), ("yumi", "yumi")])
def test_robot_and_tool_folders_beside_the_scenario_are_found_from_anywhere(tmp_path, monkeypatch, robot, found):
    folder = tmp_path / "study"
    for name, file in (("own", "own.control.yaml"), ("tip", "tip.tool.yaml"), ("yumi", "yumi.control.yaml")):
        (folder / name).mkdir(parents=True)
        (folder / name / file).write_text("")
    whole = {each: str(tmp_path / each) for each in ("study/own", "study/own/left", "study/tip")}
    path = write(folder, f"station: {{robot: {robot}, tool: tip}}\n")
    for here, file in ((tmp_path, path), (folder, path.name)):  # what a run writes again is whole from there, too
        monkeypatch.chdir(here)
        station = load_scenario(file).station
        assert (station.robot, station.tool) == (whole.get(found, found), whole["study/tip"])
    path = write(folder, "station: {tool: {left: tip, right: null}}\n")
    assert load_scenario(path).station.tool == {"left": whole["study/tip"], "right": None}
    monkeypatch.chdir(tmp_path)
    assert load_scenario({"station": {"robot": "own"}}).station.robot == "own"


def test_a_robot_folder_that_is_nowhere_is_told_with_where_it_was_looked_for(tmp_path, monkeypatch):
    path = write(tmp_path, "station: {robot: ur_lik}\n")
    monkeypatch.chdir("/")
    told = "known: comau_smart_six, yumi; folders are looked for beside the scenario's file, and in '/'"
    with pytest.raises(BadInputError, match=rf"yaml:1: station\.robot: unknown robot .* 'ur_lik': {told}$"):
        build(path)
