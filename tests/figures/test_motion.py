"""Figures of the motion of a robot."""

from __future__ import annotations

import forcectl as fc
from forcectl.analysis.slot import run_figures


def test_a_variant_without_readings_of_joints_costs_no_figure() -> None:
    variants = {"plain": {}, "joints": {"station.sensors.joints": "!JointReadings"}}
    log = fc.run({"variants": variants, "duration": 0.2}).log
    figures = run_figures(log, "Two", {})
    assert {"force", "motion", "forces_joints"} <= {*figures}
    assert "forces_plain" not in figures
    assert {line.get_label() for line in figures["motion"].axes[0].lines} >= {f"joint_{k}" for k in range(1, 7)}
