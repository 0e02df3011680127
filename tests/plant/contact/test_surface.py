"""Surface profiles against closed forms: grooves, roughness, what a ball makes of them, files, and bad input."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.plant.contact.surface import (
    GRID,
    GrooveConfig,
    ProfileFileConfig,
    RoughnessConfig,
    SurfaceConfig,
    SurfaceHeight,
    SurfaceProfile,
    WaveConfig,
    ball_envelope,
    groove_profile,
    read_profile,
    rough_profile,
)

SHARP = 0.0  # ball radius of a point [m]


def grooved(**changes: Any) -> SurfaceConfig:
    return SurfaceConfig(heights={"grooves": GrooveConfig(**changes)})


# --- parts -----------------------------------------------------------------------------------------------------------


def test_a_groove_has_its_depth_width_and_flanks() -> None:
    s = np.array([-3.0, -2.0, -1.5, -1.0, 0.0, 1.0, 1.25, 1.5, 2.0, 3.0])
    np.testing.assert_allclose(
        groove_profile(7 + s, 7.0, 0.2, 4.0, 1.0),
        [0, 0, -0.1, -0.2, -0.2, -0.2, -0.2 * (1 + math.sqrt(0.5)) / 2, -0.1, 0, 0],
        atol=1e-15,
    )
    np.testing.assert_allclose(groove_profile(np.array([-1.99, 1.99, 2.0]), 0.0, 0.2, 4.0, 0.0), [-0.2, -0.2, 0.0])
    # Without a flat bottom it is one period of a cosine.
    t = np.linspace(-2, 2, 41)
    np.testing.assert_allclose(groove_profile(t, 0.0, 0.2, 4.0, 2.0), -0.1 * (1 + np.cos(np.pi * t / 2)), atol=1e-15)


@settings(max_examples=20, deadline=None)
@given(rms=st.floats(1e-7, 1e-4), length=st.floats(2e-4, 5e-3), seed=st.integers(0, 2**32))
def test_roughness_has_its_rms_correlation_and_band(rms: float, length: float, seed: int) -> None:
    z = rough_profile(20_001, GRID, rms, length, seed)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(rms, rel=1e-9)
    assert abs(z.mean()) < 1e-9 * rms
    spectrum = np.abs(np.fft.rfft(z))
    beyond = np.fft.rfftfreq(len(z), GRID) > 1 / length
    assert spectrum[beyond].max() < 1e-9 * spectrum.max()
    assert z.tobytes() == rough_profile(20_001, GRID, rms, length, seed).tobytes()
    assert not np.allclose(z, rough_profile(20_001, GRID, rms, length, seed + 1))


def test_roughness_forgets_over_its_correlation_length() -> None:
    length, lag = 1e-3, 50  # 50 points of 20 um are the length
    z = np.array([rough_profile(20_001, GRID, 1.0, length, seed) for seed in range(20)])
    for factor in (0.5, 1.0, 1.5):
        shifted = np.roll(z, round(factor * lag), axis=1)
        assert np.mean(z * shifted) == pytest.approx(math.exp(-(factor**2)), abs=0.03)


def test_a_ball_sinks_into_a_step_groove_by_its_segment() -> None:
    """Width w between sharp edges: R - sqrt(R^2 - w^2/4), whatever the depth beyond it."""
    s = GRID * np.arange(-1000, 1001)
    for radius, width in ((0.01, 0.004), (0.005, 0.006)):
        z = groove_profile(s, 0.0, 1.0, width, 0.0)
        sunk = -ball_envelope(z, GRID, radius).min()
        assert sunk == pytest.approx(radius - math.sqrt(radius**2 - width**2 / 4), rel=0.02)
    shallow = groove_profile(s, 0.0, 1e-4, 0.008, 0.0)
    h = ball_envelope(shallow, GRID, 0.01)
    assert h.min() == pytest.approx(-1e-4)
    # It leaves the bottom sqrt(2 R d) before the edge.
    bottom = s[h < -1e-4 + 1e-12]
    assert bottom.max() == pytest.approx(0.004 - math.sqrt(2 * 0.01 * 1e-4), abs=2 * GRID)


def test_a_ball_on_a_ridge_is_round_and_on_a_gentle_wave_follows_it() -> None:
    s = GRID * np.arange(-1000, 1001)
    ridge = np.where(np.abs(s) < GRID / 2, 1e-3, 0.0)
    h = ball_envelope(ridge, GRID, 0.01)
    near = np.abs(s) < 0.003
    np.testing.assert_allclose(h[near], 1e-3 - 0.01 + np.sqrt(0.01**2 - s[near] ** 2), atol=1e-9)
    wave = 1e-5 * np.sin(2 * np.pi * s / 0.02)  # radius of curvature 1 m, a hundred balls
    np.testing.assert_allclose(ball_envelope(wave, GRID, 0.01), wave, atol=1e-7)


@settings(max_examples=25, deadline=None)
@given(radius=st.floats(0.0, 0.02), seed=st.integers(0, 1000), rms=st.floats(1e-6, 5e-4))
def test_the_envelope_is_the_definition(radius: float, seed: int, rms: float) -> None:
    z = rough_profile(301, GRID, rms, 5e-4, seed)
    reach = int(radius / GRID)
    expected = [
        max(
            z[min(max(i + u, 0), len(z) - 1)] + math.sqrt(radius**2 - (u * GRID) ** 2) - radius
            for u in range(-reach, reach + 1)
        )
        for i in range(0, len(z), 37)
    ]
    np.testing.assert_allclose(ball_envelope(z, GRID, radius)[::37], expected, atol=1e-12)
    assert np.all(ball_envelope(z, GRID, radius) >= z)


# --- profile and block -----------------------------------------------------------------------------------------------


def test_heights_count_from_the_start_and_stay_level_beyond_the_length() -> None:
    profile = grooved(positions=[0.0, 0.05], depth=1e-4).profile(SHARP)
    np.testing.assert_allclose(profile.height([0.0, 0.05, 0.02, 0.3, -0.3]), [0, 0, 1e-4, 1e-4, 1e-4], atol=1e-12)
    sloped = SurfaceConfig(slope=-0.02).profile(0.01)
    np.testing.assert_allclose(sloped.height([-0.5, 0.0, 0.1, 1.0]), [0.01, 0.0, -0.002, -0.02])


def test_parts_add_up() -> None:
    rough = RoughnessConfig(seed=3)
    both = SurfaceConfig(slope=0.01, heights={"a": GrooveConfig(), "b": rough}).profile(SHARP)
    alone = grooved().profile(SHARP), SurfaceConfig(heights={"b": rough}).profile(SHARP)
    s = np.linspace(-0.1, 0.1, 999)
    np.testing.assert_allclose(both.height(s), 0.01 * s + alone[0].height(s) + alone[1].height(s), atol=1e-15)


def test_waves_are_a_sine_that_the_ball_rests_on() -> None:
    profile = SurfaceConfig(heights={"a": WaveConfig(amplitude=2e-4, wavelength=0.03)}).profile(0.0)
    s = GRID * np.arange(-2000, 2000, 7)
    np.testing.assert_allclose(profile.height(s), 2e-4 * np.sin(2 * np.pi * s / 0.03), atol=1e-15)


class Own:
    """Heights of the user's, whatever they are."""

    def __init__(self, values: Any):
        self.values = values

    def heights(self, s: Any) -> Any:
        if isinstance(self.values, Exception):
            raise self.values
        return self.values


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (0.0, r"must return finite numbers of shape \(20001,\), like s, not shape \(\)"),
        (np.full(20001, np.nan), "must return finite numbers"),
        (np.full(20001, 0.2), "must be in metres, at most 0.05 m, not 0.2"),
        ("high", "must return heights, but raised ValueError"),
        (KeyError("depth"), "must return heights, but raised KeyError: 'depth' \\(test_surface.py:"),
    ],
)
def test_heights_of_a_users_part_that_cannot_be_used_are_named(values: Any, told: str) -> None:
    with pytest.raises(BadInputError, match=rf"^heights\.mine: .*{told}"):
        SurfaceConfig(heights={"mine": Own(values)})


