"""What there is to choose from, read from files alone."""

import dataclasses

import pytest

from forcectl.errors import BadInputError
from forcectl.scenario import catalog
from forcectl.scenario.schema import load_object


def test_the_experiments_of_chapter_2_and_the_presets_are_shipped():
    assert {"fig_2_7", "fig_2_8", "mismatch_2_14"} <= set(catalog.list_experiments())
    assert {"friction", "ideal", "linear", "delay_only", "second_campaign"} <= set(catalog.list_presets())


@pytest.mark.parametrize(
    ("slot", "path"), [(slot, path) for slot, table in catalog.SLOTS.items() for path in table.values()]
)
def test_every_tag_leads_to_a_dataclass_that_fills_its_slot(slot, path):
    cls = load_object(path)
    assert dataclasses.is_dataclass(cls)
    for name in catalog.CONTRACTS[slot]:
        assert callable(getattr(cls, name))


def test_every_slot_has_a_contract():
    assert set(catalog.SLOTS) == set(catalog.CONTRACTS)


@pytest.mark.slow
def test_every_block_has_a_line_that_says_what_it_is():
    blocks = catalog.list_blocks()
    wanted = {"plant/drives/servo", "plant/sensors/force_sensor", "force/integral", "estimation/environment"}
    assert wanted <= set(blocks)
    assert all(blocks.values())


def test_models_are_listed_under_the_keys_that_name_them():
    assert catalog.list_models() == {
        "station.robot": ["comau_smart_six", "yumi"],
        "station.tool": ["force_probe", "yumi_gripper"],
    }


def test_a_file_is_found_by_path_and_its_name_is_the_stem(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("duration: 1\n")
    (tmp_path / "bare").write_text("duration: 2\n")
    assert catalog.find_scenario("mine.yaml").name == "mine"
    assert catalog.find_scenario("bare").tree == {"duration": 2}
    assert catalog.find_scenario("fig_2_7").origin == "fig_2_7.yaml"
    with pytest.raises(BadInputError, match=r"scenario file 'other.yaml' does not exist"):
        catalog.find_scenario("other.yaml")


def test_the_directory_of_a_run_is_told_from_its_scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "first").mkdir()
    with pytest.raises(BadInputError, match=r"scenario file 'first' is a folder: must be a YAML file or one of: "):
        catalog.find_scenario("first")
    (tmp_path / "first" / "scenario.yaml").write_text("duration: 1")
    with pytest.raises(
        BadInputError, match=r"is a folder: must be a YAML file, such as 'first/scenario.yaml', or one "
    ):
        catalog.find_scenario("first")
