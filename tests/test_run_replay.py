"""The replay is one page that needs no network and moves as the log says."""

from __future__ import annotations

import re

import pytest

import forcectl as fc


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Multibody"])
def test_a_replay_is_one_self_contained_page(tmp_path, capfd, fidelity):
    fc.run("fig_2_8", overrides={"duration": 0.5}, fidelity=fidelity, out=tmp_path / "run", replay=True)
    page = (tmp_path / "run" / "replay.html").read_text(encoding="utf-8")
    assert len(page) > 1_000_000
    assert not re.findall(r"<(?:script|link)[^>]+(?:src|href)=[\"']https?:", page)
    assert capfd.readouterr().err == ""


def test_every_variant_has_its_own_page(tmp_path):
    fc.run("fig_2_7", overrides={"duration": 0.1}, out=tmp_path / "run", replay=True)
    pages = sorted(path.name for path in (tmp_path / "run").glob("replay*"))
    assert pages == ["replay_1.html", "replay_2.html", "replay_3.html"]


def test_a_longer_run_has_more_frames(tmp_path):
    sizes = []
    for duration in (0.1, 1.0):
        out = tmp_path / str(duration)
        fc.run("fig_2_8", overrides={"duration": duration}, out=out, replay=True)
        sizes.append((out / "replay.html").stat().st_size)
    # Each of the 29 further frames moves at least six links.
    assert sizes[1] - sizes[0] > 29 * 6 * 16


def test_a_replay_needs_a_directory():
    with pytest.raises(fc.BadInputError, match="replay = True: must be False without an output directory"):
        fc.run("fig_2_8", replay=True)
