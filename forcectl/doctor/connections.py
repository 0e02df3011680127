"""Inputs that are not connected, and outputs that are not used."""

from __future__ import annotations

from collections.abc import Iterator

from pydrake.multibody.plant import MultibodyPlant

from forcectl.doctor.report import Finding, error, info, warning
from forcectl.framework.wiring import optional_inputs
from forcectl.inspect.start import is_library_plant
from forcectl.inspect.wiring import PortAddress, Wiring, is_vector


def _shape(wiring: Wiring, port: PortAddress) -> str:
    return f"size {wiring.port(port).size()}" if is_vector(wiring.port(port)) else "abstract"


def unconnected_inputs(wiring: Wiring) -> Iterator[Finding]:
    """Unconnected inputs at every level; those of the examined diagram itself are only an info."""
    for path, system in wiring.systems.items():
        free = [port for port in wiring.inputs(path) if path and port not in wiring.sources]
        if is_library_plant(system):
            yield from _plant_inputs(wiring, path, free)
        else:
            yield from (_unconnected(wiring, port) for port in free)
    if wiring.root is not None:
        for port in wiring.inputs(""):
            text = f"input of the whole diagram ({_shape(wiring, port)}), not connected from outside"
            yield info("open-diagram-input", wiring.name(port), text)


def _unconnected(wiring: Wiring, port: PortAddress) -> Finding:
    name = wiring.name(port)
    if wiring.port(port).get_name() in optional_inputs(wiring.systems[port.system]):
        return info("optional-input", name, f"optional input ({_shape(wiring, port)}) not connected")
    inner = list(map(wiring.name, wiring.inner_inputs(port)))
    leads = f", which leads to {', '.join(inner)}" if inner and inner != [name] else ""
    return error(
        "unconnected-input",
        name,
        f"input ({_shape(wiring, port)}) is not connected{leads}; connect it to an output, export it, or list it in "
        "the block's optional_inputs",
    )


def _plant_inputs(wiring: Wiring, path: str, free: list[PortAddress]) -> Iterator[Finding]:
    """A plant's inputs are optional, except two that silently change the physics when they are unconnected."""
    system = wiring.systems[path]
    names = {wiring.port(port).get_name() for port in free}
    if names:
        yield info("plant-inputs", path, f"{len(names)} inputs of the plant not connected")
    if not isinstance(system, MultibodyPlant):
        return
    if system.geometry_source_is_registered() and "geometry_query" in names:
        yield error(
            "unconnected-input",
            f"{path}.geometry_query",
            "the plant has geometry but no scene graph that computes its contacts; connect SceneGraph.query to it",
        )
    for index in system.GetJointActuatorIndices():
        actuator = system.get_joint_actuator(index)
        instance = system.GetModelInstanceName(actuator.model_instance())
        if actuator.has_controller() and f"{instance}_desired_state" in names:
            yield warning(
                "gains-without-desired-state",
                f"{path}.{instance}_desired_state",
                f"actuator {actuator.name()} has PD gains but this input is open, so the gains do nothing; connect it",
            )


def unused_outputs(wiring: Wiring) -> Iterator[Finding]:
    """Outputs that are neither connected nor exported, at every level."""
    if wiring.root is None:
        return  # a builder does not tell which outputs it exports
    used = set(wiring.sources.values())
    for path, system in wiring.systems.items():
        unused = [port for port in wiring.outputs(path) if path and port not in used]
        if unused and is_library_plant(system):
            yield info("plant-outputs", path, f"{len(unused)} outputs of the plant not used")
        else:
            yield from (info("unused-output", wiring.name(port), "nothing reads this output") for port in unused)