@pytest.mark.parametrize("spacing", [0.02, 0.007])
def test_grooves_by_spacing_leave_the_start_out(spacing: float) -> None:
    centres = GrooveConfig(spacing=spacing).centres(0.1)
    expected = [i * spacing for i in range(-20, 21) if i and abs(i) * spacing <= 0.1 + 1e-12]
    np.testing.assert_allclose(centres, expected)


@settings(max_examples=50, deadline=None)
@given(s=st.floats(-1.0, 1.0))
def test_the_block_is_the_profile(s: float) -> None:
    assert height_of(PROFILE, s) == pytest.approx(float(PROFILE.height(s)), abs=1e-15)


PROFILE = SurfaceConfig(slope=0.1, heights={"a": GrooveConfig(), "b": RoughnessConfig()}).profile(0.01)


def height_of(profile: SurfaceProfile, s: float) -> float:
    block = SurfaceHeight(profile)
    context = block.CreateDefaultContext()
    block.GetInputPort("path_position").FixValue(context, [s])
    return block.GetOutputPort("surface_height").Eval(context).item()


@pytest.mark.parametrize("s", [-1e9, -0.2, 0.0, 0.2, 1e9])
def test_the_block_is_level_at_its_ends_and_beyond(s: float) -> None:
    assert height_of(grooved(positions=[0.01]).profile(0.01), s) == 0.0


