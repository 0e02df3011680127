"""The dead time of every shipped loop: what the tables say is what a step around the loop takes, within a sample."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import PidController
from pydrake.systems.framework import DiagramBuilder, EventStatus
from pydrake.systems.primitives import DiscreteTimeDelay, LinearSystem

from forcectl.doctor import examine, measure_delay
from forcectl.errors import BadInputError
from forcectl.force.approach import ApproachConfig, ApproachMode
from forcectl.force.guard.config import GuardConfig
from forcectl.force.integral import IntegralConfig
from forcectl.inspect.ports import find_outputs
from forcectl.inspect.wiring import Wiring
from forcectl.scenario.catalog import find_scenario, list_experiments
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import Scenario, as_file, build, resolve
from tests.examples.experiment_runs import fidelities_of

TICK = 0.0005  # [s] between two reads, divides the steps of all plants
STEPS = {  # sizes of the step by the name of its port; several where a dead zone must be left at once
    "contact_force": (5.0,),  # [N]
    "measured_force": (5.0, 1000.0),  # [N]
    "external_wrench": (1000.0,),  # [Nm, N]
    "joint_position_command": (0.01, 0.1),  # [rad]
}
# Their controllers only ask of the measured force, or of the joint readings, whether it is to be believed.
SUPERVISED = ("fig_5_3", "null_space", "usable_forces", "peg_in_hole", "fig_6_10")
HOLDING = ("peg_in_hole", "fig_6_10")  # parts in the hands: the step of the wrench would tear them away
# A motion loop whose controller reads a force, of a contact that is not there at the start.
MIXED = ("fig_6_17", "cap_rotation", "pipette")
LOOPS = [name for name in list_experiments() if name not in MIXED]
MOTION_LOOPS = [name for name in LOOPS if "reference" not in find_scenario(name).tree]
FORCE_LOOPS = [name for name in LOOPS if name not in MOTION_LOOPS]
CASES = [
    pytest.param(name, fidelity, marks=[pytest.mark.slow] if fidelity != "OneDimensional" and name != "fig_2_7" else [])
    for name in FORCE_LOOPS
    for fidelity in fidelities_of(name)
]


def loop_of(name, fidelity):
    file = as_file(name)
    overrides = {"station.fidelity": fidelity} if fidelity else {}
    return build(resolve(file, select_variants(file)[0], overrides))


def in_contact(diagram, latest=3.0, force="contact_force", least=(1.0,)):
    """Contexts of one run at the first times at which its contact force is each of `least` [N], at `latest` if never.

    Args:
        diagram: the loop.
        latest: end of the run [s].
        force: name of the port.
        least: rising forces [N].
    """
    wiring = Wiring(diagram)
    (port,) = find_outputs(wiring, force)
    block, output = wiring.systems[port.system], wiring.port(port)
    simulator = Simulator(diagram)

    def reached(context):
        return max(output.Eval(block.GetMyContextFromRoot(context))) > bound

    def look(context):
        return EventStatus.ReachedTermination(diagram, "contact") if reached(context) else EventStatus.DidNothing()

    simulator.set_monitor(look)
    for bound in least:
        if bound == least[0] or not reached(simulator.get_context()):
            simulator.AdvanceTo(latest)
        yield simulator.get_context().Clone()


def measured(loop, context, source, target):
    """Shortest time over sizes and directions of the step: a contact may open, a limit may be reached."""
    start = math.ceil(context.get_time() / loop.period - 1e-9) * loop.period - context.get_time()
    name = source.rpartition(".")[2]
    signs = [-1.0, 1.0]
    if name == "joint_position_command":  # all joints alike may move the tool along the surface only
        (port,) = find_outputs(wiring := Wiring(loop.diagram), source)
        signs += [sign * (-1.0) ** np.arange(wiring.port(port).size()) for sign in signs]
    sizes = [sign * size for size in STEPS[name] for sign in signs]
    shortest, longest = None, 0.08
    for size in sizes:
        options = {"tick": TICK, "start": start, "longest": longest, "context": context}
        time = measure_delay(loop.diagram, source, target, amplitude=size, **options)
        if time is not None:
            shortest = longest = time  # only a shorter one is of interest
    return shortest


@pytest.mark.parametrize(("name", "fidelity"), CASES)
def test_a_force_loop_takes_the_dead_time_of_its_tables(name, fidelity):
    loop = loop_of(name, fidelity)
    report = examine(loop.diagram)
    back, inside, outside = report.delays
    assert [c.source.rpartition(".")[2] for c in report.delays] == [
        "joint_position_command",
        "contact_force",
        "measured_force",
    ]
    assert report.dead_time == pytest.approx(back.total + inside.total + outside.total)
    expected = pytest.approx(report.dead_time, abs=loop.period + TICK)
    for context in in_contact(loop.diagram, least=(1.0, 2.0, 4.0, 8.0, 10.0)):  # drives that stick answer later
        parts = [measured(loop, context, chain.source, chain.target) for chain in report.delays]
        if name in SUPERVISED:
            assert parts.pop() is None
        assert None not in parts
        if sum(parts) == expected:
            break
    assert sum(parts) == expected


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "fig_5_2" else pytest.mark.slow) for name in MOTION_LOOPS]
)
def test_a_motion_loop_takes_the_dead_time_of_its_tables(name):
    """Nothing is touched in these loops, so the links have to show when the contact force would change."""
    loop = loop_of(name, None)
    report = examine(loop.diagram)
    command = report.delays[0].source
    (context,) = in_contact(loop.diagram, latest=0.2, force="arm_contact_force")
    back = measured(loop, context, command, "station.link_position")
    assert back == pytest.approx(report.delays[0].total, abs=loop.period + TICK)
    inside = not loop.station.HasInputPort("external_wrench")  # where the loads are
    load = "station/loads.external_wrench" if inside else "station.external_wrench"
    forth = math.inf if name in HOLDING else measured(loop, context, load, command)
    if name in SUPERVISED:
        assert report.delays[1].source == "station.external_wrench"
        assert report.dead_time == pytest.approx(report.delays[0].total + report.delays[1].total)
        assert forth >= report.delays[1].total
    else:
        assert (forth, report.dead_time) == (None, None)
        assert [finding.path for finding in report.with_code("open-loop")] == [
            f"external_wrench -> {command.rpartition('.')[2]}"
        ]


def test_the_tables_of_a_users_diagram_lead_from_port_to_port_and_back():
    loop = loop_of("fig_2_7", "Multibody")
    report = examine(loop.diagram, sensor="station/plant.reaction_forces", command="station.joint_position_command")
    assert [(chain.source, chain.target) for chain in report.delays] == [
        ("station.joint_position_command", "station/plant.reaction_forces"),
        ("station/plant.reaction_forces", "controller.joint_position_command"),
    ]
    # The sensor filter reads the plant at its own ticks.
    assert report.dead_time == pytest.approx(examine(loop.diagram).dead_time, abs=loop.period)


@pytest.mark.parametrize("command", ["station.measured_force", "measured_force"])
def test_a_way_is_between_two_ports(command):
    with pytest.raises(BadInputError, match=r"is empty: must be between two ports$"):
        examine(loop_of("fig_2_7", "OneDimensional").diagram, sensor="station.measured_force", command=command)


class LateIntegral:
    """A user's law: integral, its command `samples` + 1 ticks late."""

    def __init__(self, samples):
        self.samples = samples

    def add_to(self, builder, model):
        inner = DiagramBuilder()
        law = IntegralConfig().add_to(inner, model)
        late = inner.AddNamedSystem("late", DiscreteTimeDelay(model.period, self.samples, model.size))
        inner.Connect(law.GetOutputPort("displacement_command"), late.get_input_port())
        for name in ("desired_force", "measured_force"):
            inner.ExportInput(law.GetInputPort(name), name)
        inner.ExportOutput(late.get_output_port(), "displacement_command")
        return builder.AddNamedSystem("late_integral", inner.Build())


