"""Re-tuning while regulating: sliding over plastic, wood and aluminium in one run, against every fixed controller."""

import math
from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

import forcectl
from forcectl.analysis.force_metrics import model_response
from forcectl.diagrams.one_dimensional_loop import OneDimensionalLoopConfig, build_one_dimensional_loop
from forcectl.errors import BadInputError
from forcectl.estimation.recursive_vrft import RecursiveVrft, recursive_vrft
from forcectl.force.linear_law import GAINS, VrftConfig
from forcectl.force.slot import ControllerConfig
from forcectl.force.vrft.adaptive import AdaptiveVrftConfig
from forcectl.motion.references import SequenceConfig
from forcectl.plant.contact.compliant_contact import EnvironmentConfig

STIFFNESS = {"plastic": 2.1e5, "wood": 1.55e5, "aluminium": 5e4}
PATH = tuple(STIFFNESS)
BACK = tuple(name for name in reversed(PATH) for _ in range(2))
STAY = 12.0  # on each [s]


def gains(name: str) -> tuple[float, float, float]:
    """K_P, K_I, K_D that `fig_4_8` finds in one dimension."""
    return {
        "plastic": (-1.018e-05, -6.724e-06, 1.014e-08),
        "wood": (-1.065e-05, -9.244e-06, 1.059e-08),
        "aluminium": (-1.446e-05, -2.951e-05, 1.388e-08),
    }[name]


def between(share: float, first: str = "plastic", second: str = "aluminium") -> dict[str, float]:
    """Gains on the way from one material's to another's, on a logarithmic scale."""
    pairs = zip(gains(first), gains(second), strict=True)
    kp, ki, kd = (a * abs(b / a) ** share for a, b in pairs)
    return {"proportional_gain": kp, "integral_gain": ki, "derivative_gain": kd}


def slide(
    controllers: list[ControllerConfig], paths: list[tuple[str, ...]], stay: float = STAY
) -> tuple[np.ndarray, np.ndarray]:
    """Force minus reference model and K_I over paths of materials, 20 N and 15 N in turns.

    Args:
        controllers: which differ in nothing but their gains, each alone in a loop of the batch.
        paths: of each controller, all of the same length.
        stay: on each material of a path [s].
    """
    times = [3.0 * i for i in range(round(stay / 3.0) * len(paths[0]))]
    reference = SequenceConfig(times=times, forces=[20.0 if i % 2 == 0 else 15.0 for i in range(len(times))])
    environment = EnvironmentConfig(stiffness=STIFFNESS[paths[0][0]])
    config = OneDimensionalLoopConfig(controller=controllers[0], reference=reference, environment=environment)
    loop = build_one_dimensional_loop(config, size=len(controllers), seeds=[0] * len(controllers))
    simulator = Simulator(loop.diagram)
    context = simulator.get_mutable_context()
    if len(controllers) > 1:
        law = loop.diagram.GetSubsystemByName("force_law")
        for name in GAINS:
            law.set_parameter(law.GetMyMutableContextFromRoot(context), name, [getattr(c, name) for c in controllers])
    found = []
    for i, materials in enumerate(zip(*paths, strict=True)):
        contact = loop.diagram.GetSubsystemByName("contact")
        stiffness = [STIFFNESS[name] for name in materials]
        contact.set_parameter(contact.GetMyMutableContextFromRoot(context), "stiffness", stiffness)
        simulator.AdvanceTo((i + 1) * stay)
        law = loop.diagram.GetSubsystemByName("force_law")
        if law.HasOutputPort("integral_gain"):
            found.append(law.GetOutputPort("integral_gain").Eval(law.GetMyContextFromRoot(context)).item())
    log = loop.sink.FindLog(context)
    desired, force = (log.data()[loop.signals[name].rows] for name in ("desired_force", "measured_force"))
    return force - model_response(log.sample_times(), desired[0], 1.5), np.array(found)


def rms(error: np.ndarray) -> np.ndarray:
    """Of each controller."""
    return np.sqrt(np.mean(error**2, axis=-1))


@cache
def adapting(path: tuple[str, ...] = PATH) -> tuple[np.ndarray, np.ndarray]:
    """Error and K_I of a slide with gains that begin as those of the path's first material."""
    (error,), found = slide([AdaptiveVrftConfig(**between(0.0 if path is PATH else 1.0))], [path])
    return error, found


