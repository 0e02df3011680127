"""`KNOWN_GAPS.md` names every line of a shipped experiment that is known to be missed."""

import re
from pathlib import Path

import pytest

from forcectl.diagrams.station import SHIPPED_FIDELITIES
from forcectl.scenario.catalog import find_scenario, list_experiments

TEXT = (Path(__file__).parents[2] / "KNOWN_GAPS.md").read_text(encoding="utf-8")
GAPS = [
    (name, line["target"], fidelity, reason)
    for name in list_experiments()
    for line in find_scenario(name).tree.get("expect", [])
    for fidelity, reason in line.get("gaps", {}).items()
]


@pytest.mark.parametrize(("experiment", "target", "fidelity", "reason"), GAPS)
def test_every_gap_is_written_down(experiment, target, fidelity, reason):
    assert target in " ".join(TEXT.split())
    assert fidelity in SHIPPED_FIDELITIES
    section = re.search(r"\(KNOWN_GAPS\.md, section (\d+)\)$", reason)
    assert section is not None
    assert f"\n## {section[1]}. " in TEXT
