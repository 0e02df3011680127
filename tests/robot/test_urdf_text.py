"""The text of URDF files: materials that are defined after their use, twice, or never."""

import pytest
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from forcectl.robot.model_file import ModelFile, parse_models

GREY, RED = '<color rgba="0.2 0.2 0.2 1"/>', '<color rgba="1 0 0 1"/>'


def ball(link, material):
    visual = f'<visual><geometry><sphere radius="0.1"/></geometry>\n{material}</visual>'
    return f'<link name="{link}">\n<!-- a remark of\n two lines -->\n{visual}</link>\n'


def write_balls(folder, first, second, last=""):
    mount = '<joint name="mount" type="fixed"><parent link="a"/><child link="b"/></joint>\n'
    file = folder / "balls.urdf"
    file.write_text(f'<robot name="balls">\n{ball("a", first)}{ball("b", second)}{mount}{last}</robot>\n')
    return file


def colours(file):
    """Red of the colours of the two balls."""
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    parse_models(plant, {"balls": ModelFile.read(file)}, [])
    found = []
    for name in "ab":
        (shape,) = plant.GetVisualGeometriesForBody(plant.GetBodyByName(name))
        properties = scene_graph.model_inspector().GetIllustrationProperties(shape)
        has = properties.HasProperty("phong", "diffuse")
        found.append(properties.GetProperty("phong", "diffuse").r() if has else None)
    return found


@pytest.mark.parametrize(
    ("first", "second", "last", "found"),
    [
        ('<material name="m"/>', f'<material name="m">{RED}</material>', "", [1.0, 1.0]),
        ('<material name="m"/>', '<material name="m"/>', f'<material name="m">{GREY}</material>', [0.2, 0.2]),
        (
            f'<material name="m">{RED}</material>',
            '<material name="m"/>',
            f'<material name="m">{GREY}</material>',
            [1.0, 0.2],
        ),
        (f'<material name="m">{RED}</material>', f'<material name="m">{GREY}</material>', "", [1.0, 0.2]),
    ],
    ids=["in a later link", "below the robot", "below the robot and in a link", "two of one name"],
)
def test_a_material_may_be_defined_anywhere(tmp_path, first, second, last, found):
    file = write_balls(tmp_path, first, second, last)
    assert colours(file) == pytest.approx(found)
    assert ModelFile.read(file).urdf.notes == []


def test_a_material_without_a_colour_anywhere_is_left_out_and_noted(tmp_path):
    file = write_balls(tmp_path, f'<material name="m">{RED}</material>', '<material name="other"/>')
    assert colours(file) == [1.0, None]
    assert ModelFile.read(file).urdf.notes == ["material other: has no colour, left out"]