def test_a_position_that_is_no_number_gives_no_height() -> None:
    assert math.isnan(height_of(PROFILE, math.nan))


# --- files -----------------------------------------------------------------------------------------------------------


def write(folder: Path, text: str) -> str:
    path = folder / "surface.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


def of_file(path: str) -> SurfaceConfig:
    return SurfaceConfig(heights={"board": ProfileFileConfig(path=path)})


def test_a_file_is_joined_by_straight_lines_and_other_columns_are_left_alone(tmp_path: Path) -> None:
    path = write(tmp_path, "position, quality, height\n-0.1,a,0\n0,b,1e-3\n0.1,c,-1e-3\n")
    profile = of_file(path).profile(SHARP)
    np.testing.assert_allclose(
        profile.height([-0.15, -0.05, 0.0, 0.05, 0.1, 0.2]), [-1e-3, -5e-4, 0, -1e-3, -2e-3, -2e-3], atol=1e-9
    )
    np.testing.assert_allclose(read_profile(path)[1], [0, 1e-3, -1e-3])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "has columns"),
        ("s,height\n0,0\n", "must have position and height"),
        ("position,height\n0,0\n", "has 1 rows: must have at least 2"),
        ("position,height\n0,0\n0.1,x\n", "line 3: position = '0.1', height = 'x': must be finite numbers"),
        ("position,height\n0,0\n0.1,nan\n", "line 3"),
        ("position,height\n0,0\n0.1\n", "line 3: position = '0.1', height = None"),
        ("position,height\n0,0\n0.1,0\n0.1,0\n", "line 4: position = 0.1: must be above the last one"),
        ("position,height\n0,0\n10,1.5\n", "position = 10, height = 1.5: must be in metres, at most 0.05 m"),
        ("position,height\n0,0\n100,0.01\n", "positions span 100: must be in metres"),
        (
            "position,height\n0,0\n1e-4,0.05\n",
            "changes by 0.05 m from 0 to 0.0001: must be at most 0.001 m, or a slope",
        ),
        ("position,height\n0,0\n0.1,\u0661\n", "line 3"),
    ],
)
def test_a_file_that_cannot_be_a_profile_is_refused(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(BadInputError, match=r"heights\.board\.path = .*surface\.csv") as error:
        of_file(write(tmp_path, text))
    assert told in str(error.value)


def test_a_missing_or_unreadable_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="existing CSV file with the columns position and height"):
        of_file("nowhere.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(BadInputError, match="readable CSV file in UTF-8"):
        of_file(str(tmp_path / "binary.csv"))


# --- bad input -------------------------------------------------------------------------------------------------------

BAD = [
    (GrooveConfig, {"depth": 0.0}, "depth"),
    (GrooveConfig, {"depth": math.nan}, "depth"),
    (GrooveConfig, {"width": 1e-5}, "width"),
    (GrooveConfig, {"width": math.inf}, "width"),
    (GrooveConfig, {"flank": 0.003}, "flank"),
    (GrooveConfig, {"flank": -1e-4}, "flank"),
    (GrooveConfig, {"spacing": 0.003}, "spacing"),
    (GrooveConfig, {"spacing": 0.0}, "spacing"),
    (GrooveConfig, {"positions": [0.01, 0.012]}, "positions"),
    (GrooveConfig, {"positions": [math.nan]}, "positions.0"),
    (RoughnessConfig, {"rms": -1e-6}, "rms"),
    (RoughnessConfig, {"rms": 0.0}, "rms"),
    (RoughnessConfig, {"correlation_length": 1e-5}, "correlation_length"),
    (RoughnessConfig, {"rms": 1.0}, "rms"),
    (RoughnessConfig, {"rms": 3e-3}, "rms"),
    (RoughnessConfig, {"seed": -1}, "seed"),
    (GrooveConfig, {"depth": 1.0}, "depth"),
    (GrooveConfig, {"depth": 2e-3}, "depth"),
    (RoughnessConfig, {"seed": 0.5}, "seed"),
    (SurfaceConfig, {"direction": [0.0, 0.0, 0.0]}, "direction"),
    (SurfaceConfig, {"direction": [1.0, 0.0]}, "direction"),
    (SurfaceConfig, {"length": 0.0}, "length"),
    (SurfaceConfig, {"length": 1e3}, "length"),
    (SurfaceConfig, {"slope": 0.5}, "slope"),
    (SurfaceConfig, {"slope": math.nan}, "slope"),
    (SurfaceConfig, {"heights": {"a": GrooveConfig(positions=[0.3])}}, "heights.a.positions"),
    (SurfaceConfig, {"heights": {"a": GrooveConfig(spacing=15.0)}}, "heights.a.spacing"),
    (
        SurfaceConfig,
        {"length": 0.01, "heights": {"b": RoughnessConfig(correlation_length=0.1)}},
        "heights.b.correlation_length",
    ),
    (WaveConfig, {"amplitude": 0.0}, "amplitude"),
    (WaveConfig, {"amplitude": 1.0}, "amplitude"),
    (WaveConfig, {"wavelength": 1e-5}, "wavelength"),
]


@pytest.mark.parametrize(("config", "values", "told"), BAD)
def test_configs_name_the_field_that_is_wrong(config: type, values: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=rf"^{told} = .*: must be "):
        config(**values)


def test_flat_is_what_has_nothing_on_it() -> None:
    assert SurfaceConfig(length=0.5, direction=[0.0, 1.0, 0.0]).flat
    for changes in ({"slope": 1e-6}, {"heights": {"a": GrooveConfig()}}, {"heights": {"b": RoughnessConfig()}}):
        assert not SurfaceConfig(**changes).flat


def test_a_gap_is_below_the_start_and_not_flat() -> None:
    surface = SurfaceConfig(gap=0.01, slope=0.1)
    np.testing.assert_allclose(surface.profile(0.0).height([0.0, 0.05]), [-0.01, -0.005], atol=1e-15)
    assert not SurfaceConfig(gap=0.01).flat
    with pytest.raises(BadInputError, match=r"gap = -0\.01: must be from 0 to 0\.05"):
        SurfaceConfig(gap=-0.01)
