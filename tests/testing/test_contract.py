"""Ports and feedthrough of a block against its contract; every deviation is reported."""

import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import Adder, Gain, LinearSystem, PassThrough

from forcectl.testing import assert_feedthrough, assert_ports


def test_the_exact_contract_passes():
    assert_ports(Adder(2, 3), inputs={"u0": 3, "u1": 3}, outputs={"sum": 3})
    assert_ports(LeafSystem(), {}, {})
    assert_ports(PassThrough(abstract_model_value=Value(object())), {"u": "abstract"}, {"y": "abstract"})


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        ({"u0": 3}, {"sum": 3}, r"input 'u1' \(size 3\) is not in the contract"),
        ({"u0": 3, "u1": 3, "u2": 3}, {"sum": 3}, r"input 'u2' is missing \(contract: size 3\)"),
        ({"u0": 3, "u1": 2}, {"sum": 3}, "input 'u1' has size 3, contract: size 2"),
        ({"u0": 3, "u1": 3}, {"sum": "abstract"}, "output 'sum' has size 3, contract: abstract"),
        ({"u0": 3, "u1": 3}, {}, r"output 'sum' \(size 3\) is not in the contract"),
    ],
)
def test_every_deviation_is_told(inputs, outputs, message):
    with pytest.raises(AssertionError, match=message):
        assert_ports(Adder(2, 3), inputs, outputs)


def test_feedthrough_is_compared_exactly():
    both = {("sum", "u0"), ("sum", "u1")}
    assert_feedthrough(Adder(2, 1), both)
    assert_feedthrough(LinearSystem([[0.0]], [[1.0]], [[1.0]], [[0.0]]), set())
    with pytest.raises(AssertionError, match="sum <- u1 is too many"):
        assert_feedthrough(Adder(2, 1), {("sum", "u0")})
    with pytest.raises(AssertionError, match="y0 <- u0 is missing"):
        assert_feedthrough(LinearSystem([[0.0]], [[1.0]], [[1.0]], [[0.0]]), {("y0", "u0")})


def test_a_pair_in_the_wrong_order_is_told():
    with pytest.raises(AssertionError, match=r"\('u0', 'y0'\): no such output; outputs \['y0'\], inputs \['u0'\]"):
        assert_feedthrough(Gain(1.0, 1), {("u0", "y0")})


def test_an_input_that_an_output_reads_without_saying_so_is_told():
    class Hidden(LeafSystem):
        def __init__(self):
            super().__init__()
            port = self.DeclareVectorInputPort("u", 1)
            self.DeclareVectorOutputPort(
                "y", 1, lambda context, out: out.SetFromVector(port.Eval(context)), {self.time_ticket()}
            )

    with pytest.raises(AssertionError, match=r"Hidden\.y changes with u within one instant"):
        assert_feedthrough(Hidden(), set())
