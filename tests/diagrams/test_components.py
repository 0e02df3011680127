"""Components of logged signals have the names of what they are, whatever their number."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

import forcectl as fc
from forcectl.conventions import Components
from forcectl.framework.block import of_ports

READINGS = {"joint_position": 6}


class Part:
    """An estimator with the output `mine`, of as many numbers as the robot has joints."""

    def __init__(self, components: Any = None, size: int = 6):
        self.components, self.size = components, size

    def add_to(self, builder: Any, model: Any) -> Any:
        block = builder.AddNamedSystem("mine", LeafSystem())
        block.DeclareVectorInputPort("motor_position", 6)
        value = np.arange(float(self.size))
        block.DeclareVectorOutputPort("mine", self.size, lambda c, o: o.SetFromVector(value), {block.nothing_ticket()})
        if self.components is not None:
            block.port_components = {"mine": self.components}
        return block


def built(part: Part) -> Any:
    estimators = {"mine": part}
    scenario = {"station": {"fidelity": "Kinematic"}, "estimators": estimators, "duration": 0.02}
    return fc.build(scenario).signals["mine"]


def test_a_signal_of_as_many_numbers_as_joints_is_not_one_of_the_joints_unless_its_block_says_so() -> None:
    plain = built(Part())
    assert (plain.dimension, plain.labels) == ("mine_component", tuple("123456"))
    named = built(Part("n"))
    assert (named.dimension, named.labels[0]) == ("joint", "joint_1")
    units = ("m", "m", "m", "rad", "rad", "rad")
    own = built(Part(Components("pose", ("x", "y", "z", "a", "b", "c"), units)))
    assert (own.dimension, own.labels[3], own.unit, own.units) == ("pose", "a", "m,rad", units)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Part("n", 5), r"block 'mine_estimator': port_components: mine has size 5: must be 6 \(n\)"),
        (Part("q"), r"mine = 'q': must be one of 1, .*, n, or Components\(dimension, labels, units\)$"),
        (Part("N", 1), "mine = 'N': must be one of 1, "),
        (Part(["n"]), r"mine = \['n'\]: must be one of 1, "),
        (Part(Components(("x",), ("N",)), 1), r"mine = Components\(dimension=\('x',\).*: must be one of 1, "),  # type: ignore[arg-type]
        (Part(Components("x", ("a", "b"), ("N",)), 2), r"mine = Components\(.*: must be one of 1, "),
        (
            Part(Components("joint", tuple("abcdef"))),
            r"mine has the dimension joint: must be of joint_1, ",
        ),
    ],
)
def test_what_a_block_says_of_its_port_must_fit(part: Part, message: str) -> None:
    with pytest.raises(fc.BadInputError, match=message):
        built(part)


def test_components_that_are_no_mapping_are_refused_of_their_block() -> None:
    block = LeafSystem()
    block.set_name("mine")
    block.port_components = ["n"]
    with pytest.raises(fc.BadInputError, match=r"^block 'mine': port_components = \['n'\]: must be a mapping"):
        of_ports(block, "port_components")


@pytest.mark.parametrize("name", ["cap_rotation", "fig_6_10", "fig_5_3", "force_estimation"])
def test_every_component_of_a_robot_with_two_arms_has_a_name(name: str) -> None:
    signals = fc.load_scenario(name).build().signals
    assert [each for each, signal in signals.items() if signal.labels and signal.labels[0] == "1"] == []


def test_components_of_tasks_are_those_of_the_tasks_in_their_order_and_not_of_the_arms() -> None:
    loop = fc.load_scenario("cap_rotation").build()
    names = list(loop.setting.workcell.robot.parts.arms)
    tasks = list(dict.fromkeys(label.split(".")[0] for label in loop.signals["task_wrench"].labels or ()))
    assert tasks == ["cap", "leader"]
    assert names == ["left", "right"]
    assert loop.signals["task_wrench"].labels[3] == "cap.force_x"
    assert loop.signals["task_position"].labels[:4] == ("cap.x", "cap.y", "cap.z", "cap.phi")
    assert loop.signals["task_position"].unit == "m,rad"
    assert loop.signals["part_position"].labels[0] == "cap_x"
    assert loop.signals["part_released"].labels == ("cap", "mount")
