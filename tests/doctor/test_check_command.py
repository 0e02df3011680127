"""`forcectl check` and `forcectl graph` on scenarios, on diagrams of the user's, and on single blocks."""

import re
import sys

import pytest
from pydrake.systems.primitives import Gain

import forcectl as fc
from forcectl.doctor import examine

MODULE = """
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, ZeroOrderHold


def block():
    return ZeroOrderHold(0.002, 2)


def loop():
    builder = DiagramBuilder()
    blocks = [builder.AddSystem(block) for block in (Gain(-0.5, 1), ZeroOrderHold(0.01, 1), Gain(2.0, 1))]
    for one, next_one in zip(blocks, [*blocks[1:], blocks[0]]):
        builder.Connect(one.get_output_port(), next_one.get_input_port())
    return builder.Build()
"""

DRIVE = """
import numpy as np
from pydrake.systems.framework import LeafSystem


class Ideal(LeafSystem):
    def __init__(self, size, inputs):
        super().__init__()
        command, *_ = [self.DeclareVectorInputPort(name, n) for name, n in inputs.items()]
        self.DeclareVectorOutputPort("motor_position", size, lambda c, out: out.SetFromVector(command.Eval(c)))
        self.DeclareVectorOutputPort("motor_velocity", size, lambda c, out: out.SetFromVector(np.zeros(size)))


class Drive:
    def __init__(self, further=()):
        self.further = further

    def add_to(self, builder, site):
        size = site.workcell.num_joints
        inputs = {"joint_position_command": size} | dict.fromkeys(self.further, 1)
        return builder.AddNamedSystem("ideal", Ideal(size, inputs))
"""
LOOPS = {  # inputs of the drive that need what it puts out, and what the path shows of it
    "": "station/ideal.joint_position_command -> station/ideal.motor_position -> station/contact.motor_position",
    "contact_force": "ideal.contact_force -> ideal.motor_position -> contact.motor_position -> contact.contact_force",
}


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "my_blocks.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    return "my_blocks"


def test_the_whole_loop_of_a_scenario_is_shown_with_its_dead_time(forcectl):
    code, out, _ = forcectl("check", "fig_2_7", "--fidelity", "OneDimensional")
    assert code == 0
    ways = re.findall(r"Delay (\S+) -> (\S+)", out)
    assert [start.rpartition(".")[2] for start, _ in ways] == [
        "joint_position_command",
        "contact_force",
        "measured_force",
    ]
    assert "Dead time once around the loop: 0.004 + 0 + 0 = 0.004 s" in out


def test_ports_are_given_by_name(forcectl, module):
    code, out, _ = forcectl("check", f"{module}:loop", "--from", "Gain 1.y0", "--to", "Gain 2.y0")
    assert code == 0
    assert "Delay Gain 1.y0 -> Gain 2.y0" in out
    assert "Dead time once around the loop: 0 + 0.01 = 0.01 s" in out
    assert out.endswith(f"runs code that is not forcectl's own: {module}:loop\n")


@pytest.mark.parametrize("option", ["--from", "--to"])
def test_an_unknown_port_is_one_line_with_the_nearest(forcectl, option):
    other = {"--from": "--to", "--to": "--from"}[option]
    code, _, err = forcectl("check", "fig_2_7", option, "station.mesured_force", other, "station.contact_force")
    assert code == 2
    assert re.fullmatch(r"error: unknown port 'station.mesured_force': .*nearest: station.measured_force, .*\n", err)
    assert len(err) < 250


def test_a_single_block_is_checked_and_drawn(forcectl, module, tmp_path):
    code, out, _ = forcectl("check", f"{module}:block", "--from", "u", "--to", "y")
    assert code == 0
    assert re.search(r"total .* 0\.002 ", out)
    assert forcectl("graph", f"{module}:block", "--out", tmp_path / "block.svg")[0] == 0
    assert "ZeroOrderHold" in (tmp_path / "block.svg").read_text()


def test_check_and_graph_call_the_blocks_alike(forcectl, module, tmp_path):
    _, out, _ = forcectl("check", f"{module}:loop", "--verbose")
    forcectl("graph", f"{module}:loop", "--format", "html", "--out", tmp_path / "loop.html")
    page = (tmp_path / "loop.html").read_text()
    for name in ("Gain 1", "ZeroOrderHold", "Gain 2"):
        assert name in out
        assert f'"path":"{name}"' in page


