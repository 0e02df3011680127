"""Every shipped experiment as a block diagram, in every format, and what its readers will look for in it."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import pytest
from pydrake.systems.framework import Diagram

from forcectl.diagrams.station import FIDELITIES
from forcectl.errors import BadInputError
from forcectl.simulation.catalog import list_experiments
from forcectl.simulation.scenario import as_file, build, resolve, select_variants
from forcectl.viz.graph import FORMATS, block_graph, export

EXPERIMENTS = list_experiments()
STAGES = ("reference", "controller", "station")
SIGNATURES = {"png": b"\x89PNG\r\n", "pdf": b"%PDF-"}


@lru_cache(maxsize=64)
def diagram_of(experiment: str, fidelity: str) -> Diagram:
    file = as_file(experiment)
    return build(resolve(file, select_variants(file)[0], {"station.fidelity": fidelity})).diagram


def cases() -> list[object]:
    """Every experiment and format; bitmaps take a second or two, so that one of them is enough for a quick look."""
    quick = [(experiment, name) for experiment in EXPERIMENTS for name in FORMATS if name not in SIGNATURES]
    bitmaps = [(experiment, name) for name in SIGNATURES for experiment in EXPERIMENTS]
    marks = [() if experiment == EXPERIMENTS[0] else pytest.mark.slow for experiment, _ in bitmaps]
    return quick + [pytest.param(*case, marks=mark) for case, mark in zip(bitmaps, marks, strict=True)]


@pytest.mark.parametrize(("experiment", "format_"), cases())
def test_every_experiment_draws_in_every_format(experiment: str, format_: str, tmp_path: Path) -> None:
    file, diagram = tmp_path / f"loop.{format_}", diagram_of(experiment, "OneDimensional")
    try:
        drawn = export(diagram, file, format=format_)
    except BadInputError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        # Only bitmaps may need a renderer that is not here; then the message says which, and nothing is written.
        assert format_ in SIGNATURES
        assert f"format = '{format_}': needs " in refusal
        assert not list(tmp_path.iterdir())
        return
    assert file.stat().st_size > 1000
    if format_ in SIGNATURES:
        assert isinstance(drawn, bytes)
        assert drawn.startswith(SIGNATURES[format_])
        return
    text = file.read_text(encoding="utf-8")
    for stage in STAGES:
        assert stage in text
    # Nothing from a network, whatever opens it.
    assert not re.search(r"(?:src|href)\s*=\s*[\"']?https?://", text)


def names_at(experiment: str, fidelity: str, depth: int | None) -> set[str]:
    return {block.name for block in block_graph(diagram_of(experiment, fidelity), depth=depth).nodes}


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_folded_loop_is_the_thesis_figure(fidelity: str) -> None:
    """Reference, controller and station, and the signals between them by name."""
    shown = names_at("fig_2_7", fidelity, 1)
    assert shown - {"closed_loop", "motion"} == set(STAGES)
    text = export(diagram_of("fig_2_7", fidelity), format="dot", depth=1)
    assert isinstance(text, str)
    for signal in ("desired_force", "measured_force", "joint_position_command"):
        assert signal in text


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_unfolded_loop_shows_the_blocks_inside(experiment: str, fidelity: str) -> None:
    own = {"OneDimensional": "contact", "Kinematic": "tip_displacement", "Multibody": "plant"}[fidelity]
    folded, unfolded = names_at(experiment, fidelity, 1), names_at(experiment, fidelity, None)
    assert {"force_law", "position_loop", "force_sensor", own} <= unfolded
    assert not {"force_law", "position_loop", "force_sensor", own} & folded


def test_units_and_sample_times_are_on_the_picture() -> None:
    text = export(diagram_of("fig_2_7", "OneDimensional"), format="svg")
    assert isinstance(text, str)
    for shown in ("N</text>", "rad</text>", "2 ms"):
        assert shown in text


def test_interactive_page_holds_the_whole_diagram() -> None:
    page = export(diagram_of("fig_2_7", "Multibody"), format="html")
    assert isinstance(page, str)
    for block in ("force_law", "position_loop", "plant", "tool_compensation"):
        assert block in page
