"""Diagrams that the tests of block graphs draw."""

import itertools

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.controllers import InverseDynamicsController
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    DiscreteTimeDelay,
    Gain,
    Integrator,
    LinearSystem,
    LogVectorOutput,
    MatrixGain,
    Multiplexer,
    Saturation,
    ZeroOrderHold,
)

ARM = """<robot name="arm"><link name="base"/><link name="link"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
<limit effort="10"/></joint><transmission><type>transmission_interface/SimpleTransmission</type>
<joint name="joint"/><actuator name="motor"/></transmission></robot>"""


class ForceLaw(LeafSystem):
    """The ports of a sampled integral action; its update does nothing.

    Parameters: integral_gain K_I [1/s], compliance C_T [m/N].

    Attributes:
        parameters: [integral_gain, compliance]
    """

    def __init__(self, period: float = 0.002) -> None:
        super().__init__()
        self.DeclareVectorInputPort("desired_force", 1)
        self.DeclareVectorInputPort("measured_force", 1)
        self.DeclareNumericParameter(BasicVector([3.0]))
        self.DeclareNumericParameter(BasicVector([3.2e-5]))
        self.DeclareStateOutputPort("displacement_command", self.DeclareDiscreteState(1))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _update(self, *_: object) -> None:
        """Changes nothing."""


class Station(Diagram):
    """Position loop, spring, one-sided contact and force sensor in one row."""

    def __init__(self) -> None:
        super().__init__()
        builder = DiagramBuilder()
        w = 75.4
        loop = LinearSystem([[0, 1], [-w * w, -2 * w]], [[0], [w * w]], [[1, 0]], [[0]])
        sensor = LinearSystem([[-300.0]], [[300.0]], [[1]], [[0]])
        row = [("position_loop", loop), ("contact_stiffness", Gain(-25000.0, 1))]
        row += [("one_sided", Saturation([0.0], [1e4])), ("force_sensor", sensor)]
        for name, system in row:
            builder.AddNamedSystem(name, system)
        for (_, first), (_, second) in itertools.pairwise(row):
            builder.Connect(first.get_output_port(), second.get_input_port())
        builder.ExportInput(loop.get_input_port(), "displacement_command")
        builder.ExportOutput(sensor.get_output_port(), "measured_force")
        builder.ExportOutput(row[2][1].get_output_port(), "contact_force")
        builder.ExportOutput(loop.get_output_port(), "contact_displacement")
        builder.BuildInto(self)


def force_loop() -> Diagram:
    """Reference, force law and station, one signal logged, one exported."""
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", Station())
    reference = builder.AddNamedSystem("reference", ConstantVectorSource([15.0]))
    law = builder.AddNamedSystem("force_law", ForceLaw())
    builder.Connect(reference.get_output_port(), law.GetInputPort("desired_force"))
    builder.Connect(station.GetOutputPort("measured_force"), law.GetInputPort("measured_force"))
    builder.Connect(law.get_output_port(), station.get_input_port())
    LogVectorOutput(station.GetOutputPort("contact_displacement"), builder, 0.002).set_name("log")
    builder.ExportOutput(station.GetOutputPort("contact_force"), "contact_force")
    diagram = builder.Build()
    diagram.set_name("closed_loop")
    return diagram


def primitive_loop() -> Diagram:
    """The same loop from Drake's primitives only: sum, gains, integrator, hold, delay, multiplexers."""
    builder = DiagramBuilder()
    add = builder.AddNamedSystem
    reference, error = add("reference", ConstantVectorSource([15.0])), add("error", Adder(2, 1))
    minus, gain = add("minus", Gain(-1.0, 1)), add("gain", Gain(-0.00012, 1))
    integral, hold = add("integral", Integrator(1)), add("hold", ZeroOrderHold(0.002, 1))
    plant, delay = add("plant", MatrixGain(np.array([[-2.5e4]]))), add("delay", DiscreteTimeDelay(0.002, 3, 1))
    mux, demux = add("mux", Multiplexer([1, 1])), add("demux", Demultiplexer(2, 1))
    builder.Connect(reference.get_output_port(), error.get_input_port(0))
    builder.Connect(minus.get_output_port(), error.get_input_port(1))
    for first, second in ((error, gain), (gain, integral), (integral, hold), (hold, plant), (plant, delay)):
        builder.Connect(first.get_output_port(), second.get_input_port())
    builder.Connect(delay.get_output_port(), mux.get_input_port(0))
    builder.Connect(plant.get_output_port(), mux.get_input_port(1))
    builder.Connect(mux.get_output_port(), demux.get_input_port())
    builder.Connect(demux.get_output_port(0), minus.get_input_port())
    builder.ExportOutput(demux.get_output_port(1), "force")
    diagram = builder.Build()
    diagram.set_name("primitives")
    return diagram


