"""Keys that change nothing in their scenario are refused in one line."""

from __future__ import annotations

import pytest

from forcectl.errors import BadInputError
from forcectl.scenario.scenario import build

SEGMENTS = "materials: {segments: [{material: plastic, start: -1, end: 1}]}"
# Text of a scenario; how the message goes on after file and line.
REFUSED = [
    ("{environment: {surface: {slope: 0.1}}}", "environment.surface.slope = 0.1: must be left out without a motion"),
    (
        "{environment: {surface: {heights: {w: !Waves {}}}}}",
        "environment.surface.heights = ['w']: must be left out without a motion along the surface",
    ),
    (
        f"{{environment: {{stiffness: 1e4, surface: {{{SEGMENTS}}}}}}}",
        "environment.stiffness = 10000.0: must be left out beside surface.materials, whose segments say it",
    ),
    (
        f"{{environment: {{damping: 10, surface: {{{SEGMENTS}}}}}}}",
        "environment.damping = 10.0: must be left out beside surface.materials, whose segments say it",
    ),
    (
        "{self_collision: true}",
        "self_collision = true: must be false or left out, or have a fidelity with dynamics, such as Multibody, not",
    ),
    (
        "{elastic_joints: false, stiffness_scale: 2}",
        "stiffness_scale = 2.0: must be left out with elastic_joints = false: rigid joints have none",
    ),
    (
        "{drive: {servo: {ideal: true, position_gain: 3}}}",
        "drive.servo.position_gain = 3.0: must be left out with ideal = true: an ideal servo has no loops",
    ),
]
# What may look like it, and has an effect, or is said by a preset.
ACCEPTED = [
    "station: {environment: {surface: {slope: 0.1}}}\nmotion: {distance: 0.01}",
    "station: {environment: {surface: {heights: {w: !Waves {}}}}}\nmotion: {distance: 0.01}",
    f"preset: delay_only\nstation: {{environment: {{surface: {{{SEGMENTS}}}}}}}",
    "preset: ideal\nstation: {self_collision: false}",
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_what_changes_nothing_is_refused(tmp_path, text, message):
    file = tmp_path / "own.yaml"
    file.write_text(f"duration: 1\nstation: {text}\n")
    with pytest.raises(BadInputError) as caught:
        build(file, fidelity="OneDimensional")
    assert str(caught.value).startswith(f"own.yaml:2: station.{message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ACCEPTED)
def test_what_has_an_effect_is_not(tmp_path, text):
    file = tmp_path / "own.yaml"
    file.write_text(f"{text}\n")
    assert build(file, fidelity="OneDimensional").workcell.contact.name == "environment"
