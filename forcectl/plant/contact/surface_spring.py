"""A spring and damper that vary along the path, for a body under Drake's implicit position control::

    wanted    F = K(s) (h - q) - D(s) q'
    Drake     F = p (q_d - q+) + d (q_d' - q'+)      with constant p >= K and d >= D, + at the end of the step

With the predicted position q^ = q + dt q' of the body and the desired state

    q_d = q^ + (K/p)(h - q^),    q_d' = (1 - D/d) q'

Drake's force is that of the local spring and damper at the end of the step, plus that of an added mass
(p - K) dt^2 + (d - D) dt, 0.2 kg with p = 2e5 N/m at 1 ms. A force computed with the state before the step would be
unstable on a light body.
"""

from __future__ import annotations

from pydrake.systems.framework import BasicVector, Context

from forcectl.framework.batch import check
from forcectl.framework.block import PythonBlock


class SurfaceSpring(PythonBlock):
    """Desired state of the body that carries a surface of several materials.

    ```
    name: SurfaceSpring
    input_ports: [carrier_state, surface_stiffness, surface_damping (optional), surface_height (optional)]
    output_ports: [desired_state]
    ```

    carrier_state: shape (2,), position along n and velocity [m, m/s].
    surface_stiffness, surface_damping, surface_height: shape (1,), K_E, D_E and h under the tool [N/m, N s/m, m];
    without damping and on flat surfaces the ports do not exist.
    desired_state: shape (2,), position along n and velocity [m, m/s]. Feedthrough of all inputs.

    Sampling: none; evaluated when read.

    Args:
        position_gain: p [N/m], > 0.
        velocity_gain: d [N s/m], >= 0; the damping port exists when it is above 0.
        further_compliance: compliance in series with the surface, included in the spring [m/N]; may be negative.
        uneven: whether the port surface_height exists.
        period: dt of the plant [s].
    """

    port_units = {
        "carrier_state": "m,m/s",
        "desired_state": "m,m/s",
    }

    def __init__(
        self,
        position_gain: float,
        velocity_gain: float = 0.0,
        *,
        further_compliance: float = 0.0,
        uneven: bool = False,
        period: float = 0.001,
    ):
        super().__init__()
        self._p = check("position_gain", position_gain, "positive")
        self._d = check("velocity_gain", velocity_gain, "not negative")
        self._further, self._period = check("further_compliance", further_compliance), check("period", period)
        self._state = self.DeclareVectorInputPort("carrier_state", 2)
        self._stiffness = self.DeclareVectorInputPort("surface_stiffness", 1)
        self._damping = self.DeclareVectorInputPort("surface_damping", 1) if self._d else None
        self._height = self.DeclareVectorInputPort("surface_height", 1) if uneven else None
        ports = (self._state, self._stiffness, self._damping, self._height)
        reads = {port.ticket() for port in ports if port is not None}
        self.DeclareVectorOutputPort("desired_state", 2, self._desired, prerequisites_of_calc=reads)

    def _desired(self, context: Context, output: BasicVector) -> None:
        q, v = self._state.Eval(context).tolist()
        stiffness = self._stiffness.Eval(context).item()
        height = 0.0 if self._height is None else self._height.Eval(context).item()
        spring = stiffness / (1 + self._further * stiffness)
        q += self._period * v
        output.SetAtIndex(0, q + spring / self._p * (height - q))
        share = 0.0 if self._damping is None else 1 - self._damping.Eval(context).item() / self._d
        output.SetAtIndex(1, share * v)
