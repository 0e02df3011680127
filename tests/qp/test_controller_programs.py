"""`controller.program(context)`: the last tick's program with names, its optimum is the command, by any solver."""

import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydrake import solvers
from pydrake.systems.analysis import Simulator

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from forcectl.errors import BadInputError
from forcectl.force.governor.governor import CommandGovernor, GovernedConfig
from forcectl.force.invariance.robot import InvarianceRobotConfig
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import DaqpPackage, Solver, available_solvers, drake_daqp, exact_options, make_solver
from forcectl.tasks.controllers.reaching import ReactiveReachingConfig
from tests.examples.program_runs import EXACT, Case, cases, solved, ticks
from tests.examples.reactive_examples import reactive_controller
from tests.examples.robot_controller_runs import make, robot_plant_model

CASES = cases()
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def names(bindings: Any) -> list[str]:
    return [binding.evaluator().get_description() for binding in bindings]


def fix(block: Any, context: Any, case: Case, t: float = 0.0, **changes: Any) -> None:
    for name, value in case.inputs.items():
        given = np.asarray(changes.get(name, value(t)), dtype=float)
        block.GetInputPort(name).FixValue(context, np.atleast_1d(given))


def advanced(name: str, t: float, **changes: Any) -> tuple[Any, Any, Any]:
    """A controller whose inputs are constant, at a time between two ticks."""
    block, case = CASES[name].block("daqp"), CASES[name]
    simulator = Simulator(block)
    fix(block, simulator.get_mutable_context(), case, 0.05, **changes)
    simulator.Initialize()
    simulator.AdvanceTo(t)
    return block, simulator, simulator.get_mutable_context()


# --- what it commands -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@every_case
def test_another_solver_gives_the_same_command(case: Case) -> None:
    block, bound, looked = case.block("daqp"), 0, 0
    for k, context in enumerate(ticks(block, case, 220)):
        command = case.command(block, context)
        status = block.GetOutputPort("status").Eval(context).item()
        if k % 22 or status >= Status.INFEASIBLE:
            continue
        program = block.program(context)
        answers = {kind: solved(program, kind) for kind in EXACT}
        for kind, answer in answers.items():
            np.testing.assert_allclose(answer[: len(command)], command, atol=1e-6, err_msg=kind)
        x, looked = answers["OsqpSolver"], looked + 1
        bound += any(
            (program.EvalBinding(row, x) > row.evaluator().upper_bound() - 1e-5).any()
            for row in (*program.linear_constraints(), *program.bounding_box_constraints())
        )
    assert looked >= 4
    assert bound >= 1


@pytest.mark.parametrize("horizon", [1, 8])
def test_a_governor_whose_force_is_out_of_reach_is_solved_by_solvers_that_finish_on_a_vertex(horizon: int) -> None:
    """Clarabel does not solve these: the cost of the slack is out of all proportion, see `CommandGovernor.program`."""
    block = CommandGovernor(
        1, horizon=horizon, rate_limit=200.0, upper_limit=30.0, upper_force=10.5, delay=0.02, initial_force=30.0
    )
    forces = {"desired_force": lambda t: 20.0, "measured_force": lambda t: 30 - 5 * t}
    case = CASES["governor, one tick"]._replace(inputs=forces)
    for context in ticks(block, case, 20):
        command = case.command(block, context)
        program = block.program(context)
        assert program.decision_variables()[-1].get_name().startswith("slack of force")
        for kind in EXACT.keys() - {"ClarabelSolver"}:
            np.testing.assert_allclose(solved(program, kind)[:1], command, atol=1e-6)


@pytest.mark.parametrize("name", ["reactive, speeds", "reactive, torques"])
def test_every_level_of_the_reactive_controller_has_its_program(name: str) -> None:
    case = CASES[name]
    block = case.block("daqp")
    for k, context in enumerate(ticks(block, case, 60)):
        command = case.command(block, context)
        if k % 9 or block.GetOutputPort("levels_solved").Eval(context).item() < 2:
            continue
        first, second = (solved(block.program(context, level), "ClarabelSolver") for level in (1, 2))
        equal = block.program(context, 2).linear_equality_constraints()
        assert len(equal) == 12
        J = np.vstack([row.evaluator().GetDenseA() for row in equal])
        np.testing.assert_allclose(second, command, atol=1e-6)
        # The first level leaves joints to the second, which keeps its tasks.
        np.testing.assert_allclose(J @ first, J @ second, atol=1e-6)
        assert np.linalg.norm(first - second) < np.linalg.norm(first) + 1.0