def test_the_scheme_is_looked_at(forcectl):
    assert forcectl("check", "fig_2_7", "--fidelity", "Multibody", "--scheme", "runge_kutta3")[0] == 0
    code, out, _ = forcectl("check", "fig_2_7", "--fidelity", "Multibody", "--scheme", "cenic")
    assert code == 1
    assert "cenic-desired-velocity" in out
    assert "station/plant.comau_smart_six_desired_state" in out


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ("{controller.integral_gian: 3.0}", "own.yaml:4: variant 'b': controller.integral_gian: unknown key"),
        # What only a build finds: each value is fine by itself.
        ("{station.sensors.force.range: 5.0}", "own.yaml:4: variant 'b': reference.force = 15.0: must be at most"),
    ],
)
def test_variants_that_are_not_examined_must_be_such_that_they_can_be_built(tmp_path, monkeypatch, second, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text(
        f"station: {{fidelity: OneDimensional}}\nvariants:\n  a: {{}}\n  b: {second}\n", encoding="utf-8"
    )
    with pytest.raises(fc.BadInputError, match=f"^{re.escape(said)}"):
        fc.check("own.yaml")
    assert fc.check("own.yaml", variant="a").ok


def test_a_reference_that_the_controller_of_some_variant_does_not_take_is_told(forcectl, tmp_path):
    (tmp_path / "moves.yaml").write_text(
        "variants: {presses: {}, moves: {controller: !JointMoves {}}}\nreference: !Step {force: 5}\n"
    )
    code, out, _ = forcectl("check", "moves.yaml")
    assert code == 0
    assert out.splitlines()[-1] == "info: reference has no effect: the controller takes no desired force"


@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize("further", LOOPS)
def test_a_loop_without_a_hold_is_one_line_with_every_block_on_it(forcectl, tmp_path, monkeypatch, command, further):
    (tmp_path / "ideal_drive.py").write_text(DRIVE)
    file = tmp_path / "loop.yaml"
    drive = f"!Import {{path: 'ideal_drive:Drive', parameters: {{further: [{further}]}}}}"
    file.write_text(f"station: {{fidelity: Kinematic, drive: {drive}}}\nduration: 0.1\n")
    monkeypatch.syspath_prepend(tmp_path)
    code, _, err = forcectl(command, str(file), "--allow-imports", "ideal_drive")
    line = err.strip()
    assert (code, line.count("\n")) == (2, 0)
    path = line.partition("algebraic loop: ")[2].partition("; break it with a block that holds its output")[0]
    assert LOOPS[further] in path
    assert path.split(" -> ")[0] == path.split(" -> ")[-1]


OWN = """
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Gain


def ring(builder):
    first, second = (builder.AddNamedSystem(name, Gain(1.0, 1)) for name in ("a", "b"))
    builder.Connect(first.get_output_port(), second.get_input_port())
    builder.Connect(second.get_output_port(), first.get_input_port())


class Kept(Diagram):
    def __init__(self):
        super().__init__()
        self.parts = DiagramBuilder()
        ring(self.parts)
        self.parts.BuildInto(self)


def built():
    builder = DiagramBuilder()
    ring(builder)
    return builder.Build()


def kept():
    builder = DiagramBuilder()
    builder.AddNamedSystem("inner", Kept())
    return builder.Build()


class Config:
    def add_to(self, builder, model):
        return builder.AddNamedSystem("law", built())
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "own_rings.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_rings", raising=False)  # that of another test
    return "own_rings"


@pytest.mark.parametrize("command", ["check", "graph"])
@pytest.mark.parametrize("function", ["built", "kept"])
def test_a_loop_that_a_build_of_the_users_refuses_is_a_path(forcectl, own, command, function):
    code, _, err = forcectl(command, f"{own}:{function}")
    path = f"diagram = '{own}:{function}': algebraic loop: a.y0 -> b.u0 -> b.y0 -> a.u0 -> a.y0; break it"
    assert code == 2
    assert err.startswith(f"error: {path}")


def test_a_loop_inside_of_a_part_of_the_users_is_a_path(forcectl, own, tmp_path):
    file = tmp_path / "loop.yaml"
    file.write_text(f"station: {{fidelity: OneDimensional}}\ncontroller: !Import {{path: '{own}:Config'}}\n")
    code, _, err = forcectl("check", file, "--allow-imports", own)
    assert code == 2
    assert "loop.yaml:2: controller: algebraic loop: a.y0 -> b.u0 -> b.y0 -> a.u0 -> a.y0; break it" in err


@pytest.mark.parametrize("look", [fc.graph, examine, fc.check])
def test_another_scalar_type_is_named(look):
    with pytest.raises(fc.BadInputError, match="Gain of AutoDiffXd, where double is needed"):
        look(Gain(1.0, 1).ToAutoDiffXd())


def test_a_misspelt_function_is_told_with_the_names_that_the_module_defines(forcectl, own, tmp_path):
    (tmp_path / "own_rings.py").write_text("from pydrake.systems.primitives import *\n" + OWN)
    code, _, err = forcectl("check", f"{own}:bilt")
    assert code == 2
    assert "unknown name in own_rings 'bilt': did you mean 'built'? known: " in err
    assert ("built" in err.partition("known: ")[2], "Adder" in err) == (True, False)
    assert len(err) < 400
