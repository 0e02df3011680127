"""Fig. 6.5: where the generator of positions comes to rest, and what the sampled chain does not allow."""

import pytest

import forcectl
from forcectl.errors import BadInputError

TS, K_ENV, D_ENV = 0.004, 500.0, 100.0


@pytest.mark.slow
@pytest.mark.parametrize("damping", [50.0, 60.0, 75.0])
def test_the_error_of_a_generator_limited_in_acceleration(damping):
    """theta_hole - theta = a_max Ts (D - D_env/2)/K_env, nothing for the D = D_env/2 of the caption."""
    changed = {
        "controller.damping": damping,
        "controller.acceleration_limit": 100.0,
        "controller.velocity_limit": 100.0,
    }
    metrics = forcectl.run("fig_6_5", variant="position-based", overrides=changed).metrics["position-based"]
    expected = 100.0 * TS * (damping - D_ENV / 2) / K_ENV
    assert metrics["alignment_error_rad"] == pytest.approx(expected, abs=1e-4)


def test_the_mass_of_the_caption_is_refused_in_the_real_chain():
    """(6.7) allows 37.5 kNm/rad."""
    told = r"station.environment.damping = 100 N s/m is too much on 500 N/m .*at most 84"
    with pytest.raises(BadInputError, match=told):
        forcectl.run("fig_6_5", variant="velocity-based, real", overrides={"controller.inertia": 0.5})