@pytest.mark.parametrize("samples", [0, 10])
@pytest.mark.parametrize("guard", [None, GuardConfig(), GuardConfig(maximum_force=60.0)])
def test_the_guard_does_not_hide_the_delay_of_a_law(samples, guard):
    loop = Scenario(controller=LateIntegral(samples), guard=guard).build()
    around = examine(loop.diagram).delays[-1]
    assert around.total == pytest.approx((samples + 1) * loop.period)
    assert measure_delay(loop.diagram, around.source, around.target, tick=loop.period) == pytest.approx(around.total)
    assert [row.block for row in around.rows if row.delay] == ["controller/late_integral/late"]


def test_a_guarded_move_does_not_hide_the_delay_of_the_law_behind_it():
    loop = Scenario(controller=ApproachConfig(law=LateIntegral(10), patience=0.02, rise_time=0.0), guard=None).build()
    around = examine(loop.diagram).delays[-1]
    assert around.total == pytest.approx(11 * loop.period)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(1.0)
    mode = loop.diagram.GetSubsystemByName("controller").GetOutputPort("approach_mode")
    context = simulator.get_context()
    assert mode.Eval(mode.get_system().GetMyContextFromRoot(context)) == ApproachMode.CONTACT
    measured = measure_delay(loop.diagram, around.source, around.target, tick=loop.period, context=context)
    assert measured == pytest.approx(around.total)


def test_a_continuous_integral_beside_the_loop_does_not_hide_the_step_of_the_plant():
    builder = DiagramBuilder()
    step = 0.002
    plant = builder.AddNamedSystem(
        "plant", LinearSystem([[1.0, step], [0.0, 1.0]], [[0.0], [step]], np.eye(2), np.zeros((2, 1)), step)
    )
    pid = builder.AddNamedSystem("pid", PidController([10.0], [1.0], [1.0]))
    builder.Connect(plant.get_output_port(), pid.get_input_port_estimated_state())
    builder.Connect(pid.get_output_port(), plant.get_input_port())
    builder.ExportInput(pid.get_input_port_desired_state(), "desired_state")
    diagram = builder.Build()
    loop = examine(diagram, sensor="plant.y0", command="pid.control")
    assert [chain.total for chain in loop.delays] == [step, 0.0]
    assert loop.delays[0].reader == "plant"
    assert loop.dead_time == measure_delay(diagram, "pid.control", "plant.y0", tick=step) == step
