"""A contact force kept between two limits by the acceleration of the tool: (6.16)-(6.21)*.

The contact is a spring of a stiffness K between K_min and K_max, compressed by the coordinate x_c::

    F = -K (x_c - x_0),    F' = -K x_c',    F'' = -K x_c''                                         (6.16), (6.17)*
    F_min <= F <= F_max,   kept with accelerations of x_c within +-gamma_x

The possible next states are a polytope. Its corners are the extremes of the stiffness, the same in both rows of
(6.17)*, and of the errors of F, x_c' and the model. They must stay in the sets that are invariant with braking at
gamma_F = K_min gamma_x, which is possible with every stiffness. Divided by K, a corner is an output of relative degree
2::

    y = (F - F_max)/K,   y' = -x_c',   y'' = -x_c'',   braking at gamma_x K_min/K,       and F_min - F likewise

so that `RobustBound` gives the largest y'' of each. Of the two stiffnesses the smaller bound counts. (6.21)* uses
+-gamma_x once a corner is outside. This law uses the acceleration that just keeps all corners inside, which avoids a
limit cycle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import batch_values, check
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import Evaluation
from forcectl.tasks.constraints.robust import Errors, RobustBound
from forcectl.tasks.coordinates import ArmTask


class ForceBand:
    """The measured force along a task coordinate stays in a band; for controllers with the input `measured_force`.

    The force on the tool counts positive towards larger values of the coordinate, so it is positive when the tool
    presses towards smaller ones. Without contact the arm approaches at (2 gamma_x F_min/K_max)^(1/2) at most. A force
    outside of the band returns with accelerations within gamma_x. If both limits cannot be kept, F_max is kept.

    The speed of a moving surface must be included in the measurement error of the speed.

    Args:
        task: of one coordinate x_c, in metres.
        force: F_min and F_max, >= 0 [N].
        stiffness: K_min and K_max of the contact, tool and arm together, > 0 [N/m].
        braking: gamma_x, > 0 [m/s^2].
        measurement_error: largest errors of F [N] and of x_c' [m/s].
        model_error: largest prediction errors of F [N] and x_c' [m/s] after a tick.
        slack_weight: see `Constraint`; None: hard.
        period: tick Ts [s].

    Attributes:
        task: the same.

    Raises:
        BadInputError: a task of several coordinates or of an angle, limits in the wrong order, or a band too narrow for
            its errors.
    """

    relative_degree = 0
    label = "force band"
    row_names = ("largest force", "smallest force")
    reads_force = True

    def __init__(
        self,
        task: ArmTask,
        force: Sequence[float],
        stiffness: Sequence[float],
        braking: float,
        *,
        measurement_error: Errors = Errors(),  # noqa: B008 -- immutable
        model_error: Errors = Errors(),  # noqa: B008 -- immutable
        slack_weight: float | None = None,
        period: float = 0.004,
    ):
        if task.size != 1 or task.angular.any():
            raise invalid("task: coordinates", list(task.coordinates), "one of x, y, z")
        F_min, F_max = batch_values("force", force, 2, "not negative").tolist()
        K_min, K_max = batch_values("stiffness", stiffness, 2, "positive").tolist()
        if not F_min < F_max:
            raise invalid("force", [F_min, F_max], "the smaller one first")
        if not K_min <= K_max:
            raise invalid("stiffness", [K_min, K_max], "the smaller one first")
        gamma = check("braking", braking, "positive")
        self.task, self._limits = task, np.array([F_max, F_min])
        self._laws = []
        for K in (K_min, K_max):
            measurement = measurement_error._replace(value=np.divide(measurement_error.value, K))
            model = model_error._replace(value=np.divide(model_error.value, K))
            self._laws.append((K, RobustBound(gamma * K_min / K, measurement, model, period)))
        needed = max(2.0 * K * law.distance().item() for K, law in self._laws)
        if not F_max - F_min > needed:
            allowed = f"more than {needed:.3g} N apart, for the margins due to errors and sampling"
            raise invalid("force", [F_min, F_max], allowed)
        if slack_weight is not None:
            self.slack_weight = slack_weight

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """(0, 0, row, bias) of rows row u + bias <= 0: of F_max, then of F_min."""
        if not isinstance(motion, ArmsMotion) or self not in motion.forces:
            raise BadInputError("force band: must be in a reactive controller, which has the input measured_force")
        state = self.task.state(motion)
        J, bias = state.jacobian[0], state.bias.item()
        lower, upper = self.accelerations(motion.forces[self], state.rate.item())
        return 0.0, 0.0, np.array([-J, J]), np.array([lower - bias, bias - upper])

    def accelerations(self, force: float, speed: float) -> tuple[float, float]:
        """The smallest and the largest x_c'' with which the band can be kept [m/s^2].

        Args:
            force: as measured [N].
            speed: x_c' as measured [m/s].
        """
        beyond, rate = np.array([1.0, -1.0]) * (force - self._limits), np.array([-speed, speed])
        (_, first), (_, second) = ((K, law.at(beyond / K, rate)) for K, law in self._laws)
        lower, upper = np.array([-1.0, 1.0]) * np.minimum(first, second)
        return lower.item(), max(lower, upper).item()
