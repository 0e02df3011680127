"""Height of a surface that a tool slides over, estimated along with the compliance of the contact::

    s = dx - dx_uc + C_T_hat F    while the tool slides; held while the tool is at rest
    s'_mean += (Ts/T_m) (s' - s'_mean),    dx_bar = u + s + T s'_mean

u is the command of a law that plans from C_T_hat, such as [57]. T is the lag of the force sensor on a ramp, with which
s is measured. With T s'_mean the steady-state error on a surface of constant slope is zero; T_m is so long that a short
groove changes s'_mean little.

At a constant force, a compliance and an offset of the surface (x_0 = -s) cannot be distinguished. So changes at rest
are attributed to the compliance, which EWRLS estimates, and changes while the tool slides to the surface. A robot that
sags along its path has the same effect as a rising surface.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.framework.batch import BatchParameter, BatchValue, check
from forcectl.framework.sampled_block import Memory, SampledBatch, SampledBlock


class SurfaceOffset(SampledBatch):
    """Height of the surfaces of n contacts.

    ```
    name: SurfaceOffset
    input_ports: [measured_force, displacement, path_displacement, compliance, sliding]
    output_ports: [surface_offset, explained_displacement]
    parameters: [drive_compliance, offset_limit, lag, averaging]
    ```

    measured_force: shape (n,) [N].
    displacement, path_displacement: shape (n,), actual motor-side dx, and dx_uc, displacement of the path along n [m];
    both passed through the same filter as the force.
    compliance: shape (n,), C_T_hat from the command to the contact [m/N].
    sliding: shape (n,), above 0.5 while the tool slides [1].
    surface_offset: shape (n,), s, while the tool slides s + T s'_mean [m]. Feedthrough of all inputs at the tick.
    explained_displacement: shape (n,), dx - dx_uc - s [m], input of the compliance estimate: while the tool slides it
    is -C_T_hat F, which leaves the estimate unchanged. Feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): drive_compliance [m/N] >= 0 between command and motors, part of C_T_hat;
    offset_limit [m] >= 0, the largest s; lag T [s] >= 0; averaging T_m [s] > 0.

    Inputs that are not finite leave s as it is.

    Sampling: every `period` [s].
    """

    port_units = {"explained_displacement": "m"}

    def __init__(
        self,
        size: int,
        *,
        drive_compliance: ArrayLike = 0.0,
        offset_limit: ArrayLike = 0.01,
        lag: ArrayLike = 0.0,
        averaging: ArrayLike = 3.0,
        period: float = 0.002,
    ):
        parameters = {
            "drive_compliance": BatchParameter(drive_compliance, "not negative", "m/N"),
            "offset_limit": BatchParameter(offset_limit, "not negative", "m"),
            "lag": BatchParameter(lag, "not negative", "s"),
            "averaging": BatchParameter(averaging, "positive", "s"),
        }
        super().__init__(size, parameters)
        names = ("measured_force", "displacement", "path_displacement", "compliance", "sliding")
        inputs = [self.DeclareVectorInputPort(name, size) for name in names]
        memory = dict.fromkeys(("surface_offset", "explained_displacement", "height", "rate"), 0.0)
        self.declare_memory(memory, inputs, period)
        self.show("surface_offset", "explained_displacement")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One sample."""
        maximum, minimum, where = self.math.maximum, self.math.minimum, self.math.where
        drive, most, lag, averaging = self.values(context)
        moved = inputs["displacement"] - inputs["path_displacement"]
        measured_height = moved + (inputs["compliance"] - drive) * inputs["measured_force"]
        learn = (inputs["sliding"] > 0.5) & (abs(measured_height) < math.inf)
        height = where(learn, minimum(maximum(measured_height, -most), most), memory["height"])
        share = minimum(self._period / averaging, 1.0)
        rate = memory["rate"] + share * ((height - memory["height"]) / self._period - memory["rate"])
        rate = where(learn, rate, 0.0)
        return {
            "surface_offset": minimum(maximum(height + lag * rate, -most), most),
            "explained_displacement": moved - height,
            "height": height,
            "rate": rate,
        }


class Sliding(SampledBlock):
    """Whether a path in the unconstrained directions is moving.

    ```
    name: Sliding
    input_ports: [unconstrained_reference]
    output_ports: [sliding]
    ```

    unconstrained_reference: shape (n_q,), joint motion along the path [rad].
    sliding: shape (k,), 1 from the tick in which the reference changes until `settling` after its last change, else 0
    [1].
    Feedthrough at the tick.

    Sampling: every `period` [s].

    Args:
        num_joints: n_q.
        size: k, number of force loops.
        settling: settling time of drives and force sensor after the path [s], >= 0.
    """

    def __init__(self, num_joints: int, size: int = 1, *, settling: float = 0.5, period: float = 0.002):
        super().__init__()
        self._settling = check("settling", settling, "not negative")
        reference = self.DeclareVectorInputPort("unconstrained_reference", num_joints)
        memory = {"sliding": np.zeros(size), "remaining": 0.0, "last": np.zeros(num_joints)}
        self.declare_memory(memory, [reference], period)
        self.show("sliding")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, object]:
        """One tick."""
        now = inputs["unconstrained_reference"]
        # A reference that is not a number counts as no motion.
        moves = memory["time"] >= 0 and bool((np.abs(now - memory["last"]) > 0).any())
        remaining = self._settling if moves else max(memory["remaining"] - self._period, 0.0)
        sliding = np.full_like(memory["sliding"], float(moves or remaining > 0))
        return {"sliding": sliding, "remaining": remaining, "last": now}
