"""What a scenario says of references becomes the arrays of a mode, and what does not fit is named."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.framework.reader import Reader
from forcectl.framework.rotation_vector import RotationVector
from forcectl.framework.yaml_tree import parse
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, ReferenceConfig, mode_references
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from forcectl.tasks.relative_task import RelativeTask

TASKS = {
    "lead": ArmTask("left", ["x", "z"]),
    "peg": RelativeTask("left", "right", ["x", "y", "z", "phi", "theta"], RotationVector()),
}


@dataclass
class ModeOfTheTest:
    references: dict[str, dict[str, ReferenceConfig]]


def read(text: str, **options: Any) -> Any:
    """The references of a mode, from YAML at the key `modes.press.references`."""
    said = Reader().dataclass(ModeOfTheTest, parse(f"references: {text}", "test"), "modes.press").references
    given = {"gains": AdmittanceGainsConfig(damping=35.0), "limits": MotionLimitsConfig(), "period": 0.004}
    return mode_references(said, TASKS, **given | options, key="modes.press.references")


def test_every_coordinate_has_what_is_said_of_it_in_the_order_of_the_tasks():
    made = read(
        """
      peg:
        z: {velocity: -0.075}
        x: {comply: true, force: 2.0, speed_limit: [-0.03, 0.02]}
        phi: {comply: true, damping: 0.3, damping_over: {coordinate: z, at: [0.0, 0.02], factor: [2.0, 1.0]}}
        theta: {by: 0.1, swing: {amplitude: 0.026, frequency: 2.5, phase_deg: 90}}
      lead: {z: {position: 0.2}}
    """,
        force_dead_band=0.4,
        torque_dead_band=0.03,
    )
    nan = np.nan
    np.testing.assert_array_equal(made.position, [nan, 0.2, nan, nan, nan, nan, nan])
    np.testing.assert_array_equal(made.by, [nan, nan, nan, nan, nan, nan, 0.1])
    np.testing.assert_array_equal(made.velocity, [0, 0, 0, 0, -0.075, 0, 0])
    np.testing.assert_array_equal(made.comply, [0, 0, 1, 0, 0, 1, 0])
    np.testing.assert_array_equal(made.stays, [1, 0, 1, 1, 0, 1, 0])
    np.testing.assert_array_equal(made.force, [0, 0, 2, 0, 0, 0, 0])
    np.testing.assert_array_equal(made.slowest, [-np.inf, -np.inf, -0.03, *[-np.inf] * 4])
    np.testing.assert_array_equal(made.inertia, [0.4] * 5 + [0.01] * 2)
    np.testing.assert_array_equal(made.damping, [35.0] * 5 + [0.3, 0.2])
    np.testing.assert_array_equal(made.filter.dead_band, [0.4] * 5 + [0.03] * 2)
    (table,) = made.tables
    assert (table.row, table.of) == (5, 4)
    np.testing.assert_allclose(made.admittance_at(np.array([0, 0, 0, 0, 0.01, 0, 0]))[1][5], 0.45)
    assert made.swings == [(6, 2.5, 0.026, 0.0, np.pi / 2, 0.0)]
    np.testing.assert_array_equal(made.limits.velocity, [0.5] * 5 + [1.5] * 2)
    assert made.followed.all()
    assert read("{}", followed=["peg"]).followed.tolist() == [False] * 2 + [True] * 5


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{pag: {z: {}}}", "references.pag: unknown task 'pag': did you mean 'peg'?"),
        ("{peg: {zz: {}}}", "references.peg.zz: unknown coordinate 'zz'"),
        ("{lead: {y: {}}}", "references.lead.y: unknown coordinate 'y': known: x, z"),
        ("{peg: {z: {velocty: 1}}}", "references.peg.z.velocty: unknown key 'velocty': did you mean 'velocity'?"),
        ("{peg: {z: {velocity: 0.1, by: 0.1}}}", "references.peg.z.by and velocity: must be one of them"),
        ("{peg: {z: {velocity: 0.6}}}", "references.peg.z.velocity = 0.6: must be at most the speed limit"),
        ("{peg: {z: {position: 30}}}", "references.peg.z.position = 30.0: must be from -10 to 10"),
        ("{peg: {z: {position: far}}}", "references.peg.z.position = 'far'"),
        ("{peg: {z: {force: 7}}}", "references.peg.z.force: must be left out without comply: true"),
        ("{peg: {z: {damping: 7}}}", "references.peg.z.damping: must be left out without comply: true"),
        ("{peg: {z: {comply: true, damping: 0}}}", "references.peg.z.damping = 0.0: must be positive"),
        ("{peg: {z: {comply: true, damping: 300}}}", "references.peg.z.inertia = 0.4: must be above damping times"),
        ("{peg: {z: {comply: true, speed_limit: [0.1, 0.2]}}}", "references.peg.z.speed_limit"),
        ("{peg: {z: {comply: true, speed_limit: [-0.1]}}}", "references.peg.z.speed_limit"),
        ("{peg: {z: {comply: true, speed_limit: [0, 0]}}}", "references.peg.z.speed_limit"),
        ("{peg: {phi: {swing: {frequency: 2}}}}", "references.peg.phi.swing.amplitude = 0.0: must be above zero"),
        (
            "{peg: {phi: {swing: {amplitude: 0.1, frequency: 2, delay: -1}}}}",
            "references.peg.phi.swing.delay = -1.0: must be from 0 to 100",
        ),
        ("{peg: {phi: {swing: {amplitude: 0.1}}}}", "references.peg.phi.swing.frequency is missing"),
        (
            "{peg: {phi: {comply: true, damping_over: {coordinate: psi, at: [0], factor: [1]}}}}",
            "references.peg.phi.damping_over.coordinate: unknown coordinate 'psi'",
        ),
        (
            "{peg: {phi: {comply: true, damping_over: {coordinate: z, at: [0, 0], factor: [1, 2]}}}}",
            "references.peg.phi.damping_over.at = [0.0, 0.0]: must be one value or more, ascending",
        ),
        (
            "{peg: {phi: {comply: true, damping_over: {coordinate: z, at: [0, 1], factor: [1]}}}}",
            "references.peg.phi.damping_over.factor = [1.0]: must be 2 numbers",
        ),
        (
            "{peg: {phi: {comply: true, damping: 10}}}",
            "references.peg.phi.inertia = 0.01: must be above damping times half a tick, 0.02",
        ),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(text, told):
    with pytest.raises(BadInputError) as caught:
        read(text)
    assert str(caught.value).startswith("modes.press.")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_references_of_a_task_that_the_mode_does_not_follow_are_refused():
    with pytest.raises(BadInputError, match=r"references.lead: must be one of the tasks of the mode: peg"):
        read("{lead: {x: {by: 0.1}}}", followed=["peg"])


def test_in_python_a_reference_is_an_object():
    given = {"gains": AdmittanceGainsConfig(), "limits": MotionLimitsConfig(), "period": 0.004}
    with pytest.raises(BadInputError, match=r"references.peg.z = \{'by': 0.1\}: must be a ReferenceConfig"):
        mode_references({"peg": {"z": {"by": 0.1}}}, TASKS, **given)
