"""Components of logged signals, as their blocks or the conventions declare them; they are never guessed from a size.

A block declares the components of a port in an attribute `port_components`: by a shape in the terms of `SIGNALS`, such
as `{"residual": "n"}`, or by `Components` with names of its own. Otherwise a signal has the components of its shape in
`SIGNALS`. Components that are declared nowhere are numbered from 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import OutputPort

from forcectl.conventions import SIGNALS, WRENCH_PARTS, Components
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError, show
from forcectl.framework.block import of_ports

_SHAPES = {signal.shape for signal in SIGNALS.values()}
_ALWAYS = ("n", "a")  # shapes that are vectors even with one element: of a robot with one joint, or one arm


def numbered(name: str, size: int) -> Components:
    """Numbered components, for a signal whose components are declared nowhere."""
    return Components(f"{name}_component", tuple(str(i) for i in range(1, size + 1)))


def components_of(ports: Mapping[str, OutputPort], workcell: Workcell) -> dict[str, Components]:
    """The components of every port that is no scalar, by the name of the signal.

    Raises:
        BadInputError: declared components do not fit the size of their port, or a dimension has two sets of names.
    """
    found: dict[str, Components] = {}
    dimensions: dict[str, tuple[str, ...]] = {}
    for name, port in ports.items():
        made = _of_port(name, port, workcell)
        if made is None:
            continue
        if dimensions.setdefault(made.dimension, made.labels) != made.labels:
            other = ", ".join(dimensions[made.dimension])
            raise _wrong(port, f"has the dimension {made.dimension}", f"of {other}, or another dimension")
        found[name] = made
    return found


def _of_port(name: str, port: OutputPort, workcell: Workcell) -> Components | None:
    size, own = port.size(), port.get_name()
    declared = of_ports(port.get_system(), "port_components").get(own)
    if declared is not None and not _is_allowed(declared):
        shapes = ", ".join(sorted(_SHAPES))
        raise _wrong(port, f"= {show(declared)}", f"one of {shapes}, or Components(dimension, labels, units)")
    known = [SIGNALS[each].shape for each in (name, own) if each in SIGNALS]
    shape = declared or next(iter(known), "")
    if isinstance(shape, str) and size == 1 and shape not in _ALWAYS:
        return None
    made = shape if isinstance(shape, Components) else _of_shape(shape, name, workcell)
    if made is not None and len(made.labels) == size:
        return made
    if declared:
        labels = shape if isinstance(shape, str) else ", ".join(shape.labels)
        raise _wrong(port, f"has size {size}", f"{len(made.labels) if made else shape} ({labels})")
    return numbered(name, size) if size > 1 else None


def _is_allowed(declared: Any) -> bool:
    if isinstance(declared, str):
        return declared in _SHAPES
    if not isinstance(declared, Components):
        return False
    texts = (declared.dimension, *declared.labels, *declared.units)
    return all(isinstance(each, str) for each in texts) and len(declared.units) in (0, len(declared.labels))


def _wrong(port: OutputPort, fault: str, allowed: str) -> BadInputError:
    where = f"block {port.get_system().get_name()!r}: port_components: {port.get_name()}"
    return BadInputError(f"{where} {fault}: must be {allowed}")


def _of_shape(shape: str, name: str, workcell: Workcell) -> Components | None:
    """The components of a shape of `SIGNALS`; None for a shape without named components."""
    arms, parts = list(workcell.robot.parts.arms), workcell.parts
    held = [part for part, config in parts.items() if config.arm]
    units = ("Nm",) * 3 + ("N",) * 3
    several = {"3m": (f"{name}_component", parts, "xyz"), "4m": (f"{name}_component", parts, "wxyz")}
    if shape in several:
        dimension, things, letters = several[shape]
        return Components(dimension, tuple(f"{thing}_{letter}" for thing in things for letter in letters))
    known = {
        "n": Components("joint", tuple(workcell.robot.parameters.arm_joints)),
        "a": Components("arm", tuple(arms)),
        "k": Components("surface", tuple(contact.name for contact in workcell.contacts)),
        "h": Components("held_part", tuple(held)),
        "6": Components("contact_component", WRENCH_PARTS, units),
        "6a": Components(
            "wrench_component", tuple(f"{arm}_{part}" for arm in arms for part in WRENCH_PARTS), units * len(arms)
        ),
    }
    return known.get(shape)
