"""A surface that comes closer: refused where the guard could not keep its largest force, and kept otherwise."""

import re

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged
from forcectl.scenario.scenario import build

WAY = 0.004
TEXT = """
duration: 1.5
station: {{fidelity: {fidelity}, environment: {{stiffness: {stiffness}, surface: {{moves: [{move}]}}}}}}
reference: !Step {{force: {force}}}
controller: !{law} {{}}
guard: {guard}
"""


def scenario(stiffness, force, duration, *, law="Integral", fidelity="OneDimensional", way=WAY, guard=None):
    move = f"{{start: 1.0, distance: {way}, duration: {duration!r}}}"
    guard = guard or f"{{maximum_force: {2 * force}}}"
    return TEXT.format(stiffness=stiffness, force=force, move=move, guard=guard, law=law, fidelity=fidelity)


def file_of(folder, *arguments, **options):
    path = folder / "own.yaml"
    path.write_text(scenario(*arguments, **options))
    return path


def shortest(folder, stiffness, force, **options):
    """What the message of a move that takes 10 ms admits [s]."""
    with pytest.raises(BadInputError) as caught:
        build(file_of(folder, stiffness, force, 0.01, **options))
    return float(re.search(r"must be at least ([0-9.e+-]+) s with guard.maximum_force", str(caught.value))[1])


def test_the_message_has_place_numbers_and_what_is_allowed(tmp_path):
    """15 ms at 20 mm/s on springs of 2e5 N/m and the robot's make 8.1 N."""
    with pytest.raises(BadInputError) as caught:
        build(file_of(tmp_path, 2e5, 5.0, 0.2))
    said = "own.yaml:3: station.environment.surface.moves.0.duration = 0.2 s: 4 mm towards the tool on 2e+05 N/m "
    assert str(caught.value).startswith(said)
    assert "raises the force from 5 N to " in str(caught.value)
    assert " N before any command can act: must be at least 0.3" in str(caught.value)


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Multibody"])
def test_what_the_message_names_is_admitted_and_a_little_less_is_not(tmp_path, fidelity):
    bound = shortest(tmp_path, 1e5, 8.0, fidelity=fidelity)
    build(file_of(tmp_path, 1e5, 8.0, bound, fidelity=fidelity))
    with pytest.raises(BadInputError, match="before any command can act"):
        build(file_of(tmp_path, 1e5, 8.0, 0.98 * bound, fidelity=fidelity))


def test_links_that_have_mass_need_more_time(tmp_path):
    bounds = [shortest(tmp_path, 1e5, 8.0, fidelity=name) for name in ("OneDimensional", "Multibody")]
    assert bounds[1] > 1.5 * bounds[0]


@pytest.mark.parametrize(
    "changes",
    [{"guard": "null"}, {"guard": "{}"}, {"way": -WAY}, {"way": 1e-5}],
    ids=["no guard", "no largest force", "away", "a small way"],
)
def test_without_a_largest_force_away_or_a_little_way_is_admitted(tmp_path, changes):
    build(file_of(tmp_path, 2e5, 5.0, 0.02, **changes))


def test_a_controller_without_a_desired_force_is_not_judged(tmp_path):
    """Joint moves have none; what they press with is not known."""
    wrench = Tagged({"part": "station", "signal": "measured_wrench"}, "From")
    changes = {"controller": "!JointMoves", "signals.estimated_wrench": wrench}
    build(file_of(tmp_path, 2e5, 5.0, 0.2), overrides=changes)


@pytest.mark.parametrize(
    ("law", "stiffness", "force"), [("Integral", 3e5, 6.0), ("Pid", 8e4, 4.0), ("DisturbanceObserver", 1.5e5, 11.0)]
)
def test_what_is_admitted_keeps_the_largest_force(tmp_path, law, stiffness, force):
    bound = shortest(tmp_path, stiffness, force, law=law)
    run = fc.run(file_of(tmp_path, stiffness, force, 1.001 * bound, law=law), out=None)
    assert 1.2 * force < float(np.max(run.log["contact_force"])) < 1.2 * 2 * force


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "force"), [(4e4, 7.0), (2.5e5, 12.0)])
def test_so_it_does_on_links_with_mass(tmp_path, stiffness, force):
    bound = shortest(tmp_path, stiffness, force, fidelity="Multibody")
    run = fc.run(file_of(tmp_path, stiffness, force, 1.001 * bound, fidelity="Multibody"), out=None)
    assert 1.2 * force < float(np.max(run.log["contact_force"])) < 1.2 * 2 * force
