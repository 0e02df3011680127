"""The reader of docstrings that the contract test stands on: what it finds, and what it finds missing."""

import pytest
from pydrake.systems.framework import LeafSystem

from tests.examples.block_docs import BlockDoc, Statement

DOC = """A block.

```
name: Block
input_ports: [force, position (optional), (further inputs of the law)]
output_ports: [command, wrench, held, rest]
```

force: shape (n,), along n [N]. position: shape (n,) [rad] or [m].
command, held: shape (n,), over [t_k, t_k+1) [m, m/s]; see [57]. Feedthrough of force at the tick.
wrench: shape (6,), [torque; force] in S [Nm, N]. Feedthrough of all inputs but force. Feedthrough of force when `near`.
rest: see `Other`.

Sampling: every `period` [s] the law; every `slow` [s] the rest; no delay from force to command.
"""
OTHER = """Another.

```
name: Other
output_ports: [rest]
```

rest: shape (1,) [m or rad, m/s or rad/s]. All outputs are state, no direct feedthrough.
"""


def read(text: str = DOC) -> BlockDoc:
    other = type("Other", (LeafSystem,), {"__doc__": OTHER})
    block = type("Block", (LeafSystem,), {"__doc__": text})
    return BlockDoc(block, {"Block": block, "Other": other})


@pytest.mark.parametrize(
    ("name", "units"),
    [
        ("force", {"N"}),
        ("position", {"rad", "m"}),
        ("command", {"m"}),
        ("held", {"m/s"}),
        ("wrench", {"Nm,N"}),
        ("rest", {"m,m/s", "rad,rad/s"}),
        ("unheard_of", set()),
    ],
)
def test_units(name, units):
    assert read().units(name) == units


def test_a_bracket_that_holds_more_than_units_is_none():
    assert read(DOC.replace("[m, m/s]; see [57]", "(3, 4) [57]")).units("command") == set()


def test_sizes():
    sizes = {"force": 2, "position": 2, "command": 2, "held": 2, "wrench": 6, "rest": 5}
    assert read().wrong_sizes(sizes) == {}
    assert read().wrong_sizes(sizes | {"held": 3, "wrench": 5, "rest": 4}) == {"held": "n", "wrench": "6"}
    wider = read(DOC.replace("held: shape (n,)", "held: shape (2n + 1,) or (3n,)"))
    assert wider.wrong_sizes({"force": 2, "command": 6}) == wider.wrong_sizes({"command": 5, "force": 2}) == {}
    assert wider.wrong_sizes({"force": 2, "command": 2}) == {"command": "2n + 1 or 3n"}
    apart = read(DOC.replace("held: shape (n,)", "held: shape (3n,), (4n,)"))
    assert apart.wrong_sizes({"force": 2, "command": 6, "held": 6}) == {"held": "4n"}


def test_ports_with_optional_and_further_ones():
    assert read().ports("input_ports", ["force", "mode"]) == ["force", "mode"]
    assert read().ports("input_ports", ["force", "position"]) == ["force", "position"]
    assert read().ports("output_ports", ["command"]) == ["command", "wrench", "held", "rest"]


def test_feedthrough():
    found = read().feedthrough(["force", "position"], ["command", "wrench", "rest"])
    assert found["command"] == Statement(frozenset({"force"}))
    assert found["wrench"] == Statement(frozenset({"position"}), frozenset({"force"}))
    assert found["rest"] is None
    everywhere = DOC.replace("rest: see `Other`.", "All outputs are state, no direct feedthrough.")
    assert read(everywhere).feedthrough(["force"], ["rest"]) == {"rest": Statement()}


def test_feedthrough_of_what_is_no_input_is_refused():
    with pytest.raises(AssertionError, match=r"feedthrough of .'speed'., which are no inputs"):
        read(DOC.replace("Feedthrough of force at", "Feedthrough of speed at")).feedthrough(["force"], ["command"])


def test_sampling():
    assert read().periods == ["period", "slow"]
    assert read().undelayed == [("command", "force")]
    assert read(DOC.replace("Sampling:", "Every tick:")).sampling == ""
