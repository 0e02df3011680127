"""docs/safety.md says what is true: what each fault of its table comes to under the integral law."""

import re

import pytest

import forcectl as fc
from forcectl.framework.yaml_tree import parse
from tests.examples.pages import blocks, page_text

PAGE = page_text("safety.md")
(SCENARIO,) = (block for block in blocks(PAGE, "yaml") if block.startswith("# faulted.yaml"))
FAULT = "{kind: nan, start: 0.8}"
ROWS = dict(re.findall(r"^\| (`\w+`, .*?|none) \| (\d+\.\d \(\d+\)) \|", PAGE, re.MULTILINE))
FAULTS = {
    "none": "",
    "`nan`, from 0.8 s": FAULT,
    "`inf`, one tick at 0.8 s": "{kind: inf, start: 0.8, duration: 0.002}",
    "`value`, -1e6 N, one tick at 0.8 s": "{kind: value, value: -1.0e6, start: 0.8, duration: 0.002}",
    "`value`, 0 N, from 0.8 s for 0.2 s": "{kind: value, value: 0.0, start: 0.8, duration: 0.2}",
    "`value`, 0 N, from 1 s": "{kind: value, value: 0.0, start: 1.0}",
    "`frozen`, from 0.3 s": "{kind: frozen, start: 0.3}",
    "`scale`, -1, from 1 s": "{kind: scale, value: -1.0, start: 1.0}",
    "`noise`, 0.5 N, from 1 s": "{kind: noise, value: 0.5, start: 1.0}",
    "`lost`, all of the time": "{kind: lost}",
}


def test_every_row_is_judged():
    assert set(ROWS) == set(FAULTS)
    assert FAULT in SCENARIO


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_what_a_fault_comes_to(name):
    log = fc.run(parse(SCENARIO.replace(FAULT, FAULTS[name]), "faulted.yaml")).log
    peak, status = re.findall(r"[\d.]+", ROWS[name])
    assert float(log["contact_force"].max()) == pytest.approx(float(peak), abs=0.1)
    assert int(log["status"][-1]) == int(status)
