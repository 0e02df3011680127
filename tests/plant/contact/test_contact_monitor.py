"""Contact mode and its losses, against a state machine written from the docstring."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.plant.contact.contact_monitor import ContactMode, ContactMonitor, next_mode
from forcectl.testing import Log, assert_ports, run_diagram

PERIOD = 0.002
APPROACH, CONTACT, LOST = 0.0, 1.0, 2.0


def watch(forces: np.ndarray, **arguments: float) -> Log:
    """The monitor's outputs, one tick after each force; forces of shape (ticks, n)."""
    last = len(forces) - 1
    monitor = ContactMonitor(forces.shape[1], period=PERIOD, **arguments)
    inputs = {"contact_force": lambda t: forces[min(round(t / PERIOD), last)]}
    return run_diagram(monitor, len(forces) * PERIOD, period=PERIOD, inputs=inputs)


def expected(forces: np.ndarray, threshold: float) -> tuple[list[float], list[float]]:
    mode, losses = APPROACH, 0.0
    modes, counts = [mode], [losses]
    for force in forces:
        if force > threshold:
            mode = CONTACT
        elif mode == CONTACT and force <= 0.0:
            mode, losses = LOST, losses + 1
        modes.append(mode)
        counts.append(losses)
    return modes, counts


def test_the_numbers_of_the_modes():
    assert (ContactMode.APPROACH, ContactMode.CONTACT, ContactMode.LOST) == (0, 1, 2)


def test_a_touch_a_loss_and_a_new_touch():
    forces = np.array([[0.0], [0.0], [2.0], [5.0], [0.0], [0.0], [1.0], [0.0]])
    log = watch(forces)
    assert log["contact_state"][:, 0].tolist() == [0, 0, 0, 1, 1, 2, 2, 1, 2]
    assert log["contact_losses"][:, 0].tolist() == [0, 0, 0, 0, 0, 1, 1, 1, 2]


forces = st.one_of(st.just(0.0), st.floats(0.0, 20.0), st.floats(0.0, 2.0))


@given(st.lists(st.tuples(forces, forces), min_size=1, max_size=30), st.sampled_from([0.0, 1e-9, 0.5]))
@settings(max_examples=50)
def test_follows_the_state_machine(rows, threshold):
    samples = np.array(rows)
    log = watch(samples, threshold=threshold)
    for element in range(2):
        modes, counts = expected(samples[:, element], threshold)
        assert log["contact_state"][:, element].tolist() == modes
        assert log["contact_losses"][:, element].tolist() == counts


@given(st.sampled_from([APPROACH, CONTACT, LOST]), st.floats(-1.0, 5.0), st.floats(0.0, 2.0))
@settings(max_examples=50)
def test_a_force_within_the_threshold_changes_nothing(mode, force, threshold):
    after = float(next_mode(mode, force, threshold))
    if 0.0 < force <= threshold:
        assert after == mode
    if mode == APPROACH:
        assert after != LOST, "what was never touched cannot be lost"


def test_between_two_samples_nothing_is_seen():
    """A touch shorter than the period, between the samples, leaves no trace."""
    touch = {"contact_force": lambda t: 9.0 if 0.0004 < t % PERIOD < 0.0016 else 0.0}
    log = run_diagram(ContactMonitor(1, period=PERIOD), 0.05, period=0.0005, inputs=touch)
    assert np.all(log["contact_state"] == APPROACH)


def test_ports():
    assert_ports(ContactMonitor(3), {"contact_force": 3}, {"contact_state": 3, "contact_losses": 3})


@pytest.mark.parametrize("threshold", [-1.0, float("nan"), float("inf")])
def test_a_bad_threshold_is_refused(threshold):
    with pytest.raises(BadInputError, match="threshold"):
        ContactMonitor(1, threshold=threshold)
