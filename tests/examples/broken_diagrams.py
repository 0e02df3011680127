"""Small force loops, each with one planted fault, and the healthy one they are made from.

`FAULTS` maps a name to (build function, code the doctor must report, text its path or message must hold).
"""

from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, DiscreteValues, LeafSystem
from pydrake.systems.primitives import Adder, DiscreteTimeDelay, Gain, ZeroOrderHold

PERIOD = 0.002  # [s]


class Hold(LeafSystem):
    """Adds `gain` times its input to its memory, once per period; the output is the memory."""

    def __init__(
        self,
        input_name: str = "measured_force",
        output_name: str = "displacement_command",
        *,
        gain: float = 1e-6,
        period: float = PERIOD,
        offset: float = 0.0,
        start: float = 0.0,
    ):
        super().__init__()
        self._gain = gain
        self._input = self.DeclareVectorInputPort(input_name, 1)
        memory = self.DeclareDiscreteState([start])
        self.DeclareStateOutputPort(output_name, memory)
        self.DeclarePeriodicDiscreteUpdateEvent(period, offset, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        memory = context.get_discrete_state(0).GetAtIndex(0)
        state.set_value(0, [memory + self._gain * self._input.Eval(context)[0]])


class Stiff(LeafSystem):
    """force = -stiffness times displacement, without memory."""

    def __init__(self, output_name: str = "measured_force", stiffness: float = 1e5):
        super().__init__()
        self._stiffness = stiffness
        self._input = self.DeclareVectorInputPort("displacement", 1)
        self.DeclareVectorOutputPort(output_name, 1, self._calc, prerequisites_of_calc={self._input.ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(-self._stiffness * self._input.Eval(context))


class Forgetful(Hold):
    """A Hold with a second output that never says what it depends on."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("memory", 1, self._memory)

    def _memory(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(0).value())


class WrongSize(Stiff):
    """Promises one number and returns two."""

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.zeros(2))


class FailingUpdate(Hold):
    """Its update writes two numbers into a state of one."""

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(0, [0.0, 0.0])


class Liar(Hold):
    """Declares no delay although it holds for one period."""

    sample_delay = {("measured_force", "displacement_command"): 3 * PERIOD}


class InSensorFrame(Gain):
    """A gain on a wrench in frame S."""

    port_frames = {"y0": "S"}


class InWorldFrame(Gain):
    """A gain on a wrench in frame W."""

    port_frames = {"u0": "W"}


def loop(
    controller: LeafSystem | None = None,
    spring: LeafSystem | None = None,
    between: tuple[LeafSystem, ...] = (),
) -> Diagram:
    """spring.measured_force -> between... -> controller.displacement_command -> spring.displacement"""
    builder = DiagramBuilder()
    controller = builder.AddNamedSystem("controller", controller or Hold())
    spring = builder.AddNamedSystem("spring", spring or Stiff())
    signal = spring.GetOutputPort(spring.get_output_port(0).get_name())
    for block in between:
        if not block.get_name():
            block.set_name(type(block).__name__.split("_")[0])
        builder.AddSystem(block)
        builder.Connect(signal, block.get_input_port(0))
        signal = block.get_output_port(0)
    builder.Connect(signal, controller.get_input_port(0))
    builder.Connect(controller.get_output_port(0), spring.get_input_port(0))
    builder.ExportOutput(spring.get_output_port(0), "measured_force")
    diagram = builder.Build()
    diagram.set_name("loop")
    return diagram


def healthy() -> Diagram:
    return loop()


def open_input() -> Diagram:
    builder = DiagramBuilder()
    builder.AddNamedSystem("controller", Hold())
    builder.ExportOutput(builder.GetSubsystemByName("controller").get_output_port(), "displacement_command")
    return builder.Build()


def open_nested_input() -> Diagram:
    inner = DiagramBuilder()
    adder = inner.AddNamedSystem("sum", Adder(2, 1))
    inner.ExportInput(adder.get_input_port(0), "force")
    inner.ExportOutput(adder.get_output_port(), "total")
    cell = inner.Build()
    cell.set_name("cell")
    outer = DiagramBuilder()
    outer.AddSystem(cell)
    outer.ExportInput(cell.GetInputPort("force"), "force")
    outer.ExportOutput(cell.GetOutputPort("total"), "total")
    return outer.Build()


def open_diagram_in_diagram() -> Diagram:
    """The exported input of a nested diagram is left open one level up."""
    inner = DiagramBuilder()
    hold = inner.AddNamedSystem("hold", Hold())
    inner.ExportInput(hold.get_input_port(), "measured_force")
    inner.ExportOutput(hold.get_output_port(), "displacement_command")
    cell = inner.Build()
    cell.set_name("cell")
    outer = DiagramBuilder()
    outer.AddSystem(cell)
    outer.ExportOutput(cell.GetOutputPort("displacement_command"), "displacement_command")
    return outer.Build()


def unused_output() -> Diagram:
    builder = DiagramBuilder()
    controller = builder.AddNamedSystem("controller", Hold())
    builder.ExportInput(controller.get_input_port(), "measured_force")
    return builder.Build()


def algebraic_loop() -> DiagramBuilder:
    """Not built: Drake refuses it."""
    builder = DiagramBuilder()
    a = builder.AddNamedSystem("a", Adder(2, 1))
    b = builder.AddNamedSystem("b", Gain(2.0, 1))
    builder.Connect(a.get_output_port(), b.get_input_port())
    builder.Connect(b.get_output_port(), a.get_input_port(0))
    builder.ExportInput(a.get_input_port(1), "u")
    return builder


def algebraic_loop_through_diagram() -> DiagramBuilder:
    """One half of the loop lies inside a nested diagram."""
    inner = DiagramBuilder()
    gain = inner.AddNamedSystem("gain", Gain(2.0, 1))
    inner.ExportInput(gain.get_input_port(), "u")
    inner.ExportOutput(gain.get_output_port(), "y")
    cell = inner.Build()
    cell.set_name("cell")
    builder = DiagramBuilder()
    builder.AddSystem(cell)
    back = builder.AddNamedSystem("back", Gain(1.0, 1))
    builder.Connect(cell.GetOutputPort("y"), back.get_input_port())
    builder.Connect(back.get_output_port(), cell.GetInputPort("u"))
    return builder


def open_input_in_builder() -> DiagramBuilder:
    builder = DiagramBuilder()
    builder.AddNamedSystem("controller", Hold())
    return builder


def false_loop() -> DiagramBuilder:
    """No real loop: the output shows the memory only, but does not say so."""
    builder = DiagramBuilder()
    controller = builder.AddNamedSystem("controller", Forgetful())
    spring = builder.AddNamedSystem("spring", Stiff())
    builder.Connect(controller.GetOutputPort("memory"), spring.get_input_port())
    builder.Connect(spring.get_output_port(), controller.get_input_port())
    return builder


def periods_do_not_divide() -> Diagram:
    return loop(between=(ZeroOrderHold(0.003, 1),))


def offsets_differ() -> Diagram:
    return loop(between=(ZeroOrderHold(PERIOD, 1, 0.0005),))


def extra_sample() -> Diagram:
    return loop(between=(Hold("force", "force", gain=1.0),))


def wrong_sample_delay() -> Diagram:
    return loop(controller=Liar())


def undeclared_prerequisites() -> Diagram:
    return loop(controller=Forgetful())


def nan_output() -> Diagram:
    return loop(controller=Hold(start=float("nan")))


def wrong_size() -> Diagram:
    return loop(spring=WrongSize())


def failing_update() -> Diagram:
    return loop(controller=FailingUpdate())


def unit_mismatch() -> Diagram:
    return loop(controller=Hold(input_name="displacement"))


def unit_mismatch_at_export() -> Diagram:
    builder = DiagramBuilder()
    controller = builder.AddNamedSystem("controller", Hold())
    builder.ExportInput(controller.get_input_port(), "motor_position")
    builder.ExportOutput(controller.get_output_port(), "displacement_command")
    return builder.Build()


def frame_mismatch() -> Diagram:
    return loop(between=(InSensorFrame(1.0, 1), InWorldFrame(1.0, 1)))


def transport_delay() -> Diagram:
    """Meant, and no fault: five samples of transport delay in front of the controller."""
    return loop(between=(DiscreteTimeDelay(PERIOD, 5, 1),))


FAULTS: dict[str, tuple[Callable[[], Diagram | DiagramBuilder], str, str]] = {
    "open input": (open_input, "unconnected-input", "controller.measured_force"),
    "open input of a nested block": (open_nested_input, "unconnected-input", "cell/sum.u1"),
    "open input of a nested diagram": (open_diagram_in_diagram, "unconnected-input", "cell/hold.measured_force"),
    "open input before build": (open_input_in_builder, "unconnected-input", "controller.measured_force"),
    "unused output": (unused_output, "unused-output", "controller.displacement_command"),
    "algebraic loop": (algebraic_loop, "algebraic-loop", "a.sum -> b.u0 -> b.y0 -> a.u0 -> a.sum"),
    "algebraic loop through a nested diagram": (algebraic_loop_through_diagram, "algebraic-loop", "cell/gain.y0"),
    "loop by undeclared prerequisites": (false_loop, "undeclared-prerequisites", "controller.memory"),
    "periods that do not divide": (periods_do_not_divide, "periods-do-not-divide", "0.003/0.002 = 1.5"),
    "offsets that differ": (offsets_differ, "offsets-differ", "0.0005"),
    "an extra sample of delay": (extra_sample, "extra-sample", "Hold 0.002 s"),
    "a wrong delay table": (wrong_sample_delay, "delay-differs", "controller.displacement_command"),
    "undeclared prerequisites": (undeclared_prerequisites, "undeclared-prerequisites", "controller.memory"),
    "NaN at the start": (nan_output, "non-finite-output", "controller.displacement_command"),
    "output of the wrong size": (wrong_size, "output-raises", "spring.measured_force"),
    "update that fails": (failing_update, "update-raises", "controller"),
    "units do not fit": (unit_mismatch, "unit-mismatch", "[N] is wired to [m]"),
    "units do not fit at an exported port": (unit_mismatch_at_export, "unit-mismatch", "motor_position -> controller"),
    "frames do not fit": (frame_mismatch, "frame-mismatch", "frame S is wired to frame W"),
}
