"""What the fidelities without dynamics share: one surface, motor side, sensors and truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System

from forcectl.diagrams.mechanics.assembly import Assembly
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.mechanics.truth import add_contact_state
from forcectl.diagrams.workcell import Vector, Workcell
from forcectl.errors import BadInputError
from forcectl.framework.wiring import add_part, affine
from forcectl.plant.tip_kinematics import LinkPosition


def check_light(workcell: Workcell, name: str) -> None:
    """Whether a workcell can be realised without dynamics.

    Args:
        workcell: the workcell.
        name: of the fidelity.

    Raises:
        BadInputError: a part that needs dynamics.
    """
    needs = f"a fidelity with dynamics, such as Multibody, not {name}"
    if len(workcell.contacts) != 1:
        raise BadInputError(f" has {len(workcell.contacts)} surfaces: must have one, or {needs}", key="environment")
    if workcell.obstacles:
        raise BadInputError(f" has boxes ({', '.join(workcell.obstacles)}): must have {needs}", key="environment")
    if workcell.config.loads:
        raise BadInputError(f"must be empty, or have {needs}", key="loads")
    if workcell.config.faults:
        raise BadInputError(f"must be empty, or have {needs}", key="faults")


def add_drive(assembly: Assembly, workcell: Workcell, seed: int) -> System:
    """Add the drive of a station without dynamics.

    Raises:
        BadInputError: it lacks the motor side's position.
    """
    drive = add_part(workcell.config.drive, "drive", assembly.builder, Site(workcell, seed))
    assembly.add(drive)
    for name in ("motor_position", "motor_velocity"):
        if name not in assembly.signals:
            raise BadInputError(f" has no output {name}: must have it in this fidelity", key="drive")
    return drive


def along_normal(builder: DiagramBuilder, row: Vector, start: Vector, position: OutputPort) -> OutputPort:
    """Displacement of the tool along n by the constant Jacobian of the start, shape (1,) [m].

    Args:
        builder: of the station.
        row: n'J, shape (n,) [m/rad].
        start: motor positions at the start, shape (n,) [rad].
        position: of the motors, shape (n,) [rad].
    """
    block = builder.AddNamedSystem("motor_displacement", affine(row.reshape(1, -1), np.array([-row @ start])))
    builder.Connect(position, block.get_input_port())
    return block.get_output_port()


def finish_light_station(
    station: Diagram,
    assembly: Assembly,
    workcell: Workcell,
    seed: int,
    force: OutputPort,
    displacement: OutputPort,
    surface: Mapping[str, OutputPort],
) -> None:
    """Sensors, truth and exported ports of a station without dynamics.

    Args:
        station: is built.
        assembly: with the drive.
        workcell: the workcell.
        seed: of the sensors.
        force: true contact force, shape (1,) [N].
        displacement: of the tool along n by the motors, shape (1,) [m].
        surface: truth of the surface, by name.
    """
    builder, contact = assembly.builder, workcell.contact
    for name, port in (("contact_force", force), ("contact_displacement", displacement)):
        assembly.offer(name, port)
    links = builder.AddNamedSystem("link_position", LinkPosition(contact.robot, contact.n, workcell.spring_stiffness))
    assembly.add(links)
    add_sensors(assembly, Site(workcell, seed))
    assembly.offer("contact_state", add_contact_state(builder, force))
    for name, port in surface.items():
        assembly.offer(name, port)
    assembly.finish(station)


def add_sensors(assembly: Assembly, site: Site) -> None:
    """Add the sensors of a station.

    Args:
        assembly: of the station.
        site: without the seed of a sensor; every sensor has its own.
    """
    for i, (name, sensor) in enumerate(site.workcell.config.sensors.items()):
        before = set(assembly.signals)
        assembly.add_sensor(add_part(sensor, f"sensors.{name}", assembly.builder, site.with_seed(i)), name)
        if set(assembly.signals) == before:
            raise BadInputError(" has no output port: must measure something", key=f"sensors.{name}")
