"""The declared faults and what scenarios can have of them."""

import pytest

import forcectl as fc
from forcectl.analysis.findings.finding import KINDS
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged
from forcectl.sweeps.faults.declared import FAULTS, SOUND, changes_of, chosen
from forcectl.sweeps.faults.run_faults import try_faults


def fits(scenario, **options):
    """Names of the faults that a scenario can have; with each of them it is still one."""
    loaded = fc.load_scenario(scenario, **options)
    found = []
    for fault in FAULTS:
        changes = changes_of(fault, loaded, 0.5)
        if not isinstance(changes, str):
            fc.load_scenario(scenario, **(options | {"overrides": options.get("overrides", {}) | changes}))
            found.append(fault.name)
    return found


def test_names_differ_and_findings_exist():
    assert len({SOUND, *(fault.name for fault in FAULTS)}) == len(FAULTS) + 1
    assert {kind for fault in FAULTS for kind in fault.findings} <= set(KINDS)


def test_a_force_loop_has_faults_of_the_sensor_and_of_the_surface():
    found = fits({}, fidelity="OneDimensional")
    assert {"nan", "lost samples", "stiffness x10", "surface moved"} <= set(found)
    assert not {"robot pushed", "encoder frozen", "infeasible limits"} & set(found)
    assert "robot pushed" in fits({}, fidelity="Multibody")


@pytest.mark.slow
def test_a_solver_that_gives_up_is_named():
    changes = {"controller": Tagged({}, "InvarianceRobot"), "duration": 0.02}
    faulty = try_faults(
        {}, faults="solver failing", fidelity="OneDimensional", overrides=changes, begin=0.0, engine="sequential"
    )
    sound, row = faulty.rows
    assert sound.status == 0
    assert (row.status, row.named_by, row.finite) == (3, ("solver_fallback",), True)
    assert not {"solver failing"} & set(fits({}, fidelity="OneDimensional"))


def test_two_arms_behind_their_joint_interface_have_faults_of_encoders():
    found = fits("fig_5_3", variant="joint speed")
    assert {"encoder frozen", "encoder nan", "robot pushed", "infeasible limits"} <= set(found)
    assert "nan" not in found


def test_an_unknown_fault_is_refused():
    with pytest.raises(BadInputError, match="unknown fault 'nann': did you mean 'nan'"):
        chosen("inf, nann")
