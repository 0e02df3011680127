"""Diagrams that forcectl never saw: a station like those of the manipulation world, and a sampled loop."""

import pytest

from tests.examples import plugin_project

pytestmark = pytest.mark.slow

pytest_plugins = ["pytester"]

STATION = """
import numpy as np
from foreign_station import station
from forcectl.testing import Frozen, Noise, NotANumber, Spike, assert_no_limit_cycle, assert_within, perturb

STEP = {"arm.position": lambda t: [0.5, 0.3] if t >= 0.1 else [0.0, 0.0]}
LOGGED = ["arm.position_measured", "station/controller.generalized_force"]

def test_as_before(simulate_diagram, golden_log, golden_graph):
    diagram = station()
    log = simulate_diagram(diagram, 0.5, period=0.01, inputs=STEP, outputs=LOGGED)
    golden_log(log, "reach", time=5e-3, value={"arm.position_measured": 1e-3, LOGGED[1]: 0.1})
    golden_graph(diagram, "station")

FAULTS = [Noise(1e-3, seed=4), Frozen(start=0.3, duration=0.02), Spike(0.1, start=0.5, index=0)]

@perturb(kp=[100.0, 200.0], fault=FAULTS)
def test_faults(simulate_diagram, kp, fault):
    faults = {"station/controller.estimated_state": fault}
    log = simulate_diagram(station(kp=kp), 1.5, period=0.01, inputs=STEP, faults=faults)
    assert_within(log, "arm.position_measured", [0.47, 0.27], [0.53, 0.33], start=1.3)
    assert_no_limit_cycle(log, "arm.position_measured", 0.02)

def test_nan_of_the_command(simulate_diagram):
    log = simulate_diagram(station(), 0.2, period=0.01, inputs=STEP, faults={"arm.position": NotANumber(start=0.5)})
    assert np.isfinite(log["arm.position_measured"]).all()
"""

LOOP = """
import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, DiscreteTimeDelay, Gain, Integrator, LogVectorOutput, ZeroOrderHold
from pydrake.systems.analysis import Simulator
from forcectl.testing import DropOut, assert_no_limit_cycle, run_diagram

def servo(gain):
    builder = DiagramBuilder()
    adder, amplifier = builder.AddSystem(Adder(2, 1)), builder.AddSystem(Gain(-gain, 1))
    delay, hold = builder.AddSystem(DiscreteTimeDelay(0.01, 4, 1)), builder.AddSystem(ZeroOrderHold(0.01, 1))
    plant = builder.AddSystem(Integrator(1))
    for source, reader in ((plant, delay), (delay, adder), (adder, amplifier), (amplifier, hold), (hold, plant)):
        builder.Connect(source.get_output_port(0), reader.get_input_port(0))
    builder.ExportInput(adder.get_input_port(1), "disturbance")
    sink = LogVectorOutput(plant.get_output_port(), builder, 0.01)
    return builder.Build(), sink

def test_drakes_own_log(golden_log):
    diagram, sink = servo(5.0)
    simulator = Simulator(diagram)
    diagram.get_input_port().FixValue(simulator.get_mutable_context(), [1.0])
    simulator.AdvanceTo(1.0)
    golden_log(sink.FindLog(simulator.get_context()), "servo")

@pytest.mark.parametrize("gain", [5.0, 40.0])
def test_stability(gain):
    faults = {"Gain.y0": DropOut(start=0.2, duration=0.05)}
    push, position = {"disturbance": 1.0}, "Integrator.y0"
    log = run_diagram(servo(gain)[0], 2.0, period=0.01, inputs=push, outputs=[position], faults=faults)
    assert_no_limit_cycle(log, position, 0.05)
"""


@pytest.mark.parametrize(("test", "passed", "failed"), [(STATION, 8, 0), (LOOP, 2, 1)])
def test_a_foreign_diagram(pytester, monkeypatch, test, passed, failed):
    project = plugin_project.prepared(pytester, monkeypatch)
    monkeypatch.syspath_prepend(plugin_project.FOLDER)
    project.makepyfile(test_foreign=test)
    plugin_project.run(project, "--update-golden").assert_outcomes(passed=passed, failed=failed)
    result = plugin_project.run(project)
    result.assert_outcomes(passed=passed, failed=failed)
    if failed:
        result.stdout.fnmatch_lines(["*AssertionError: Integrator.y0 has a limit cycle of amplitude *, period *"])
