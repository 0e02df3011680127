"""docs/blocks.md: its diagrams are built and do what the page says, its table names the ports that the blocks have."""

import importlib
import inspect
import re
import sys

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

import forcectl as fc
from forcectl.estimation import MomentumObserver
from forcectl.force import AdmittanceFilter, IntegralForceLaw, LinearIntegralForceLaw
from forcectl.motion import TrajectoryGenerator
from forcectl.plant import ForceSensor, LinearContact, PositionLoop
from forcectl.testing import assert_same_after_reset_and_clone, run_diagram
from tests.examples.block_docs import BlockDoc
from tests.examples.pages import blocks, page_text

PAGE = page_text("blocks.md")
CODE = blocks(PAGE, "python")
FILES = {found[1]: code for code in CODE if (found := re.match(r"# (my_\w+)\.py\n", code))}
SCRIPTS = [code for code in CODE if code not in FILES.values()]
DIAGRAMS = [name for name, code in FILES.items() if "\ndef build(" in code]
ROWS = re.findall(r"^\| `(\w+)` \| (.+?) \| (.*?) \| (.+?) \| (sampled|read) \|$", PAGE, re.MULTILINE)


@pytest.fixture
def modules(tmp_path, monkeypatch):
    for name, code in FILES.items():
        (tmp_path / f"{name}.py").write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield importlib.import_module
    for name in FILES:
        sys.modules.pop(name, None)


@pytest.mark.slow
def test_the_scripts_print_what_is_shown(modules, capsys, tmp_path):
    names: dict[str, object] = {}
    for script in SCRIPTS:
        exec(compile(script, "docs/blocks.md", "exec"), names)
    assert capsys.readouterr().out == "".join(blocks(PAGE, "text"))
    assert (tmp_path / "slide.png").stat().st_size > 2000


@pytest.mark.parametrize("name", DIAGRAMS)
def test_the_doctor_finds_nothing_wrong(modules, name):
    report = fc.check(modules(name).build())
    assert report.errors == report.warnings == ()


@pytest.mark.slow
def test_the_arm_presses_with_the_force_and_the_guard_passes_it_on(modules):
    diagram = modules("my_pressing").build()
    log = run_diagram(diagram, 5.0, period=0.002)
    assert log["contact_force"][0] == 0.0  # it starts above the table
    assert log["contact_force"][-1, 0] == pytest.approx(10.0, abs=0.05)
    assert log["contact_force"].max() < 10.05
    assert not log["status"].any()


@pytest.mark.parametrize("name", ["my_slide", "my_cell"])
def test_a_reset_context_gives_the_same_run(modules, name):
    assert_same_after_reset_and_clone(modules(name).build(), duration=0.1, period=0.002)


def test_another_context_gives_the_same_run(modules):
    diagram = modules("my_pressing").build()
    first, second = (run_diagram(diagram, 0.1, period=0.002)["contact_force"] for _ in range(2))
    assert first[-1] > 0.0
    np.testing.assert_array_equal(first, second)


def contact_force(diagram: Diagram, simulator: Simulator) -> np.ndarray:
    """Of the table on the ball, in the world [N]."""
    plant = diagram.GetSubsystemByName("plant")
    results = plant.get_contact_results_output_port().Eval(plant.GetMyContextFromRoot(simulator.get_context()))
    assert results.num_hydroelastic_contacts() == 1
    return results.hydroelastic_contact_info(0).F_Ac_W().translational()


@pytest.mark.slow
def test_the_observer_shows_the_contact_force_its_lag_later(modules):
    diagram = modules("my_feeling").build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.98)
    before = contact_force(diagram, simulator)
    simulator.AdvanceTo(1.0)  # 1/gain later
    wrench = diagram.GetOutputPort("wrench").Eval(simulator.get_context())
    assert before[2] > 30.0
    np.testing.assert_allclose(wrench[3:], before, atol=0.02)


@pytest.mark.parametrize("fidelity", ["Kinematic", "OneDimensional"])
def test_drake_s_blocks_press_with_the_station(modules, fidelity):
    log = run_diagram(modules("my_cell").build(fidelity), 4.0, period=0.002)
    assert log["contact_force"][-1, 0] == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize(("room", "blocks", "inputs", "outputs", "ticks"), ROWS, ids=[row[1] for row in ROWS])
def test_the_table_names_the_ports_of_the_blocks(room, blocks, inputs, outputs, ticks):
    for name in re.findall(r"`(\w+)`", blocks):
        kind = getattr(importlib.import_module(f"forcectl.{room}"), name)
        doc = BlockDoc(kind, {})
        for side, cell in (("input_ports", inputs), ("output_ports", outputs)):
            listed = [_shown(port, getattr(kind, "optional_inputs", ())) for port in doc.listed[side]]
            shown = [port for port in cell.split(", ") if port]
            if shown[-1:] == ["…"]:
                assert listed[: len(shown) - 1] == shown[:-1]
            else:
                assert listed == shown
        assert ticks == ("sampled" if doc.periods else "read")


def _shown(port: str, may_be_open: tuple[str, ...]) -> str:
    """How the table writes a port of the list in a docstring."""
    name = port.removesuffix(" (optional)")
    return f"`{name}`" + "?" * (name != port or name in may_be_open)


def test_default_periods_are_those_of_the_page():
    fast, slow = (IntegralForceLaw, ForceSensor), (MomentumObserver, TrajectoryGenerator, AdmittanceFilter)
    periods = [inspect.signature(block).parameters["period"].default for block in (*fast, *slow)]
    assert periods == [0.002] * len(fast) + [0.004] * len(slow)


@pytest.mark.parametrize(
    "block",
    [
        LinearIntegralForceLaw(1, integral_gain=1.0, compliance=1e-4),
        PositionLoop(1),
        LinearContact(1, stiffness=1e4),
        ForceSensor(1),
    ],
    ids=lambda block: type(block).__name__,
)
def test_what_the_page_says_converts(block):
    assert block.ToAutoDiffXd().num_input_ports() == block.num_input_ports()


def test_the_table_is_there():
    assert len(ROWS) >= 15
