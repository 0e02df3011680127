"""docs/compliant_tasks.md says what is true."""

import dataclasses
import re
from dataclasses import dataclass

from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import parse
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, ReferenceConfig, mode_references
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from tests.examples.pages import blocks, page_text, run_python

PAGE = page_text("compliant_tasks.md")


@dataclass
class Said:
    references: dict[str, dict[str, ReferenceConfig]]


def test_the_code_prints_what_is_shown_and_the_references_fit_its_task(capsys):
    names = run_python("compliant_tasks.md")
    assert [capsys.readouterr().out] == blocks(PAGE, "text")
    (text,) = blocks(PAGE, "yaml")
    said = Reader().dataclass(Said, parse(text, "page")).references
    gains, limits = AdmittanceGainsConfig(), MotionLimitsConfig()
    made = mode_references(said, {"peg": names["peg"]}, gains=gains, limits=limits, period=0.004)
    assert made.comply.tolist() == [True, True, False, True, True]


def test_every_key_of_a_reference_is_told():
    table = PAGE.split("| key | says |")[1].split("\n\n")[0]
    told = set(re.findall(r"`(\w+)`", table))
    assert {field.name for field in dataclasses.fields(ReferenceConfig)} <= told