def closed_loop(case: Case, solver: str | Solver, number: int = 250) -> tuple[np.ndarray, np.ndarray]:
    """Commanded joint positions or references of a run, and its statuses."""
    block = case.block(solver)
    ports = [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
    held = {"joint_position_command", "governed_reference"}
    command = block.GetOutputPort(next(name for name in ports if name in held))
    status = block.GetOutputPort("status")
    found = [(command.Eval(each), status.Eval(each).item()) for each in ticks(block, case, number)]
    commands, statuses = zip(*found, strict=True)
    return np.array(commands), np.array(statuses)


@cache
def expected_loop(name: str) -> tuple[np.ndarray, np.ndarray]:
    """What the daqp package commands, which every other path is compared with."""
    return closed_loop(CASES[name], DaqpPackage())


def drakes_daqp() -> Solver:
    if not hasattr(solvers, "DaqpSolver"):
        pytest.skip("this Drake has no DaqpSolver; the daqp package takes its place")
    return drake_daqp()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("path", ["the one in use", "Drake's DAQP"])
def test_the_paths_of_daqp_give_the_same_closed_loop(name: str, path: str) -> None:
    solver = "daqp" if path == "the one in use" else drakes_daqp()
    expected, statuses = expected_loop(name)
    command, found = closed_loop(CASES[name], solver)
    np.testing.assert_allclose(command, expected, atol=1e-9)
    np.testing.assert_array_equal(found, statuses)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_an_interior_point_solver_gives_the_closed_loop_to_its_accuracy(name: str) -> None:
    """It is good to 1e-6 in u [rad/s^2 or N]: in a second that adds up to half of it in a position [rad]."""
    expected, statuses = expected_loop(name)
    command, found = closed_loop(CASES[name], "clarabel")
    np.testing.assert_allclose(command, expected, atol=1e-6)
    np.testing.assert_array_equal(found, statuses)


# --- which tick it is of ----------------------------------------------------------------------------------------------


def numbers(program: Any) -> list[np.ndarray]:
    """All coefficients of a program."""
    found = [each.evaluator().Q() for each in program.quadratic_costs()]
    found += [each.evaluator().b() for each in program.quadratic_costs()]
    for row in (*program.linear_constraints(), *program.bounding_box_constraints()):
        found += [row.evaluator().lower_bound(), row.evaluator().upper_bound()]
    return [np.array(each) for each in found + [row.evaluator().GetDenseA() for row in program.linear_constraints()]]


def alike(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return len(a) == len(b) and all(np.array_equal(*pair) for pair in zip(a, b, strict=True))


CHANGED = {
    "invariance, wall and maximum force": {"desired_force": [3.0]},
    "reactive, speeds": {"task_velocity_reference": np.full(12, 0.01)},
    "governor, eight ticks": {"desired_force": [3.0]},
}


@pytest.mark.parametrize("name", CHANGED)
def test_it_is_the_program_of_the_last_tick_whatever_the_inputs_are_since(name: str) -> None:
    period = CASES[name].period
    block, simulator, context = advanced(name, 10.4 * period)
    then = numbers(block.program(context))
    fix(block, context, CASES[name], 0.05, **CHANGED[name])
    assert alike(numbers(block.program(context)), then)
    simulator.AdvanceTo(10.9 * period)
    assert alike(numbers(block.program(context)), then)
    simulator.AdvanceTo(11.4 * period)
    assert not alike(numbers(block.program(context)), then)


@pytest.mark.parametrize("name", CHANGED)
def test_looking_changes_nothing(name: str) -> None:
    period = CASES[name].period
    looked, simulator, context = advanced(name, 5.5 * period)
    for k in range(6, 12):
        looked.program(context)
        simulator.AdvanceTo((k + 0.5) * period)
    _, other, there = advanced(name, 5.5 * period)
    other.AdvanceTo(11.5 * period)
    for i in range(context.num_discrete_state_groups()):
        np.testing.assert_array_equal(context.get_discrete_state(i).value(), there.get_discrete_state(i).value())


@pytest.mark.parametrize("name", CHANGED)
def test_two_contexts_have_two_programs_and_a_clone_has_its_own(name: str) -> None:
    period = CASES[name].period
    block, simulator, context = advanced(name, 3.5 * period)
    clone = context.Clone()
    simulator.AdvanceTo(30.5 * period)
    now, then = block.program(context), block.program(clone)
    assert now is not then
    assert not alike(numbers(now), numbers(then))
    before = numbers(then)
    simulator.AdvanceTo(40.5 * period)
    block.program(context)
    assert alike(numbers(then), before)
    again, _, there = advanced(name, 3.5 * period)
    assert alike(numbers(again.program(there)), before)


@pytest.mark.parametrize("name", CHANGED)
def test_it_is_built_once_and_filled_anew(name: str) -> None:
    block, simulator, context = advanced(name, 3.5 * CASES[name].period)
    program = block.program(context)
    before = numbers(program)
    simulator.AdvanceTo(30.5 * CASES[name].period)
    assert block.program(context) is program
    assert not alike(numbers(program), before)


# --- names ------------------------------------------------------------------------------------------------------------


def test_everything_in_the_program_of_the_force_controller_has_a_name() -> None:
    block, _, context = advanced("invariance, wall and maximum force", 0.0211)
    program = block.program(context)
    joints = [joint.name() for joint in robot_plant_model().robot.parts.joints]
    assert [v.get_name() for v in program.decision_variables()] == [f"u[{joint}]" for joint in joints]
    rows = names(program.linear_constraints())
    assert rows[:3] == ["force", "maximum force 1", "wall 1"]
    # The torques bind nothing here, and no tick asked for their rows; they are there all the same.
    assert rows[3:] == [f"torque limit {side} {joint}" for side in ("upper", "lower") for joint in joints]
    assert all(np.isfinite(each.evaluator().upper_bound()).all() for each in program.linear_constraints())
    assert names(program.bounding_box_constraints()) == ["position, speed and acceleration limits of the joints"]
    text = str(program)
    for name in rows:
        assert re.search(rf"described as '{re.escape(name)}'", text)


def test_everything_in_the_programs_of_the_reactive_controller_has_a_name() -> None:
    block, _, context = advanced("reactive, speeds", 0.0211)
    first, second = (block.program(context, level) for level in (1, 2))
    for program, cost in ((first, "tasks of level 1"), (second, "criterion of the null space")):
        rows = names(program.linear_constraints())
        assert "speed limit 1: upper left x" in rows
        assert "speed limit 2: lower right psi" in rows
        assert len(set(rows)) == len(rows) == block.num_rows
        assert names(program.quadratic_costs()) == [cost]
    equal = names(second.linear_equality_constraints())
    assert equal[0] == "left x as above"
    assert len(equal) == 12
    assert not first.linear_equality_constraints()


def test_rows_of_link_distances_name_the_pair_that_they_are_of_in_the_tick() -> None:
    distance = LinkDistance(RobotShapes.load("yumi", "yumi_gripper"))
    case = CASES["reactive, speeds"]
    block = reactive_controller(constraints=[distance])
    (*_, context) = ticks(block, case, 8)
    first, second = (names(block.program(context, level).linear_constraints()) for level in (1, 2))
    assert first == second
    slowed, kept = first[:4], first[4 : 4 + distance.rows]
    assert [name.partition(",")[0] for name in kept] == [f"link distance 1: row {i + 1}" for i in range(distance.rows)]
    pairs = [name.partition(", ")[2] for name in kept]
    assert distance.nearest(block.last_tick(context).memory["joint_position_command"]).partition(" are ")[0] in pairs
    assert len(set(pairs)) > 1
    assert all(name.startswith("slow down 1: row ") and name.partition(", ")[2] in pairs for name in slowed)


def test_a_tick_with_slack_names_it() -> None:
    case = CASES["reactive, slack"]
    block = case.block("daqp")
    for context in ticks(block, case, 100):
        status = block.GetOutputPort("status").Eval(context).item()
        if status == Status.SLACK:
            break
    assert status == Status.SLACK
    program = block.program(context, 1)
    assert program.decision_variables()[-1].get_name() == "slack of pushing 1"
    slack = solved(program, "OsqpSolver")[-1]
    assert slack == pytest.approx(block.GetOutputPort("slack").Eval(context).item(), abs=1e-6)


def test_everything_in_the_program_of_the_governor_has_a_name() -> None:
    block, _, context = advanced("governor, eight ticks", 0.0211)
    program = block.program(context)
    assert [v.get_name() for v in program.decision_variables()][:2] == ["r[t]", "r[t+1]"]
    assert names(program.linear_constraints())[::8] == ["change to r[t]", "force after r[t]"]
    with pytest.raises(BadInputError, match="element = 1: must be from 0 to 0"):
        block.program(context, 1)


# --- what there is no program of --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CHANGED)
def test_a_tick_with_an_input_that_is_no_number_has_none(name: str) -> None:
    bad = {port: np.full_like(np.asarray(value, dtype=float), np.nan) for port, value in CHANGED[name].items()}
    block, _, context = advanced(name, 3.5 * CASES[name].period, **bad)
    with pytest.raises(BadInputError, match=r"program: the last tick had none: \w+"):
        block.program(context)


@pytest.mark.parametrize("level", [0, 3, True, "first"])
def test_a_level_that_is_not_there_is_refused(level: Any) -> None:
    block, _, context = advanced("reactive, speeds", 0.0211)
    with pytest.raises(BadInputError, match=r"level = .*: must be from 1 to 2"):
        block.program(context, level)


# --- the key ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["simplex", "gurobi", "DaqpSolver", "", 3, None])
def test_a_solver_that_is_unknown_or_not_available_is_refused_with_those_that_are(name: Any) -> None:
    with pytest.raises(BadInputError, match=r"^solver = .*: must be one of daqp, clarabel, .*osqp"):
        make_solver(name)
    for config in (InvarianceRobotConfig, GovernedConfig, ReactiveReachingConfig):
        known = r"unknown solver .* known: daqp, clarabel, .*osqp"
        with pytest.raises(BadInputError, match=rf"^solver(: {known}| = (3|None): must be text)") as found:
            config(solver=name)
        assert "\n" not in str(found.value)


@pytest.mark.parametrize("name", available_solvers())
def test_every_solver_that_is_offered_commands_a_robot(name: str) -> None:
    case = CASES["invariance, torques"]
    command, statuses = closed_loop(case, name, 60)
    assert not statuses.any()
    np.testing.assert_allclose(command, expected_loop("invariance, torques")[0][:60], atol=1e-8)


@pytest.mark.parametrize("name", ["simplex", "osqp_one_step", 3])
def test_options_are_those_of_drakes_solvers(name: Any) -> None:
    with pytest.raises(BadInputError, match=r"^solver = .*: must be one of .*clarabel, .*osqp, Drake's available here"):
        exact_options(name)


def test_a_governor_says_that_it_does_not_keep_what_its_ticks_start_from() -> None:
    block, simulator, context = advanced("governor, eight ticks", 0.02)
    for t in (0.02, 0.0211):  # at a tick, and between two
        simulator.AdvanceTo(t)
        with pytest.raises(BadInputError, match="last_tick: a CommandGovernor does not keep what its ticks start from"):
            block.last_tick(context)


def test_steps_of_a_guarded_move_are_added_behind_the_program() -> None:
    case = CASES["invariance, wall and maximum force"]
    block = make(approached=True)
    inputs = {**case.inputs, "desired_force": lambda t: 0.0, "approach_displacement": lambda t: -1e-5 * (t > 0.02)}
    (*_, context) = ticks(block, case._replace(inputs=inputs), 12)
    before, after = block.last_tick(context).memory, block.memory(context)
    assert after["approach_displacement"] < before["approach_displacement"]
    u = solved(block.program(context), "OsqpSolver")[:6]
    speeds = after["joint_velocity_command"] - before["joint_velocity_command"]
    np.testing.assert_allclose(u, speeds / case.period, atol=1e-6)
    assert np.abs(u - case.command(block, context)).max() > 1.0


def test_a_block_takes_a_name_or_a_solver() -> None:
    for kind in ("clarabel", make_solver("clarabel")):
        make(solver=kind)
        CommandGovernor(1, solver=kind)
    with pytest.raises(BadInputError, match="solver = 'none'"):
        make(solver="none")
    with pytest.raises(BadInputError, match="solver = 'none'"):
        CommandGovernor(1, solver="none")
