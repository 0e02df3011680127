"""Common parts of the scalar force laws: ports, limits of the command, compliance as a parameter or an input."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import BatchParameter, BatchValue, check_order
from forcectl.framework.linear_batch import state_space
from forcectl.framework.sampled_block import SampledBatch
from forcectl.framework.wiring import input_names, output_names
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace

FORCES = ("desired_force", "measured_force")  # inputs of every force law
_SMALL = 1e-9  # [m, N, m/s] step of finite differences, within all limits


def require_force_law(law: System, inputs: Iterable[str]) -> None:
    """Refuse a system that is no force law: a controller of joints, or one that lacks a port.

    Args:
        law: any system.
        inputs: ports that it must have beside the output displacement_command.

    Raises:
        BadInputError: it is no force law.
    """
    inputs = list(inputs)
    if "joint_position_command" in output_names(law):
        raise BadInputError(f"{type(law).__name__} commands joints: must be a force law, which commands displacements")
    if "displacement_command" not in output_names(law) or not set(inputs) <= set(input_names(law)):
        wanted = ", ".join([*inputs, "displacement_command"])
        raise BadInputError(f"{type(law).__name__} is no force law: must have {wanted}")


def model_bandwidth(law: Any) -> float | None:
    """Bandwidth [rad/s] of the nominal closed loop of a configuration; None where it has none."""
    return getattr(law, "reference_model_bandwidth", lambda: None)()


def low_pass(last: BatchValue, value: BatchValue, filter_time: BatchValue, period: float) -> BatchValue:
    """One tick of the first-order lag 1/(1 + s T): y[k] = y[k-1] + (u[k] - y[k-1]) Ts/(T + Ts), backward differences.

    Args:
        last: y[k-1].
        value: u[k].
        filter_time: T [s], >= 0; 0: y = u.
        period: Ts [s].
    """
    return last + (value - last) * (period / (filter_time + period))


class ForceLaw(SampledBatch):
    """Base of the laws of n independent force loops: forces in, a limited displacement command out.

    Inputs: desired_force, measured_force, the `inputs` of the law, and compliance where it is used and not given. The
    parameters of a law are followed by lower_limit, upper_limit and a given compliance. The command starts at zero.

    Args:
        size: n.
        parameters: of the law itself.
        memory: states besides the command, by name, with their initial values.
        period: tick [s].
        lower_limit: of the command, a number or shape (n,) [m].
        upper_limit: the same.
        compliance: C_T_hat, a number or shape (n,) [m/N]; None: from the port.
        inputs: names of further inputs, of shape (n,).
        shows: names of outputs besides the command, which show the states of these names.
    """

    # Whether the law has a compliance in its model, and the input that the command follows within the tick.
    uses_compliance = True
    follows = "measured_force"

    def __init__(
        self,
        size: int,
        parameters: Mapping[str, BatchParameter],
        memory: Mapping[str, ArrayLike],
        period: float,
        *,
        lower_limit: ArrayLike,
        upper_limit: ArrayLike,
        compliance: ArrayLike | None = None,
        inputs: Sequence[str] = (),
        shows: Sequence[str] = (),
    ):
        further = {
            "lower_limit": BatchParameter(lower_limit, "a number", "m"),
            "upper_limit": BatchParameter(upper_limit, "a number", "m"),
        }
        names = [*FORCES, *inputs]
        if compliance is not None:
            further["compliance"] = BatchParameter(compliance, "positive and finite", "m/N")
        elif self.uses_compliance:
            names.append("compliance")
        super().__init__(size, {**parameters, **further})
        self.sample_delay = {(self.follows, "displacement_command"): 0.0}
        ports = [self.DeclareVectorInputPort(name, size) for name in names]
        self.declare_memory({"displacement_command": 0.0, **memory}, ports, period)
        self.show("displacement_command", *shows)

    def check_together(self, values: Mapping[str, Array]) -> None:
        """Check that the limits are in order."""
        check_order("lower_limit", "upper_limit", values)

    def sampled_response(self) -> StateSpace:
        """From the measured force to [command, its rate] within the limits, of a linear law of one loop, n = 1.

        The rate, which no drive uses, is zero. The matrices are finite differences of one tick.
        """
        context = self.CreateDefaultContext()
        rest = dict.fromkeys(self._inputs, 0.0)
        start = self.step(context, self.held(context), rest) | {"time": 0.0}
        packed = self._pack(start)
        numbers = range(1, len(packed))  # element 0 is the time

        def after(state: Array, force: float) -> Array:
            memory = self.step(context, self._unpack(state), rest | {"measured_force": force})
            return (self._pack(memory | {"time": 0.0}) - packed)[1:] / _SMALL

        a = np.transpose([after(packed + _SMALL * np.eye(len(packed))[i], 0.0) for i in numbers])
        b = after(packed, _SMALL)[:, None]
        # Leave out states that the force does not reach: the lag of the desired force, an adaptation of rate zero.
        moved = b[:, 0] != 0.0
        for _ in numbers:
            moved = moved | (np.abs(a) @ moved > 0.0)
        command = np.flatnonzero(moved).tolist().index(self._numbers.index("displacement_command") - 1)
        a, b = a[np.ix_(moved, moved)], b[moved]
        pick = np.vstack([np.eye(len(a))[command], np.zeros(len(a))])
        return state_space(a, b, pick @ a, pick @ b, self._period)


class LawConfig:
    """Base of the configurations of laws with a model of the compliance."""

    compliance_error: float

    @abstractmethod
    def law(self, model: PlantModel, compliance: ArrayLike | None) -> ForceLaw | Diagram:
        """The block with this modelled total compliance [m/N], or with an input port for it (None)."""

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """Add the law; its modelled compliance is `compliance_error` times the true total compliance."""
        return builder.AddNamedSystem("force_law", self.law(model, self.compliance_error * model.total_compliance))


class LinearLawConfig:
    """Base of the configurations of linear laws that need only a model of the plant."""

    @abstractmethod
    def law(self, model: PlantModel) -> ForceLaw:
        """The block."""

    def sampled_response(self, model: PlantModel) -> StateSpace:
        """From the measured force to displacement and rate of the command."""
        return self.law(model).sampled_response()

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """Add the law."""
        return builder.AddNamedSystem("force_law", self.law(model))


class AroundLawConfig:
    """Base of the configurations of parts around a force law, which is their key `law`."""

    law: Any

    def laws_within(self) -> Iterator[Any]:
        """The law, and those nested in it."""
        inner = self.law
        while inner is not None:
            yield inner
            inner = getattr(inner, "law", None)

    def refuse_another(self, what: str) -> None:
        """BadInputError where another part of this kind, with the same outputs, is nested in the law."""
        for each in self.laws_within():
            if isinstance(each, type(self)):
                raise invalid("law", f"!{type(each).__name__.removesuffix('Config')}", f"a law, not a second {what}")

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth [rad/s] of the law; None if it has none."""
        return model_bandwidth(self.law)

    def force_laws(self, model: PlantModel) -> list[tuple[Any, float]]:
        """The law inside, with its share 1 of the contact's stiffness; see `forcectl.force.slot`."""
        return [(self.law, 1.0)]
