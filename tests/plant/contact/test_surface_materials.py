"""Surfaces of several materials: values over the path, blends, and what is refused."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import forcectl
from forcectl.errors import BadInputError
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.contact.surface_materials import MATERIALS, MaterialsConfig, SegmentConfig
from tests.examples.surface_examples import material


def segments(*parts: tuple[str, float, float], **changes: float) -> list[SegmentConfig]:
    return [SegmentConfig(material=name, start=start, end=end, **changes) for name, start, end in parts]


THREE = (("plastic", -0.1, 0.02), ("wood", 0.02, 0.05), ("aluminium", 0.05, 0.1))


def test_away_from_the_joints_it_is_the_material_of_the_segment() -> None:
    path = MaterialsConfig(segments=segments(*THREE), blend=0.01).path()
    places = [-5.0, 0.0149, 0.0251, 0.0449, 0.0551, 5.0]
    expected = [MATERIALS[name] for name in ("plastic", "plastic", "wood", "wood", "aluminium", "aluminium")]
    np.testing.assert_array_equal(path.along(path.stiffness, places), expected)


def test_at_a_joint_it_is_the_mean_and_the_change_is_half_a_cosine() -> None:
    path = MaterialsConfig(segments=segments(*THREE), blend=0.01).path()
    plastic, wood = MATERIALS["plastic"], MATERIALS["wood"]
    assert path.along(path.stiffness, 0.02) == pytest.approx((plastic + wood) / 2)
    quarter = plastic + (wood - plastic) * (1 - math.cos(math.pi / 4)) / 2
    assert path.along(path.stiffness, 0.0175) == pytest.approx(quarter)


def test_without_blend_it_is_a_step() -> None:
    path = MaterialsConfig(segments=segments(*THREE), blend=0.0).path()
    values = path.along(path.stiffness, [0.02 - 1e-9, 0.02])
    np.testing.assert_array_equal(values, [MATERIALS["plastic"], MATERIALS["wood"]])


lengths = st.lists(st.floats(0.005, 0.1), min_size=1, max_size=6)


@pytest.mark.slow
@given(lengths, st.floats(-0.2, 0.2), st.floats(0.0, 1.0), st.randoms(use_true_random=False))
def test_it_stays_between_neighbours_and_does_not_jump(
    widths: list[float], first: float, share: float, random: Any
) -> None:
    ends = (first + np.concatenate([[0.0], np.cumsum(widths)])).tolist()
    parts = [(random.choice(list(MATERIALS)), start, end) for start, end in pairwise(ends)]
    config = MaterialsConfig(segments=segments(*parts), blend=0.001 + share * 0.004)
    random.shuffle(config.segments)  # the order in the file does not matter
    path = config.path()
    s = np.linspace(ends[0] - 0.01, ends[-1] + 0.01, 4001)
    stiffness = path.along(path.stiffness, s)
    assert stiffness.min() >= min(path.stiffness)
    assert stiffness.max() <= max(path.stiffness)
    steepest = np.ptp(path.stiffness) * math.pi / 2 / config.blend
    assert np.abs(np.diff(stiffness)).max() <= steepest * (s[1] - s[0]) * (1 + 1e-6) + 1e-6
    for name, start, end in parts:
        assert path.along(path.stiffness, (start + end) / 2) == pytest.approx(MATERIALS[name])


def test_a_material_of_its_own_needs_a_stiffness_and_a_given_one_wins() -> None:
    assert SegmentConfig(material="cork", start=0.0, end=1.0, stiffness=2e4).environment_stiffness == 2e4
    assert SegmentConfig(material="wood", start=0.0, end=1.0, stiffness=2e4).environment_stiffness == 2e4


def test_the_block_shows_the_damping_only_where_there_is_any() -> None:
    assert material().num_output_ports() == 1
    block = material(damping=30.0)
    context = block.CreateDefaultContext()
    for place, expected in ((0.0, 0.0), (0.02, 15.0), (0.05, 30.0)):
        block.GetInputPort("path_position").FixValue(context, [place])
        assert block.GetOutputPort("surface_damping").Eval(context).item() == pytest.approx(expected)


def test_heights_of_segments_are_steps_of_the_surface() -> None:
    parts = segments(*THREE[:2])
    parts[1].height = 2e-4
    config = SurfaceConfig(materials=MaterialsConfig(segments=parts, blend=0.01), length=0.1)
    assert not config.flat
    heights = config.profile(0.0).height(np.array([0.0, 0.02, 0.04]))
    np.testing.assert_allclose(heights, [0.0, 1e-4, 2e-4], atol=1e-12)
    assert SurfaceConfig(materials=MaterialsConfig(segments=segments(*THREE))).flat
    assert not SurfaceConfig(materials=MaterialsConfig(segments=segments(*THREE))).uniform


def refused(materials: dict[str, Any], **overrides: Any) -> str:
    overrides = {"station.environment.surface.materials": materials, "duration": 0.01} | overrides
    with pytest.raises(BadInputError) as error:
        forcectl.run({}, overrides=overrides)
    return str(error.value)


KEY = "station.environment.surface.materials"
PLASTIC = {"material": "plastic", "start": -0.1, "end": 0.02}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"material": "wod"}, "segments.1.material: unknown material 'wod': did you mean 'wood'?"),
        ({"material": "cork"}, "for any other name give its stiffness"),
        ({"stiffness": -1.0}, "segments.1.stiffness = -1.0: must be positive"),
        ({"stiffness": 0.0}, "segments.1.stiffness = 0.0: must be positive"),
        ({"damping": -1.0}, "segments.1.damping = -1.0: must be not negative"),
        ({"height": 1.0}, "segments.1.height = 1.0: must be from -0.05 to 0.05"),
        (
            {"height": 0.05},
            "segments.1.height = 0.05: must be within 0.00127 m of the one before it, 0 m: a step, or a",
        ),
        ({"end": 0.01}, "segments.1.end = 0.01: must be above start = 0.02 m"),
        ({"start": 0.01}, "segments.1.start = 0.01: must be 0.02 m, where plastic ends: there is an overlap"),
        ({"start": 0.03}, "segments.1.start = 0.03: must be 0.02 m, where plastic ends: there is a gap"),
        ({"colour": "red"}, "segments.1.colour: unknown key"),
    ],
)
def test_bad_segments_are_named_with_their_full_key(changes: dict[str, Any], message: str) -> None:
    told = refused({"segments": [PLASTIC, {"material": "wood", "start": 0.02, "end": 0.05} | changes]})
    assert KEY in told
    assert message in told


def test_bad_lists_of_materials_are_refused() -> None:
    assert f"{KEY}.segments = []: must be at least one segment" in refused({"segments": []})
    assert f"{KEY}.segments.0.end is missing" in refused({"segments": [{"material": "wood", "start": 0.0}]})
    parts = [{"material": name, "start": start, "end": end} for name, start, end in THREE]
    assert f"{KEY}.blend = 0.031: must be at most the shortest" in refused({"segments": parts, "blend": 0.031})
    assert f"{KEY}.blend = -1.0" in refused({"segments": parts, "blend": -1.0})
    two_sided = {"station.environment.one_sided": False}
    assert "one_sided = False: must be true with surface.materials" in refused({"segments": parts}, **two_sided)
    tilted = {"station.environment.surface.direction": [0.0, 0.0, 1.0]}
    assert "surface.direction = [0.0, 0.0, 1.0]: must be across the normal" in refused({"segments": parts}, **tilted)
    stiff = [PLASTIC | {"stiffness": 1e8}]
    multibody = {"station.fidelity": "Multibody", "station.stiffness_set": ""}
    assert "stiffness = 1e+08: must be below" in refused({"segments": stiff}, **multibody)


def test_the_example_of_the_documentation_is_what_it_says(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "several_materials.md"
    example = tmp_path / "example.yaml"
    example.write_text(page.read_text(encoding="utf-8").split("```yaml")[1].split("```")[0])
    surface = forcectl.load_scenario(example).station.environment.surface
    assert surface.materials is not None
    path = surface.materials.path()
    assert path.stiffness == [MATERIALS["plastic"], MATERIALS["wood"], 2e4]
    assert path.along(path.damping, [0.0, 0.06]).tolist() == [0.0, 50.0]
    assert surface.profile(0.0).height(0.142) == pytest.approx(1e-4)  # between two grooves
