"""A block of the user's own as a surface: a class of one's own, or a subclass of the shipped one with its `add_to`."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

import forcectl as fc
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from forcectl.plant.contact.surface import SurfaceConfig, WaveConfig

K = 3.0e6  # of F = K d^1.5 [N/m^1.5]
FIDELITIES = ["OneDimensional", "Kinematic", "Multibody"]


class Block(LeafSystem):
    """F = K d^1.5, with whatever further ports a test is about."""

    def __init__(self, inputs: dict[str, int], outputs: dict[str, int]):
        super().__init__()
        ports = {name: self.DeclareVectorInputPort(name, size) for name, size in inputs.items()}
        reads = {port.ticket() for port in ports.values()} or {self.nothing_ticket()}

        def force(context: Any, output: Any) -> None:
            for port in ports.values():
                port.Eval(context)
            depth = np.maximum(-ports["displacement"].Eval(context)[0], 0.0)
            output.SetFromVector(np.full(output.size(), K * depth**1.5))

        for name, size in outputs.items():
            self.DeclareVectorOutputPort(name, size, force, reads)


@dataclass(kw_only=True)
class MySurface(EnvironmentConfig):
    """The shipped surface with a force of its own."""

    def add_to(self, builder, size, period, *, robot_compliance):
        return builder.AddNamedSystem("my_contact", Block({"displacement": 1}, {"contact_force": 1}))


class Reading(LeafSystem):
    """A sensor of the true force."""

    def __init__(self):
        super().__init__()
        force = self.DeclareVectorInputPort("contact_force", 1)
        self.DeclareVectorOutputPort("measured_force", 1, lambda c, o: o.SetFromVector(force.Eval(c)))


class TrueForce:
    """Configuration of `Reading`."""

    def add_to(self, builder, site):
        return builder.AddNamedSystem("reading", Reading())


def pressed(environment: Any, fidelity: str, **motion: float) -> fc.RunResult:
    station = {"environment": environment, "fidelity": fidelity, "sensors": {"force": TrueForce()}}
    return fc.run({"station": station, "duration": 0.3} | ({"motion": motion} if motion else {}))


@pytest.mark.parametrize("parts", [False, True])
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_block_of_a_subclass_makes_the_force(fidelity: str, parts: bool) -> None:
    surface: Any = MySurface(stiffness=9.0e3)
    log = pressed(EnvironmentPartsConfig(parts={"plate": surface}) if parts else surface, fidelity).log
    loaded = log["contact_force"].values.ravel()
    linear = pressed(EnvironmentConfig(stiffness=9.0e3), fidelity).log["contact_force"].values.ravel()
    assert loaded.max() > 5.0
    assert np.abs(loaded - linear).max() > 1.0
    if fidelity == "Kinematic":  # of the motors and the true force alone
        depth = -log["contact_displacement"].values.ravel()
        np.testing.assert_allclose(loaded, K * np.maximum(depth, 0.0) ** 1.5, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_block_of_a_subclass_is_raised_to_the_heights(fidelity: str) -> None:
    surface = SurfaceConfig(heights={"waves": WaveConfig(amplitude=2.0e-4)})
    log = pressed(MySurface(surface=surface), fidelity, distance=0.02, speed=0.1, start_time=0.0).log
    assert np.ptp(log["surface_height"].values) > 5.0e-5
    if fidelity == "Kinematic":
        depth = (log["surface_height"].values - log["contact_displacement"].values).ravel()
        force = K * np.maximum(depth, 0.0) ** 1.5
        np.testing.assert_allclose(log["contact_force"].values.ravel(), force, rtol=1e-9, atol=1e-9)


@dataclass(kw_only=True)
class Odd:
    """A surface with these ports."""

    inputs: Any
    outputs: Any
    first_stiffness: Any = 2.0e4

    def add_to(self, builder, size, period, *, robot_compliance):
        return builder.AddNamedSystem("odd", Block(self.inputs, self.outputs))


def refusal(environment: Any, fidelity: str) -> str:
    with pytest.raises(fc.BadInputError) as caught:
        pressed(environment, fidelity)
    assert "\n" not in str(caught.value)
    return str(caught.value)


GOOD_IN, GOOD_OUT = {"displacement": 1}, {"contact_force": 1}


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize(
    ("inputs", "outputs", "told"),
    [
        ({"depth": 1}, {}, "has no input displacement: must have it, of size 1"),
        (GOOD_IN, {"force": 1}, "has no output contact_force: must have it, of size 1"),
        ({"displacement": 3}, GOOD_OUT, "reads displacement of size 3: must be 1"),
        (GOOD_IN, {"contact_force": 2}, "outputs contact_force of size 2: must be 1"),
        (GOOD_IN | {"humidity": 1}, GOOD_OUT, "reads humidity, which no part outputs: must be one of "),
        (GOOD_IN | {"motor_position": 3}, GOOD_OUT, "reads motor_position of size 3: must be 6"),
    ],
)
def test_a_misfit_of_the_block_is_one_of_the_environment(inputs: Any, outputs: Any, told: str, fidelity: str) -> None:
    assert f"station.environment {told}" in refusal(Odd(inputs=inputs, outputs=outputs), fidelity)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_a_further_input_is_the_signal_of_its_name(fidelity: str) -> None:
    surface = Odd(inputs=GOOD_IN | {"motor_position": 6}, outputs=GOOD_OUT)
    assert pressed(surface, fidelity).log["contact_force"].values.max() > 5.0


def test_what_a_force_along_the_normal_cannot_be_is_refused() -> None:
    told = "must be 0 with an add_to of its own: the block of a subclass computes a force along the normal only"
    assert f"station.environment.friction = 0.3: {told}" in refusal(MySurface(friction=0.3), "Multibody")
    with pytest.raises(
        fc.BadInputError, match=r"station\.sensors\.force: environment 'environment' has no body whose force"
    ):
        fc.build({"station": {"fidelity": "Multibody", "environment": MySurface()}})