@cache
def fixed() -> tuple[np.ndarray, np.ndarray]:
    """Errors of gains that stay, on PATH and on BACK.

    Gains of plastic, four between these and aluminium's, of aluminium, and of wood.
    """
    laws = [VrftConfig(**between(share)) for share in np.linspace(0.0, 1.0, 6)]
    laws.append(VrftConfig(**dict(zip(GAINS, gains("wood"), strict=True))))
    longer = PATH + PATH[-1:] * (len(BACK) - len(PATH))
    error, _ = slide(laws * 2, [longer] * len(laws) + [BACK] * len(laws))
    return error[: len(laws), : adapting()[0].size], error[len(laws) :]


@pytest.mark.slow
def test_it_tracks_better_than_the_fixed_controller_of_any_of_the_materials():
    """The path as a whole, from the plastic it was tuned on: 1.84 N against 2.2 to 2.4 N."""
    assert rms(adapting()[0]) < 0.9 * rms(fixed()[0][[0, 5, 6]]).min()


@pytest.mark.slow
def test_no_compromise_between_the_materials_tracks_as_well():
    """1.84 N against 1.96 N, and 1.67 N against 1.72 N backwards, for 24 s on each material.

    What dominates is the jump of the force at the borders, which no tuning takes away. From a soft to a stiff material
    gains that are too high take it away faster than the reference model asks for: there a short stay is better served
    by the fixed gains of the soft one (1.97 N against 2.14 N for 12 s).
    """
    for path, errors in zip((PATH, BACK), fixed(), strict=True):
        assert rms(adapting(path)[0]) < rms(errors[:6]).min()


@pytest.mark.slow
@pytest.mark.parametrize("path", [PATH, BACK])
def test_it_finds_the_integral_gain_of_each_material(path):
    """-w_c C_E, but for what the friction of the drive takes; in 12 s on each."""
    error, found = adapting(path)
    expected = [-1.5 / STIFFNESS[name] for name in path]
    np.testing.assert_allclose(found, expected, rtol=0.15)
    assert np.abs(error).max() < 12.0


@pytest.mark.slow
def test_on_one_material_it_stays_with_the_gains_that_fit():
    alone = round(STAY / 0.002)
    assert rms(adapting()[0][:alone]) < 1.1 * rms(fixed()[0][0, :alone])


@pytest.mark.slow
def test_at_rest_and_without_contact_it_learns_nothing():
    overrides = {
        "controller": AdaptiveVrftConfig(**between(0.5)),
        "reference": SequenceConfig(times=[0.0], forces=[5.0]),
        "duration": 4.0,
    }
    log = forcectl.run("table_4_2", variant="wood", overrides=overrides, fidelity="Kinematic").log
    assert np.ptp(log["integral_gain"].values) == 0.0  # 5 N is below the least force


@pytest.mark.slow
def test_the_gains_stay_within_their_range():
    narrow = AdaptiveVrftConfig(**between(0.0), gain_range=2.0)
    _, found = slide([narrow], [("plastic", "aluminium")], stay=6.0)
    assert found[-1] == pytest.approx(2 * gains("plastic")[1])
    assert not narrow.fir


@pytest.mark.slow
def test_the_covariance_does_not_grow_at_rest():
    """An hour at rest with forgetting 0.9 would blow P up to infinity: it keeps to P_0, and the gains to theirs."""
    block = RecursiveVrft(1, forgetting=0.9, initial_covariance=1.0, always=True, period=0.1)
    context = block.CreateDefaultContext()
    for name in ("controller_output", "measured_force"):
        block.GetInputPort(name).FixValue(context, [0.0])
    simulator = Simulator(block, context)
    simulator.AdvanceTo(3600.0)
    state = context.get_discrete_state(0).value()
    assert np.isfinite(state).all()
    assert max(block.memory(context)["diagonal"]) <= 1.0
    assert recursive_vrft(np.zeros(3), np.zeros(3), bandwidth=1.5, period=0.1).shape == (3, 3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("forgetting", 0.0),
        ("initial_covariance", 0.0),
        ("minimum_force", -1.0),
        ("minimum_rate", math.nan),
        ("gain_range", 0.5),
        ("data_resolution", -1.0),
        ("fir", [1e-6]),
        ("proportional_gain", 0.0),
        ("integral_gain", 0.0),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name):
        AdaptiveVrftConfig(**{name: value})
