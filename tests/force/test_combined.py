"""Laws of one contact as one linear system: the sum of their answers, without motion that no force can see."""

import numpy as np
import pytest
from scipy.signal import dlsim

from forcectl.force.admittance import AdmittanceConfig
from forcectl.force.baselines.pid import PidConfig
from forcectl.force.combined import CombinedLaw, CombinedLaws, described, linear_laws
from forcectl.force.governor.governor import GovernedConfig
from forcectl.force.integral import IntegralConfig
from tests.force.test_margins import MODEL

SLOW, QUICK = AdmittanceConfig(inertia=3.0, damping=300.0), AdmittanceConfig(inertia=2.0, damping=150.0)


def combined(*laws: object) -> CombinedLaws:
    return CombinedLaws(tuple(CombinedLaw(law, 0.5, lambda model: model) for law in laws), "Hybrid")


@pytest.mark.parametrize("laws", [(SLOW, QUICK), (SLOW, IntegralConfig(integral_gain=2.0), QUICK)])
def test_the_command_is_the_sum_of_the_commands(laws):
    force = np.random.default_rng(5).normal(size=(200, 1))
    alone = sum(0.5 * dlsim(law.sampled_response(MODEL), force)[1] for law in laws)
    np.testing.assert_allclose(dlsim(combined(*laws).sampled_response(MODEL), force)[1], alone, atol=1e-12)


def test_of_several_integrals_only_their_sum_is_left():
    for laws in ((SLOW, QUICK), (SLOW, SLOW), (SLOW, IntegralConfig(), QUICK)):
        poles = np.linalg.eigvals(combined(*laws).sampled_response(MODEL).A)
        assert np.count_nonzero(np.abs(poles - 1.0) < 1e-9) == 1


def test_what_does_not_integrate_stays_as_it_is():
    proportional = PidConfig(proportional_gain=1e-5, integral_gain=0.0)
    alone = proportional.sampled_response(MODEL)
    both = combined(proportional, proportional).sampled_response(MODEL)
    force = np.random.default_rng(5).normal(size=(50, 1))
    np.testing.assert_allclose(dlsim(both, force)[1], dlsim(alone, force)[1], atol=1e-15)


def test_a_part_is_walked_down_to_the_laws_inside():
    assert linear_laws(GovernedConfig(law=SLOW, inner_bandwidth=1.5), MODEL, 0.3) == [(SLOW, 0.3)]
    assert linear_laws(object(), MODEL) == []


def test_a_message_names_each_law_once():
    assert described(QUICK) == "inertia = 2 kg and damping = 150 N s/m"
    both = described(combined(SLOW, IntegralConfig(), SLOW))
    assert both == "inertia = 3 kg and damping = 300 N s/m, together with !Integral"
    assert combined(IntegralConfig(), SLOW).must_be_stable
    assert not combined(IntegralConfig(), IntegralConfig(integral_gain=2.0)).must_be_stable
