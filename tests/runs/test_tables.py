"""What `forcectl run` prints besides the numbers."""

from __future__ import annotations

from forcectl.runs.tables import metrics_table


def test_a_variant_that_does_not_reach_its_target_has_a_line() -> None:
    there = {"left.reached": 1.0, "left.stalled": 0.0, "reached": 1.0, "stalled": 0.0}
    blocked = {"left.reached": 0.0, "left.stalled": 1.0, "right.reached": 0.0, "right.stalled": 0.0, "reached": 0.0}
    assert metrics_table({"free": there}).caption is None
    assert metrics_table({"free": there, "blocked": blocked}).caption == (
        "blocked: last target not reached: left (stalled), right (still moving)"
    )
