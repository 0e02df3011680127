"""The equivalent scheme of Fig. 4.13 is the governed loop: the same forces and references, the same poles."""

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiscreteValues

from forcectl.errors import BadInputError
from forcectl.force.governor.governor import CommandGovernor, GovernedConfig
from forcectl.force.governor.scheme import EquivalentScheme
from forcectl.force.governor.stability import feedback_weight, spectral_radius
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import load_scenario
from forcectl.testing import run_diagram
from tests.force.governor.test_governor import PERIOD, model_loop

CASES = [
    (0.997, 0.985, 40, 40, 1e-3),
    (0.997, 0.991, 40, 20, 1e-3),
    (0.997, 0.985, 40, 60, 1e-3),
    (0.95, 0.9, 3, 5, 1e-2),
    (0.95, 0.9, 0, 0, 1e-2),
    (0.9, 0.8, 1, 0, 1e-3),
    (0.9, 0.8, 0, 1, 1e-2),
]


def desired(t: float) -> float:
    """A step, then a ramp, then a sine."""
    if t < 0.2:
        return 20.0
    return 20.0 - 30.0 * (t - 0.2) if t < 0.4 else 14.0 + 5.0 * float(np.sin(9.0 * t))


@pytest.mark.parametrize(("pole", "wanted", "n", "true", "weight"), CASES)
def test_it_does_what_the_governed_loop_does(pole, wanted, n, true, weight):
    known = {"inner_pole": pole, "reference_pole": wanted, "reference_weight": weight, "period": PERIOD}
    governed = model_loop(CommandGovernor(1, delay=n * PERIOD, **known), true, pole)
    scheme = EquivalentScheme(delay_ticks=n, true_delay_ticks=true, **known)
    expected, found = (
        run_diagram(d, 0.8, period=PERIOD, inputs={"desired_force": desired}) for d in (governed, scheme)
    )
    size = np.abs(expected["governed_reference"]).max()
    for name in ("governed_reference", "force"):
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=1e-11 * size)


def state_matrix(diagram: Diagram) -> np.ndarray:
    """Of a discrete diagram whose input is zero, a column for each of its states."""
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("desired_force").FixValue(context, [0.0])

    def values(states: DiscreteValues) -> np.ndarray:
        return np.concatenate([states.value(i) for i in range(states.num_groups())])

    columns = []
    for group in range(context.num_discrete_state_groups()):
        for unit in np.eye(context.get_discrete_state(group).size()):
            for other in range(context.num_discrete_state_groups()):
                context.SetDiscreteState(other, 0.0 * context.get_discrete_state(other).value())
            context.SetDiscreteState(group, unit)
            columns.append(values(diagram.EvalUniquePeriodicDiscreteUpdate(context)))
    return np.array(columns).T


@pytest.mark.parametrize(("pole", "wanted", "n", "true", "weight"), CASES)
def test_its_poles_are_those_of_4_40(pole, wanted, n, true, weight):
    """Those of the diagram, without the pole of F1, which stands before the loop."""
    scheme = EquivalentScheme(
        inner_pole=pole, reference_pole=wanted, delay_ticks=n, true_delay_ticks=true, reference_weight=weight
    )
    poles = np.linalg.eigvals(state_matrix(scheme))
    before = np.abs(poles - wanted).argmin()
    assert abs(poles[before] - wanted) < 1e-9
    radius = np.abs(np.delete(poles, before)).max(initial=0.0)
    expected = spectral_radius(pole, feedback_weight(pole, n, 1.0, weight), n, true)
    assert radius == pytest.approx(expected, abs=1e-8)


def test_f1_is_the_step_of_n_p_ticks_of_the_thesis():
    """(4.35): v[t+N_p] = At^N_p v[t] + (1 - At^N_p) F_bar holds for the governor's yt while F_bar is constant."""
    at, ahead, force = 0.985, 41, 20.0
    response = force * (1.0 - at ** np.arange(200))
    np.testing.assert_allclose(response[ahead:], at**ahead * response[:-ahead] + (1 - at**ahead) * force, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "value"), [("inner_pole", 1.0), ("reference_pole", 0.0), ("delay_ticks", -1), ("true_delay_ticks", 0.5)]
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name):
        EquivalentScheme(**{name: value})


# --- the loops that are shipped --------------------------------------------------------------------------------------


def shipped() -> dict[str, GovernedConfig]:
    """The governed controllers of the experiments by name and variant, those of the same model and weights once."""
    found: dict[tuple[object, ...], tuple[str, GovernedConfig]] = {}
    for name in ("baselines", "fig_4_14", "governor_limits", "vrft_motor", "vrft_torque"):
        for variant in select_variants(find_scenario(name)):
            law = load_scenario(name, variant).controller
            if isinstance(law, GovernedConfig):
                model = (law.inner_bandwidth, law.delay, law.output_weight, law.reference_weight, law.horizon)
                found.setdefault(model, (f"{name}: {variant}", law))
    return dict(found.values())


@pytest.mark.slow
def test_every_shipped_governor_is_stable_up_to_a_true_delay_of_0_22_s():
    """0, 0.04, 0.08, 0.16 and 0.22 s; a horizon of 20 with the printed weights stops there."""
    loops, found = shipped(), {}
    for name, config in loops.items():
        report = config.stability(PERIOD, true_delay_ticks=[0, 20, 40, 80, 110, 111, 160])
        found[name] = [case.true_delay_ticks for case in report.cases if not case.stable]
    assert len(found) >= 4
    assert found.pop("governor_limits: horizon of 20") == [111, 160]
    assert not any(found.values())
