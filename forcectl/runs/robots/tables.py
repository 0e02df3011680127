"""The report of `forcectl robot`, as tables in the terminal."""

from __future__ import annotations

from collections import Counter

import numpy as np
from pydrake.multibody.tree import BodyIndex, RevoluteJoint
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from forcectl.robot.assumptions import assumed_loop_inertia
from forcectl.runs.robots.proposal import Explorer
from forcectl.runs.robots.report import LoadedRobot, RobotReport
from forcectl.runs.terminal.listing import new_table


def print_robot(report: RobotReport, console: Console) -> None:
    """Print what was read, what is assumed, notes, problems, and what is missing."""
    title = f"{report.model.name if report.model else report.folder}"
    if report.robot is not None:
        tables = [_joints(report.robot, title), _arms(report.robot), _bodies(report.robot.explorer)]
        for table in [*tables, *([_assumed(report.robot)] if report.robot.parameters.assumed else [])]:
            console.print(table)
            console.print()
    for texts, head, style in ((report.notes, "Notes", "dim"), (report.problems, "Problems", "red")):
        if texts:
            console.print(f"[bold]{head}[/]")
            for text in texts:
                console.print(f"[{style}]- {escape(text)}[/]", soft_wrap=True)
            console.print()
    if report.missing:
        console.print("[bold]Missing[/], with proposed values; check them, and paste them into a *.control.yaml file:")
        console.print(escape(report.yaml()), highlight=False, soft_wrap=True)
        console.print()
    if report.advice:
        console.print("[bold]Check[/] of the proposed values:")
        for text in report.advice:
            console.print(f"- {escape(text)}", highlight=False, soft_wrap=True)
        console.print()
    found = f"{len(report.problems)} problem{'s' * (len(report.problems) != 1)}"
    count = f"{len(report.missing)} missing, {found}" if report.read else found
    count += "" if report.robot is not None else "; further missing keys are reported after correction"
    said = "complete" if report.complete else count
    console.print(f"[{'green' if report.complete else 'yellow'}]{escape(str(report.folder))}: {said}[/]")


def _joints(robot: LoadedRobot, title: str) -> Table:
    table, parts = new_table(escape(title), "joint"), robot.explorer.parts
    table.columns[0].no_wrap = False  # a long name is folded, and no number cut
    given = ("from", "to", "unit", "speed\n[1/s]", "accel.\n[1/s2]", "torque\n[Nm]")
    for column in (*given, "gravity\n[Nm]", "inertia\n[kg m2]"):
        table.add_column(escape(column), justify="right", no_wrap=True)
    for i, joint in enumerate(parts.joints):
        turns = isinstance(joint, RevoluteJoint)
        ends = [float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])]
        limits = [joint.velocity_upper_limits()[0], joint.acceleration_upper_limits()[0]]
        limits += [parts.actuators[i].effort_limit(), robot.found.gravity[i], robot.found.inertia[i]]
        shown = [_limit(np.degrees(each) if turns else each) for each in ends]
        table.add_row(escape(joint.name()), *shown, "deg" if turns else "m", *map(_limit, limits))
    table.caption = "gravity, inertia: largest of random postures"
    return table


def _arms(robot: LoadedRobot) -> Table:
    table = new_table("Arms", "arm", "joints", "flange", escape("its place at the default posture [m]"), "its z")
    for name, pose in robot.explorer.poses(robot.posture).items():
        arm = robot.explorer.parts.arms[name]
        place = ", ".join(f"{each:.3f}" for each in pose.translation())
        axis = ", ".join(f"{each + 0.0:.2f}" for each in pose.rotation().matrix()[:, 2].round(2))
        count = len(robot.parameters.arm_joints[arm.joints])
        table.add_row(escape(name), f"{count}", escape(arm.flange_frame.name()), place, axis)
    table.caption = f"reach {robot.found.reach:.2f} m from the first joint of an arm to its flange"
    return table


def _bodies(explorer: Explorer) -> Table:
    plant, inspector = explorer.plant, explorer.scene_graph.model_inspector()
    table = new_table("Links", "link", escape("mass [kg]"), "collision shapes")
    total = 0.0
    for i in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(i))
        shapes = plant.GetCollisionGeometriesForBody(body)
        mass = body.default_mass()
        total += mass
        if mass or shapes:
            kinds = Counter(type(inspector.GetShape(each)).__name__.lower() for each in shapes)
            said = ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "none"
            table.add_row(escape(body.name()), f"{mass:.4g}", said)
    table.caption = f"{total:.4g} kg in all"
    return table


def _assumed(robot: LoadedRobot) -> Table:
    parameters = robot.parameters
    table = new_table("Assumed, because it is left out", "key", "rule", "values")
    for name, rule in parameters.assumed.items():
        value = getattr(parameters, name)
        if name == "velocity_loop_inertia":
            value = assumed_loop_inertia(parameters, robot.explorer.inertia(robot.posture))
            table.caption = "velocity_loop_inertia: without a tool"
        numbers = next(iter(value.values())) if isinstance(value, dict) else value
        table.add_row(name, escape(rule), ", ".join(f"{each:.3g}" for each in numbers))
    return table


def _limit(value: float) -> str:
    if not np.isfinite(value):
        return "none"
    digits = 3 if abs(value) < 1e3 else 4
    return f"{value:.{digits}g}" if abs(value) >= 1e-6 else "0"
