"""Gains that an experiment finds before the run are used, told and found once."""

import json
import signal

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem

import forcectl as fc
from forcectl.errors import RunFailedError
from forcectl.runs import simulate
from forcectl.runs.logs import read_netcdf

FIND = """
title: Find
station: {environment: {stiffness: 1.0e4}}
controller: !RecursiveVrft
  excitation: !TrapezoidalMoves {depths: [0.0, 1e-3, 0.0], rest: 0.3}
  prefilter: false
  hand_over_time: 30.0
  initial_covariance: 1.0e+6
reference: !Step {force: 0.0}
duration: 1.2
"""
USE = """
title: Use
station: {fidelity: OneDimensional, environment: {stiffness: 5.9e3}}
controller: !Vrft {gains_from: find.yaml}
reference: !Step {force: 10.0}
duration: 0.3
variants: {slow: {}, fast: {controller.reference_bandwidth: 4.5}}
"""
GAINS = ("proportional_gain", "integral_gain", "derivative_gain")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "find.yaml").write_text(FIND)
    (tmp_path / "use.yaml").write_text(USE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(simulate, "FOUND", {})
    return tmp_path


@pytest.mark.slow
def test_gains_are_those_of_the_experiment_on_the_same_station(folder, without_pictures):
    changes = {"station.environment.stiffness": 5.9e3}
    alone = fc.run("find.yaml", overrides=changes, fidelity="OneDimensional").metrics["default"]
    result = fc.run(folder / "use.yaml", out="out")
    for variant, scale in (("slow", 1.0), ("fast", 3.0)):
        (found,) = result.gains[variant]
        assert (found.key, found.experiment) == ("controller", str(folder / "find.yaml"))
        assert [found.values[name] for name in GAINS] == [scale * alone[name] for name in GAINS]
        # The law has them: the same run with the gains written down gives the same log, bit for bit.
        written = {f"controller.{name}": value for name, value in found.values.items()} | {
            "controller.gains_from": None
        }
        again = fc.run("use.yaml", variant=variant, overrides=written).log
        assert np.array_equal(again["measured_force"], result.log["measured_force"].sel(variant=variant))
    assert len(simulate.FOUND) == 1  # for both variants
    told = {variant: {"controller": found[0].as_row()} for variant, found in result.gains.items()}
    assert json.loads((folder / "out" / "manifest.json").read_text())["gains"] == told
    assert json.loads(read_netcdf(folder / "out" / "log.nc").attrs["gains"]) == told
    assert told["slow"]["controller"]["gains_from"] == str(folder / "find.yaml")
    # The run directory's own scenario finds the same gains.
    repeated = fc.run(folder / "out" / "scenario.yaml", variant="fast")
    assert repeated.gains["fast"] == result.gains["fast"]


@pytest.mark.slow
def test_the_gains_for_another_bandwidth_are_those_found_for_it(folder):
    other = {"station.environment.stiffness": 5.9e3, "controller.reference_bandwidth": 4.5}
    asked = fc.run("find.yaml", overrides=other, fidelity="OneDimensional").metrics["default"]
    (found,) = fc.run("use.yaml", variant="fast").gains["fast"]
    np.testing.assert_allclose([found.values[name] for name in GAINS], [asked[name] for name in GAINS], rtol=1e-4)


@pytest.mark.slow
def test_an_experiment_that_stops_or_finds_nothing_usable_is_said_in_a_line(folder):
    with pytest.raises(RunFailedError, match=r"^gains of controller from .*find\.yaml: .* at t = "):
        fc.run("use.yaml", variant="slow", overrides={"station.drive.servo.position_gain": 1e5})
    (folder / "find.yaml").write_text(FIND.replace("duration: 1.2", "duration: 0.004"))
    with pytest.raises(RunFailedError, match=r"find\.yaml finds none on this station") as error:
        fc.run("use.yaml", variant="slow")
    assert "\n" not in str(error.value)


def test_an_interrupt_while_gains_are_found_ends_the_run(folder):
    def press(variant, share):
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(fc.InterruptedRunError, match=r"^interrupted before anything was simulated: nothing was kept$"):
        fc.run("use.yaml", variant="slow", progress=press)
    assert simulate.FOUND == {}


def test_such_a_scenario_does_not_run_in_a_batch(folder):
    from forcectl.runs.simulate_batch import batch_size

    asking = fc.load_scenario("use.yaml")
    assert batch_size(asking) == 0
    assert batch_size(fc.load_scenario("use.yaml", overrides={"controller.gains_from": None})) > 0


GAVE_UP = RuntimeError("The SAP solver failed to converge at simulation time = 0. Reasons for divergence and so on")


@pytest.mark.parametrize(
    ("goal", "error", "message"),
    [
        (np.nan, GAVE_UP, "contact solver of plant gave up at t = 0.0000 s: The SAP solver failed to converge at "),
        (np.nan, KeyError("law"), "simulation stopped at t = 0.0000 s: KeyError 'law'"),
        (1.0, GAVE_UP, "state of references is not a finite number at t = 0.0000 s: The SAP solver failed to "),
    ],
)
def test_what_stopped_names_the_block(goal, error, message):
    """A state that is not a number by default, as a goal that there is none of, is no fault."""
    builder = DiagramBuilder()
    references = builder.AddNamedSystem("references", LeafSystem())
    references.DeclareDiscreteState([goal, 1.0])
    plant = builder.AddNamedSystem("plant", MultibodyPlant(1e-3))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    references.GetMyMutableContextFromRoot(context).SetDiscreteState(0, [np.nan, 1.0])
    text = simulate.why_stopped(diagram, context, error)
    assert text.startswith(message)
    assert "Reasons" not in text
