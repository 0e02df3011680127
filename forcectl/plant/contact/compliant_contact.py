"""Compliant one-sided contact: robot compliance in series with a spring and damper of the environment.

    -dx = C_R F + z,    F = K_E z + D_E z',    F >= 0                       (2.7), (2.8); F = -dx/C_T when D_E = 0

dx is the motor-side displacement along n (negative when pressing), z the deformation of the environment, C_R the
compliance n'(C_J + C_L)n of the robot. The damper makes z a state; a backward Euler step of length h is

    z+ = (C_R D_E z/h - dx)/(1 + C_R (K_E + D_E/h)),    F = K_E z+ + D_E (z+ - z)/h

which is exact for D_E = 0 and needs no special case for C_R = 0. When F would be negative, the contact is lost: F = 0
and the environment relaxes freely.

In place of the damper the environment may have the dissipation of Hunt and Crossley, "Coefficient of restitution
interpreted as damping in vibroimpact", J. Applied Mechanics 42 (1975), with the exponent 1::

    F = K_E z (1 + d_E z')

The force is continuous at first contact and never negative when the contact ends. The step then solves a quadratic
equation.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues

from forcectl.errors import invalid
from forcectl.framework.batch import BatchBlock, BatchParameter, BatchValue, batch_values, check
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.linear_contact import LinearContact, contact_response

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_TINY = 1e-300  # replaces a zero denominator of a fraction that is not used


def elastic_force(dx: BatchValue, stiffness: BatchValue, m: Any = np) -> BatchValue:
    """F = max(0, -K_T dx) [N] for a displacement dx [m] and the stiffness 1/C_T [N/m] of the whole series. (2.8)"""
    return m.maximum(-stiffness * dx, 0.0) + 0.0  # no negative zero


def damped_contact(
    dx: BatchValue,
    z: BatchValue,
    stiffness: BatchValue,
    rate_stiffness: BatchValue,
    robot_compliance: BatchValue,
    m: Any = np,
) -> tuple[BatchValue, BatchValue]:
    """One step of the damped contact.

    Args:
        dx: motor-side displacement at the end of the step [m].
        z: deformation of the environment before it [m].
        stiffness: K_E [N/m].
        rate_stiffness: D_E/h [N/m].
        robot_compliance: C_R [m/N].

    Returns:
        force F [N] and deformation z [m] at the end of the step.
    """
    touching = (robot_compliance * rate_stiffness * z - dx) / (1 + robot_compliance * (stiffness + rate_stiffness))
    force = stiffness * touching + rate_stiffness * (touching - z)
    free = rate_stiffness * z / (stiffness + rate_stiffness)
    lost = force <= 0
    return m.where(lost, 0.0, force), m.where(lost, free, touching)


def dissipative_contact(
    dx: BatchValue,
    z: BatchValue,
    stiffness: BatchValue,
    rate: BatchValue,
    robot_compliance: BatchValue,
    m: Any = np,
) -> tuple[BatchValue, BatchValue]:
    """One step of the contact with dissipation.

    Args:
        dx: motor-side displacement at the end of the step [m].
        z: deformation of the environment before it [m].
        stiffness: K_E [N/m].
        rate: d_E/h [1/m].
        robot_compliance: C_R [m/N].

    Returns:
        force F [N] and deformation z [m] at the end of the step.
    """
    # C_R K_E r z+^2 + (1 + C_R K_E (1 - r z)) z+ + dx = 0 with r = d_E/h; for each sign of the middle coefficient the
    # form of the solution without cancellation.
    soft = robot_compliance * stiffness
    half = 0.5 * (1 + soft * (1 - rate * z))
    pressed = m.maximum(-dx, 0.0)
    root = m.sqrt(half * half + soft * rate * pressed)
    touching = m.where(half > 0, pressed / m.maximum(half + root, _TINY), (root - half) / m.maximum(soft * rate, _TINY))
    force = stiffness * touching * (1 + rate * (touching - z))
    lost = force <= 0
    return m.where(lost, 0.0, force), m.where(lost, m.maximum(z - 1 / rate, 0.0), touching)


class CompliantContact(BatchBlock):
    """Contact force of a compliant surface on a robot of given compliance.

    ```
    name: CompliantContact
    input_ports: [displacement, surface_stiffness (optional), surface_damping (optional)]
    output_ports: [contact_force]
    parameters: [stiffness (optional), damping (optional), dissipation (optional), robot_compliance (optional)]
    ```

    displacement: shape (n,), dx along n from the undeformed surface, motor side [m]; pressing is negative.
    surface_stiffness, surface_damping: shape (n,), K_E > 0 and D_E >= 0 where the tool is [N/m, N s/m]; the ports exist
    when `stiffness` or `damping` is None.
    contact_force: shape (n,), >= 0 [N]. Feedthrough of all inputs.

    Parameters (Context, shape (n,)): stiffness K_E [N/m] > 0, damping D_E [N s/m] >= 0, dissipation d_E [s/m] > 0,
    robot_compliance C_R [m/N] >= 0.

    Sampling: with any damping or dissipation the deformation of the environment is a discrete state, updated every
    `period` [s]; without, the block has no state and no events (then neither can be changed later).

    Args:
        dissipation: d_E in place of any damping; 0: none [s/m].
    """

    _compliance_is_parameter = True  # otherwise `_situation` returns it

    def __init__(
        self,
        size: int,
        *,
        stiffness: ArrayLike | None,
        damping: ArrayLike | None = 0.0,
        dissipation: float = 0.0,
        robot_compliance: ArrayLike = 0.0,
        period: float = 0.002,
    ):
        self._period = check("period", period, "positive")
        self._damped = damping is None or bool(np.any(batch_values("damping", damping, size, "not negative") > 0))
        self._dissipates = check("dissipation", dissipation, "not negative") > 0
        if self._dissipates and self._damped:
            raise invalid("dissipation", dissipation, "0 with damping")
        parameters = {}
        if stiffness is not None:
            parameters["stiffness"] = BatchParameter(stiffness, "positive and finite", "N/m")
        if self._damped and damping is not None:
            parameters["damping"] = BatchParameter(damping, "not negative and finite", "N s/m")
        if self._dissipates:
            parameters["dissipation"] = BatchParameter(dissipation, "positive and finite", "s/m")
        if self._compliance_is_parameter:
            parameters["robot_compliance"] = BatchParameter(robot_compliance, "not negative and finite", "m/N")
        super().__init__(size, parameters)
        reads = {self.all_parameters_ticket()} | self._declare_inputs()
        given = {"surface_stiffness": stiffness, "surface_damping": damping}
        self._surface = [self.DeclareVectorInputPort(name, size) if v is None else None for name, v in given.items()]
        reads |= {port.ticket() for port in self._surface if port is not None}
        if self._damped or self._dissipates:
            z = self.DeclareDiscreteState(size)
            self._z = int(z)  # looking a state up by number takes half the time
            reads.add(self.discrete_state_ticket(z))
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)
        self.DeclareVectorOutputPort("contact_force", size, self._force, prerequisites_of_calc=reads)

    def _declare_inputs(self) -> set[Any]:
        """Declare the inputs that `_situation` reads; returns their tickets."""
        self._displacement = self.DeclareVectorInputPort("displacement", self._size)
        return {self._displacement.ticket()}

    def _situation(self, context: Context) -> tuple[BatchValue, BatchValue]:
        """dx [m], and C_R [m/N] unless it is a parameter."""
        return self.batch_value(self._displacement.Eval(context)), None

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """(K_E, D_E/h or d_E/h, C_R, 1/C_T); None for those that are not parameters."""
        named = dict(zip(self.parameter_names, values, strict=True))
        rate = named.get("damping", named.get("dissipation", 0.0)) / self._period
        stiffness, compliance, total = named.get("stiffness"), named.get("robot_compliance"), None
        if stiffness is not None and compliance is not None:
            total = stiffness / (1 + compliance * stiffness)
        return stiffness, rate, compliance, total

    def _solve(self, context: Context) -> tuple[BatchValue, BatchValue]:
        stiffness, rate, compliance, total = self.values(context)
        dx, compliance_now = self._situation(context)
        if compliance_now is not None:
            compliance = compliance_now
        if total is None:
            at_place, damping = self._surface
            if at_place is not None:
                stiffness = self.batch_value(at_place.Eval(context))
            if damping is not None:
                rate = self.batch_value(damping.Eval(context)) / self._period
            total = stiffness / (1 + compliance * stiffness)
        if not (self._damped or self._dissipates):
            return elastic_force(dx, total, self.math), None
        z = self.batch_value(context.get_discrete_state(self._z).value())
        if self._dissipates:
            return dissipative_contact(dx, z, stiffness, rate, compliance, self.math)
        return damped_contact(dx, z, stiffness, rate, compliance, self.math)

    def _force(self, context: Context, output: BasicVector) -> None:
        self.write(output, self._solve(context)[0])

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        next_state.set_value(self._z, self.stack(self._solve(context)[1]))


@dataclass(kw_only=True)
class EnvironmentConfig(Config, in_batches=True):
    """Scenario part `environment: !Surface`: a surface that an arm's tool presses on, touching at the start or not."""

    arm: str = key("", "name of the arm whose tool presses; empty: the first")
    normal: list[float] = key(
        [], "outward normal of the surface in the world; empty: the station's", bounds="not all zero", size=3
    )
    stiffness: float = key(
        5.9e3,
        "stiffness K_E of the surface, unless surface.materials gives it",
        unit="N/m",
        bounds="positive",
        each=True,
    )
    damping: float = key(
        0.0,
        "damping D_E of the surface, unless surface.materials gives it",
        unit="N s/m",
        bounds="not negative, at most 100000",
    )
    dissipation: float = key(
        0.0,
        "coefficient d_E of Hunt and Crossley's dissipation, F = K_E z (1 + d_E z'), in place of damping; 0: none",
        unit="s/m",
        bounds="not negative, at most 1000",
    )
    friction: float = key(
        0.0,
        "Coulomb friction coefficient between surface and tool (Multibody only)",
        unit="1",
        bounds="not negative and at most 2",
    )
    one_sided: bool = key(True, "true: the contact only pushes; false: a linear two-sided spring (OneDimensional only)")
    surface: SurfaceConfig = key(SurfaceConfig, "shape and materials of the surface; flat by default")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dissipation:
            for name, other in (("damping", self.damping), ("surface.materials", self.surface.materials)):
                if other:
                    raise invalid("dissipation", self.dissipation, f"0 with {name}")
            if not self.one_sided:
                raise invalid("dissipation", self.dissipation, "0 with one_sided = false")
        if not self.one_sided and self.damping and not self.surface.uniform:
            raise invalid("damping", self.damping, "0 with one_sided = false and heights")
        if not self.one_sided and self.surface.gap:
            raise invalid("one_sided", False, "true with surface.gap")
        if not self.one_sided and self.surface.materials is not None:
            raise invalid("one_sided", False, "true with surface.materials")

    @property
    def first_stiffness(self) -> float:
        """K_E at the start of the path [N/m]."""
        if self.surface.materials is None:
            return self.stiffness
        materials = self.surface.materials.path()
        return float(materials.along(materials.stiffness, 0.0))

    @property
    def own_block(self) -> bool:
        """Whether a subclass has its own `add_to`, whose block computes the force in every fidelity."""
        return type(self).add_to is not EnvironmentConfig.add_to

    def check_own_block(self) -> None:
        """Raise BadInputError for settings that the block of a subclass cannot model in a multibody plant."""
        why = "with an add_to of its own: the block of a subclass computes a force along the normal only"
        if self.friction:
            raise invalid("friction", self.friction, f"0 {why}")
        if self.surface.turning:
            raise invalid("surface.turning", True, f"false {why}")

    @property
    def contact_values(self) -> tuple[float | None, float | None]:
        """K_E and D_E as arguments of `CompliantContact`: None for those that come from ports."""
        materials = self.surface.materials
        if materials is None:
            return self.stiffness, self.damping
        return None, None if materials.damped else 0.0

    def stiffnesses(self) -> dict[str, float]:
        """Each K_E given in the scenario [N/m], by key."""
        materials = self.surface.materials
        if materials is None:
            return {"stiffness": self.stiffness}
        segments = enumerate(materials.segments)
        return {f"surface.materials.segments.{i}.stiffness": each.environment_stiffness for i, each in segments}

    def pressed(self, name: str, force: float) -> EnvironmentConfig:
        """The surface around a constant contact force, with one of its stiffnesses everywhere.

        About a force F the dissipation d_E is the damping F d_E.

        Args:
            name: key of the stiffness, see `stiffnesses`; its segment has a damping of its own.
            force: F [N].
        """
        one = copy(self)
        one.damping, one.dissipation = self.damping + force * self.dissipation, 0.0
        if self.surface.materials is not None:
            segment = self.surface.materials.segments[int(name.split(".")[-2])]
            one.stiffness, one.damping = segment.environment_stiffness, segment.damping
            one.surface = copy(self.surface)
            one.surface.materials = None
        return one

    def sampled_response(self, stiffness: float, robot_compliance: float, period: float) -> StateSpace:
        """From [dx, dx'] to the force, without contact loss, for another K_E [N/m]; see `contact_response`.

        Of a surface of several materials or with dissipation, it is that of `pressed`.
        """
        if self.one_sided:
            return contact_response(stiffness, self.damping, robot_compliance, period)
        gain = [[-stiffness / (1 + robot_compliance * stiffness), -self.damping]]
        return state_space(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), gain, period)

    def add_to(
        self,
        builder: DiagramBuilder,
        size: int,
        period: float,
        *,
        robot_compliance: ArrayLike = 0.0,
    ) -> CompliantContact | LinearContact:
        """Add the contact for a batch of n."""
        if not self.one_sided:
            linear = LinearContact(
                size, stiffness=self.stiffness, damping=self.damping, robot_compliance=robot_compliance
            )
            return builder.AddNamedSystem("contact", linear)
        stiffness, damping = self.contact_values
        block = CompliantContact(
            size,
            stiffness=stiffness,
            damping=damping,
            dissipation=self.dissipation,
            robot_compliance=robot_compliance,
            period=period,
        )
        return builder.AddNamedSystem("contact", block)
