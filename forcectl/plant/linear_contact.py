"""The contact without loss, which is linear: as a block, and as a sampled linear system for the poles of a loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain

from forcectl.errors import invalid
from forcectl.framework.batch import batch_values
from forcectl.framework.block import PythonDiagram
from forcectl.framework.linear_batch import state_space

if TYPE_CHECKING:
    from scipy.signal import StateSpace


def contact_response(stiffness: float, damping: float, robot_compliance: float, period: float) -> StateSpace:
    """The damped contact without loss, from [dx, dx'] to F at the same tick; dx' is not used but derived from dx.

    Args:
        stiffness: K_E [N/m].
        damping: D_E [N s/m].
        robot_compliance: C_R [m/N].
        period: [s].
    """
    rate = damping / period
    both = 1 + robot_compliance * (stiffness + rate)
    # z+ = kept z + pressed dx, see `forcectl.plant.contact.compliant_contact`
    kept, pressed = robot_compliance * rate / both, -1 / both
    a, b = np.array([[kept]]), np.array([[pressed, 0.0]])
    return state_space(a, b, (stiffness + rate) * a - rate, (stiffness + rate) * b, period)


class LinearContact(PythonDiagram):
    """The two-sided contact of the thesis' analysis, never lost: F = -dx/C_T (2.8), or F = -(K_E dx + D_E dx') (6.1).

    ```
    name: LinearContact
    input_ports: [displacement, displacement_velocity (optional)]
    output_ports: [contact_force]
    ```

    displacement: shape (n,), dx along n, motor side [m]. displacement_velocity: shape (n,), dx' [m/s]; exists with
    damping. contact_force: shape (n,) [N]. Feedthrough of all inputs.

    Sampling: none; evaluated when read.

    Args:
        damping: D_E [N s/m]; then the robot must be rigid.
    """

    def __init__(self, size: int, *, stiffness: ArrayLike, damping: ArrayLike = 0.0, robot_compliance: ArrayLike = 0.0):
        super().__init__()
        k = batch_values("stiffness", stiffness, size, "positive and finite")
        d = batch_values("damping", damping, size, "not negative and finite")
        c = batch_values("robot_compliance", robot_compliance, size, "not negative and finite")
        if np.any(d * c > 0):
            raise invalid("damping", d.tolist(), "0 with one_sided = false, unless elastic_joints = false")
        builder = DiagramBuilder()
        spring = builder.AddNamedSystem("spring", Gain(-k / (1 + c * k)))
        builder.ExportInput(spring.get_input_port(), "displacement")
        force = spring.get_output_port()
        if np.any(d > 0):
            damper = builder.AddNamedSystem("damper", Gain(-d))
            total = builder.AddNamedSystem("sum", Adder(2, size))
            builder.Connect(force, total.get_input_port(0))
            builder.Connect(damper.get_output_port(), total.get_input_port(1))
            builder.ExportInput(damper.get_input_port(), "displacement_velocity")
            force = total.get_output_port()
        builder.ExportOutput(force, "contact_force")
        builder.BuildInto(self)
