"""A fault in Drake's integration scheme CENIC: actuator gains with a desired velocity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.analysis import ExtractSimulatorConfig, GetIntegrationSchemes, Simulator
from pydrake.systems.framework import InputPort
from pydrake.systems.primitives import ConstantVectorSource

from forcectl.doctor.report import Finding, error
from forcectl.errors import unknown
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import PortAddress, Wiring, context_of

CENIC = "cenic"


def scheme_name(scheme: str | Simulator | None) -> str:
    """Name of the integration scheme, "" for an unknown one.

    Raises:
        BadInputError: no scheme of Drake has this name.
    """
    if isinstance(scheme, Simulator):
        return str(ExtractSimulatorConfig(scheme).integration_scheme)
    known = {CENIC, *GetIntegrationSchemes()}
    if scheme is not None and scheme not in known:
        raise unknown("integration scheme", scheme, known)
    return scheme or ""


def refused_scheme(values: StartValues, scheme: str) -> Iterator[Finding]:
    """An error where actuator PD gains may get a nonzero desired velocity, to which CENIC gives the wrong sign."""
    if scheme != CENIC:
        return
    for path, plant in values.wiring.leaves():
        if not isinstance(plant, MultibodyPlant):
            continue
        for instance in _damped_instances(plant):
            port = plant.get_desired_state_input_port(instance)
            if _may_carry_velocity(values, path, port):
                yield error(
                    "cenic-desired-velocity",
                    f"{path}.{port.get_name()}",
                    "Drake's CENIC scheme takes the desired velocity of actuator gains with the wrong sign (the joint "
                    "runs backwards), and this input is not a constant zero velocity; use another scheme, such as "
                    "runge_kutta3",
                )


def _damped_instances(plant: MultibodyPlant) -> list[ModelInstanceIndex]:
    """Model instances with an actuator whose gain on the velocity error is not zero."""
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    damped = [a for a in actuators if a.has_controller() and a.get_controller_gains().d != 0]
    return list(dict.fromkeys(actuator.model_instance() for actuator in damped))


def _may_carry_velocity(values: StartValues, path: str, port: InputPort) -> bool:
    """Whether the velocities of a desired state (positions, then velocities) could differ from zero at some time."""
    reader = PortAddress("input", path, int(port.get_index()))
    if values.wiring.source(reader) is None:
        return False  # without a desired state the gains are not used
    if not _is_constant(values.wiring, reader):
        return True
    try:
        state = port.Eval(context_of(values.wiring.systems[path], values.wiring.root, values.root))
    except FAILURES:
        return True
    return bool(np.any(state[len(state) // 2 :] != 0))


def _is_constant(wiring: Wiring, reader: PortAddress) -> bool:
    """Whether an input comes from constant sources alone, through blocks without state and time."""
    source = wiring.source(reader)
    if source is None or not source.system:
        return False
    block = wiring.systems[source.system]
    if isinstance(block, ConstantVectorSource):
        return True
    passed = wiring.passed(source)
    plain = (
        type(block).__module__.startswith("pydrake.systems.primitives") and block.CreateDefaultContext().is_stateless()
    )
    return plain and bool(passed) and all(_is_constant(wiring, reader) for reader in passed)
