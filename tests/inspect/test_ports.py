import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import PassThrough

import tests.examples.broken_diagrams as broken_diagrams
from forcectl.errors import BadInputError
from forcectl.framework.wiring import input_names, output_names
from forcectl.inspect.ports import find_inputs, find_outputs, one_output, unit, value_type
from forcectl.inspect.wiring import PortAddress, Wiring
from tests.examples.graph_diagrams import arm_with_controller, force_loop


def test_a_port_is_found_by_its_name_its_path_or_both_in_a_pair():
    wiring = Wiring(force_loop())
    sensor = PortAddress("output", "station/force_sensor", 0)
    for name in ("measured_force", "station.measured_force", ("station", "measured_force"), "station/force_sensor.y0"):
        assert find_outputs(wiring, name) == [sensor]
    assert find_inputs(wiring, "measured_force") == [PortAddress("input", "force_law", 1)]
    # No output has that name, but it feeds an input that has.
    assert one_output(wiring, "desired_force") == PortAddress("output", "reference", 0)


def test_of_a_thousand_ports_only_the_nearest_are_listed():
    with pytest.raises(BadInputError) as error:
        one_output(Wiring(arm_with_controller()), "plant.generalised_acceleration")
    assert str(error.value).startswith("unknown port 'plant.generalised_acceleration': must be block.port, nearest: ")
    assert "plant.generalized_acceleration" in str(error.value)
    assert len(str(error.value)) < 250
    with pytest.raises(BadInputError, match="nearest: none; `forcectl graph` shows the ports"):
        one_output(Wiring(broken_diagrams.healthy()), "xyz")


def test_units_and_value_types_of_ports():
    class Motor(LeafSystem):
        port_units = {"current": "A"}

        def __init__(self):
            super().__init__()
            self.DeclareVectorInputPort("current", 3)
            self.DeclareVectorInputPort("measured_force", 1)
            self.DeclareAbstractInputPort("pose", Value(object()))

    motor = Motor()
    motor.set_name("motor")
    wiring = Wiring(motor)
    assert [unit(wiring, PortAddress("input", "motor", i)) for i in range(3)] == ["A", "N", ""]
    assert (input_names(motor), output_names(motor)) == (["current", "measured_force", "pose"], [])
    assert value_type(motor.get_input_port(0)) == ""
    assert value_type(motor.get_input_port(2)) == "object"
    assert value_type(PassThrough(abstract_model_value=Value("text")).get_output_port()) == "str"
