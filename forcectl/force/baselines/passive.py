"""Passivity observer and passivity controller around any force law::

    E[k]    = E[k-1] + F[k] (x_m[k] - x_m[k-1])                                                               observer
    x_m[k]  = x_m[k-1] + (x[k] - x_m[k-1]) Ts/(T_m + Ts)                        the motion that the measured force shows
    x[k]    = x[k-1] + u[k] - u[k-1] + delta[k]                                                    u: command of the law
    delta   = -(E_0 + E_u)/F[k] where E_u = E[k-1] + F[k] (x[k-1] + u[k] - u[k-1] - x_m[k-1]) < -E_0, else 0  controller

E is the energy that the contact has put into the robot, counted from zero. Pressing puts energy into the contact, so
that E is negative as long as the surface is pressed. A spring of the compliance C_T under the force F stores C_T F^2/2.
The law may put in at most E_0: within the tick, delta removes the part of its motion that would put in more, at most
all of it.

Source: B. Hannaford and J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics
and Automation 18(1), 2002, the parallel arrangement (force in, motion out), with the initial energy E_0; that is T_m =
0. The lag T_m is an addition: behind the filter of a force sensor, which is slower than the drives, the energy of the
commanded motion is a fraction of the true one, and an oscillation appears passive. As in the source, delta is not
undone: the command of the law and that of the robot drift apart by `passivity_offset`. A law with an integral
compensates that. Energy dissipated by friction and damping of the surface remains counted: after long pressing and
releasing on such a surface, E_0 is used up.

On the ideal plant F[k] = -x[k-1]/C_T, starting without contact and with T_m = 0, E >= -E_0 bounds the force by F_max^2
= 2 E_0/C_T + the squares of the force changes of each tick, which the observer has one tick late.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, System

from forcectl.errors import about
from forcectl.force.integral import IntegralConfig
from forcectl.force.law import AroundLawConfig, low_pass, require_force_law
from forcectl.framework.batch import BatchParameter, BatchValue
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.framework.wiring import Around, export_all_inputs, export_all_outputs
from forcectl.plant.plant_model import PlantModel


class PassivityController(SampledBatch):
    """Passivity observer and controller of n independent commands.

    ```
    name: PassivityController
    input_ports: [law_command, measured_force]
    output_ports: [displacement_command, observed_energy, passivity_offset]
    parameters: [energy, model_lag]
    ```

    law_command: shape (n,), u [m]. measured_force: shape (n,), F [N].
    displacement_command: shape (n,), x [m], held over [t_k, t_k+1).
    observed_energy: shape (n,), E after the tick [J]; negative: energy in the surface.
    passivity_offset: shape (n,), x - u [m].
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): energy E_0 [J] >= 0; infinite: the observer alone. model_lag T_m [s] >= 0.

    An input that is not a number holds outputs and states; the next valid tick makes up for the missed motion.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.
    """

    port_units = {"law_command": "m", "observed_energy": "J", "passivity_offset": "m"}

    def __init__(self, size: int, *, energy: ArrayLike, model_lag: ArrayLike = 0.0, period: float = 0.002):
        parameters = {
            "energy": BatchParameter(energy, "not negative", "J"),
            "model_lag": BatchParameter(model_lag, "not negative", "s"),
        }
        super().__init__(size, parameters)
        self.sample_delay = {("law_command", "displacement_command"): 0.0}
        inputs = [self.DeclareVectorInputPort(name, size) for name in ("law_command", "measured_force")]
        shown = ("displacement_command", "observed_energy", "passivity_offset")
        self.declare_memory(dict.fromkeys((*shown, "law_command", "shown_displacement"), 0.0), inputs, period)
        self.show(*shown)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of observer and controller."""
        m = self.math
        budget, lag = self.values(context)
        wanted, force = inputs["law_command"], inputs["measured_force"]
        good = (abs(wanted) < np.inf) & (abs(force) < np.inf)
        wanted, force = m.where(good, wanted, 0.0), m.where(good, force, 0.0)
        last, energy, shown = (
            memory[name] for name in ("displacement_command", "observed_energy", "shown_displacement")
        )
        moved = wanted - memory["law_command"]
        missing = m.maximum(-(budget + energy + force * (last + moved - shown)), 0.0)
        taken = m.minimum(missing / m.where(force == 0.0, 1.0, abs(force)), abs(moved))
        moved = moved + m.where(force == 0.0, 0.0, m.copysign(taken, force))
        after = low_pass(shown, last + moved, lag, self._period)
        new = {
            "displacement_command": last + moved,
            "observed_energy": energy + force * (after - shown),
            "shown_displacement": after,
            "passivity_offset": last + moved - wanted,
            "law_command": wanted,
        }
        return self.choose(good, new, memory)


class PassiveForceLaw(Around):
    """A force law whose command passes through a passivity observer and controller.

    ```
    name: PassiveForceLaw
    input_ports: [desired_force, measured_force, (further inputs of the law)]
    output_ports: [displacement_command, observed_energy, passivity_offset, (further outputs of the law)]
    ```

    desired_force, measured_force: shape (n,) [N]. displacement_command, observed_energy, passivity_offset: see
    `PassivityController`.
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the two; no delay beyond that of the law.

    Args:
        builder: holds the law; it is built into this diagram.
        law: with the ports of a ForceLaw.

    Raises:
        BadInputError: the law has no such ports.
    """

    def __init__(self, builder: DiagramBuilder, law: System, controller: PassivityController):
        super().__init__(law)
        require_force_law(law, ["measured_force"])
        builder.AddNamedSystem("passivity", controller)
        builder.Connect(law.GetOutputPort("displacement_command"), controller.GetInputPort("law_command"))
        inputs = export_all_inputs(builder, law)
        builder.ConnectInput(inputs["measured_force"], controller.GetInputPort("measured_force"))
        export_all_outputs(builder, controller)
        export_all_outputs(builder, law, but=("displacement_command", "displacement_velocity_command"))
        builder.BuildInto(self)


@dataclass(kw_only=True)
class PassiveConfig(AroundLawConfig, Config, in_batches=True):
    """Scenario part `!Passive`: passivity observer and controller around any force law, which bound its energy."""

    law: Any = slot("controller", IntegralConfig, meaning="force law whose energy is bounded")
    energy: float = key(
        0.05,
        "largest energy E_0 that the force law may put into the contact; springs of 5.9e3 N/m store 0.05 J at 22 N",
        unit="J",
        bounds="from 0 to 1000000",
        each=True,
    )

    model_lag: float | None = key(
        None,
        "time constant T_m of the modelled lag from the motion to the measured force; null: the sensor's lag",
        unit="s",
        bounds="from 0 to 1",
        each=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.refuse_another("passivity controller")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> PassiveForceLaw:
        """Add the law, and observer and controller behind it."""
        inner = DiagramBuilder()
        with about(self.law):
            law = self.law.add_to(inner, model)
            lag = model.sensor_lag if self.model_lag is None else self.model_lag
            controller = PassivityController(model.size, energy=self.energy, model_lag=lag, period=model.period)
            return builder.AddNamedSystem("force_law", PassiveForceLaw(inner, law, controller))
