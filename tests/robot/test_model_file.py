"""Model files as Drake parses them: nothing is fetched, and what is wrong is one line with the file."""

from __future__ import annotations

import pytest
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from forcectl.errors import BadInputError
from forcectl.robot.model_file import ModelFile, parse_models

MESH = "<mesh><uri>package://drake_models/veggies/pepper.obj</uri></mesh>"
INCLUDED = "<include><uri>package://drake_models/veggies/pepper.sdf</uri></include>"


def write_sdf(folder, inside):
    file = folder / "own.sdf"
    file.write_text(f'<sdf version="1.9"><model name="own">{inside}</model></sdf>')
    return file


@pytest.mark.parametrize(
    "inside", [INCLUDED, f'<link name="a"><visual name="v"><geometry>{MESH}</geometry></visual></link>']
)
def test_nothing_is_fetched_from_a_network(tmp_path, monkeypatch, inside):
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:9")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    file, plant, geometry = write_sdf(tmp_path, inside), MultibodyPlant(time_step=0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(geometry)
    with pytest.raises(BadInputError, match=r"own\.sdf: .*drake_models") as caught:
        parse_models(plant, {"own": ModelFile.look(file)}, [])
    assert "download" not in str(caught.value)
    assert not (tmp_path / "cache").exists()