def arm_with_controller() -> Diagram:
    """A plant and its scene graph under inverse dynamics control."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    model = Parser(plant).AddModelsFromString(ARM, "urdf")[0]
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    controller = builder.AddNamedSystem("controller", InverseDynamicsController(plant, [100.0], [1.0], [20.0], False))
    desired = builder.AddNamedSystem("desired state", ConstantVectorSource([0.1, 0.0]))
    builder.Connect(plant.get_state_output_port(model), controller.GetInputPort("estimated_state"))
    builder.Connect(desired.get_output_port(), controller.GetInputPort("desired_state"))
    builder.Connect(controller.GetOutputPort("generalized_force"), plant.get_actuation_input_port())
    diagram = builder.Build()
    diagram.set_name("inverse dynamics")
    return diagram


class Odd(LeafSystem):
    """Ports with characters that every format must escape."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort('in "a" <b>', Value[object]())
        self.DeclareVectorInputPort("x|{y}", 3)
        self.DeclareAbstractOutputPort("list & dict", lambda: Value[object](), self._nothing)
        independent = {self.nothing_ticket()}
        self.DeclareVectorOutputPort("v", 3, self._nothing, prerequisites_of_calc=independent)

    def _nothing(self, context: Context, output: object) -> None:
        """Leaves the output as allocated."""


def odd_names() -> Diagram:
    """Unnamed systems, and names with quotes, brackets, an ampersand and a closing tag."""
    builder = DiagramBuilder()
    first = builder.AddNamedSystem('block "A" <1> & </script>', Odd())
    second, third = builder.AddSystem(Odd()), builder.AddSystem(Odd())
    builder.Connect(first.get_output_port(0), second.get_input_port(0))
    builder.Connect(first.get_output_port(1), second.get_input_port(1))
    builder.Connect(second.get_output_port(0), third.get_input_port(0))
    builder.Connect(third.get_output_port(1), first.get_input_port(1))
    builder.ExportInput(first.get_input_port(0), "in & out")
    return builder.Build()


def random_diagram(count: int, seed: int) -> Diagram:
    """Blocks with random wires, some of them closing loops."""
    rng = np.random.default_rng(seed)
    builder = DiagramBuilder()
    blocks = []
    for number in range(count):
        inputs, outputs = int(rng.integers(1, 4)), int(rng.integers(1, 4))
        system = LinearSystem([[-1.0]], np.ones((1, inputs)), np.ones((outputs, 1)), np.zeros((outputs, inputs)))
        mux, demux = Multiplexer([1] * inputs), Demultiplexer(outputs, 1)
        inner = DiagramBuilder()
        for name, part in (("mux", mux), ("dynamics", system), ("demux", demux)):
            inner.AddNamedSystem(name, part)
        inner.Connect(mux.get_output_port(), system.get_input_port())
        inner.Connect(system.get_output_port(), demux.get_input_port())
        for i in range(inputs):
            inner.ExportInput(mux.get_input_port(i), f"input_{i}")
        for i in range(outputs):
            inner.ExportOutput(demux.get_output_port(i), f"output_{i}")
        blocks.append(builder.AddNamedSystem(f"block_{number}", inner.Build()))
    for number, block in enumerate(blocks):
        for i in range(block.num_input_ports()):
            if rng.random() < 0.85:
                near = int(np.clip(number + rng.integers(-4, 3), 0, count - 1))
                source = blocks[near]
                builder.Connect(
                    source.get_output_port(int(rng.integers(source.num_output_ports()))), block.get_input_port(i)
                )
    diagram = builder.Build()
    diagram.set_name("random")
    return diagram


ALL = {
    "force_loop": force_loop,
    "primitive_loop": primitive_loop,
    "arm_with_controller": arm_with_controller,
    "odd_names": odd_names,
    "single_leaf": ForceLaw,
}
