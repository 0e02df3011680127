"""Arguments of constructors that are no numbers, or numbers that every output would be lost with."""

import math

import pytest

from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.baselines.impedance import ImpedanceForceLaw
from forcectl.force.integral import IntegralForceLaw
from forcectl.force.linear_law import LinearForceLaw
from forcectl.motion.references import Reference
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.plant.linear_contact import LinearContact
from forcectl.plant.sensors.force_sensor import ForceSensor

SLIPS = [
    (lambda: IntegralForceLaw("2", integral_gain=1.0, compliance=1e-4), "size = '2': must be a whole number"),
    (
        lambda: IntegralForceLaw(1, integral_gain=math.inf, compliance=1e-4),
        "integral_gain = inf: must be not",
    ),
    (lambda: LinearForceLaw(1, gains=[-1e-5, -1e-4, 0.0], feed_forward=math.inf), "feed_forward = inf: must be not"),
    (lambda: ImpedanceForceLaw(1, inertia=1.0, damping=1e2, reference_filter=math.inf), "reference_filter = inf: must"),
    (lambda: EnvironmentComplianceEstimator(1, initial_compliance=1e-4, drive_compliance=math.inf), "drive_compliance"),
    (lambda: ForceSensor(1, quantum=math.inf), "quantum = inf: must be not negative and finite"),
    (lambda: ForceSensor(1, range=math.nan), "range = nan: must be positive"),
    (lambda: ForceSensor(1, range="wide"), "range = 'wide': must be a number or a list of numbers"),
    (lambda: LinearContact(1, stiffness=1e4, damping=math.inf), "damping = inf: must be not negative and finite"),
    (lambda: Reference("desired_force", math.nan), "desired_force = nan: must be"),
    (lambda: Reference("desired_force", "10 N"), "desired_force = '10 N': must be"),
    (lambda: Reference("desired_force", [[1.0, 2.0]]), "desired_force = .* must be"),
    (lambda: Reference("desired_force", []), "desired_force = .*: must be"),
    (lambda: Reference("", 1.0), "name = '': must be"),
    (lambda: PositionLoop(1, delay="late"), "delay = 'late': must be a finite number"),
]


@pytest.mark.parametrize(("make", "message"), SLIPS, ids=[message for _, message in SLIPS])
def test_numbers_that_make_no_number_are_refused_by_constructors(make, message):
    with pytest.raises(BadInputError, match=message):
        make()
