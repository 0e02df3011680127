"""Environment compliance by exponentially weighted recursive least squares (EWRLS)::

    z = phi C_E,    z = -dx - C_R_hat F,    phi = F                                                    (2.10)*
    k = P phi/(mu + phi P phi),    C_E += k (z - phi C_E),    P = (P - k phi P)/mu

The product form never divides by the force, which (2.10) as printed does. The displacement must be the actual
motor-side one, seen through the same filter as the force: otherwise the force lags it and every transient biases the
estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from forcectl.framework.batch import BatchBlock, BatchParameter, BatchValue, batch_values, check, check_order


def ewrls_step(
    estimate: BatchValue, covariance: BatchValue, target: BatchValue, regressor: BatchValue, forgetting: BatchValue
) -> tuple[BatchValue, BatchValue]:
    """One update of a scalar EWRLS estimate.

    Args:
        estimate: theta.
        covariance: P.
        target: z.
        regressor: phi.
        forgetting: mu, 0 < mu <= 1.

    Returns:
        theta and P after the sample.
    """
    gain = covariance * regressor / (forgetting + regressor * covariance * regressor)
    return estimate + gain * (target - regressor * estimate), (covariance - gain * regressor * covariance) / forgetting


class EnvironmentComplianceEstimator(BatchBlock):
    """EWRLS estimate of the environment compliance of n contacts.

    ```
    name: EnvironmentComplianceEstimator
    input_ports: [measured_force, displacement]
    output_ports: [environment_compliance, compliance]
    parameters: [forgetting, robot_compliance, drive_compliance, minimum_force, lower_bound, upper_bound]
    ```

    measured_force: shape (n,) [N].
    displacement: shape (n,), actual motor-side dx [m], passed through the same filter as the force.
    environment_compliance: shape (n,), C_E_hat within its bounds [m/N]. State, no direct feedthrough.
    compliance: shape (n,), from the command: C_R_hat + C_E_hat and the drives' [m/N]. State, no direct feedthrough.

    Parameters (Context, shape (n,)): forgetting mu in (0, 1], robot_compliance C_R_hat [m/N] >= 0 between motors and
    tool, drive_compliance [m/N] >= 0 between command and motors (of joint impedance control), minimum_force [N] >= 0
    below which nothing is learnt, lower_bound and upper_bound [m/N] of what is put out.

    A force or displacement that is not finite is skipped.

    Sampling: every `period` [s]; the outputs change one tick after the samples they use.

    Args:
        initial_compliance: C_E_hat at the start [m/N], > 0.
        initial_covariance: P_0 [1/N^2], > 0: not given by the thesis and decisive; 1e-6 reproduces its settling
            (targets, section 4).
    """

    def __init__(
        self,
        size: int,
        *,
        initial_compliance: ArrayLike,
        initial_covariance: ArrayLike = 1e-6,
        forgetting: ArrayLike = 0.995,
        robot_compliance: ArrayLike = 0.0,
        drive_compliance: ArrayLike = 0.0,
        minimum_force: ArrayLike = 0.2,
        lower_bound: ArrayLike = 1e-8,
        upper_bound: ArrayLike = 1e-1,
        period: float = 0.002,
    ):
        super().__init__(
            size,
            {
                "forgetting": BatchParameter(forgetting, "above 0 and at most 1", "1"),
                "robot_compliance": BatchParameter(robot_compliance, "not negative", "m/N"),
                "drive_compliance": BatchParameter(drive_compliance, "not negative", "m/N"),
                "minimum_force": BatchParameter(minimum_force, "not negative", "N"),
                "lower_bound": BatchParameter(lower_bound, "positive", "m/N"),
                "upper_bound": BatchParameter(upper_bound, "positive", "m/N"),
            },
        )
        check("period", period, "positive")
        self._force = self.DeclareVectorInputPort("measured_force", size)
        self._displacement = self.DeclareVectorInputPort("displacement", size)
        self._estimate = self.DeclareDiscreteState(
            batch_values("initial_compliance", initial_compliance, size, "positive and finite")
        )
        self._covariance = self.DeclareDiscreteState(
            batch_values("initial_covariance", initial_covariance, size, "positive and finite")
        )
        reads: Any = {self.discrete_state_ticket(self._estimate), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("environment_compliance", size, self._environment, prerequisites_of_calc=reads)
        self.DeclareVectorOutputPort("compliance", size, self._total, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def check_together(self, values: Mapping[str, NDArray[np.float64]]) -> None:
        """The bounds are in order."""
        check_order("lower_bound", "upper_bound", values)

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        mu, robot, _, minimum, _, _ = self._values.Eval(context)
        force = self.batch_value(self._force.Eval(context))
        target = -self.batch_value(self._displacement.Eval(context)) - robot * force
        old = self.batch_value(context.get_discrete_state(self._estimate).value())
        old_covariance = self.batch_value(context.get_discrete_state(self._covariance).value())
        new, covariance = ewrls_step(old, old_covariance, target, force, mu)
        # Infinity minus infinity is not a number, so one comparison catches both NaN and overflow.
        learn = (abs(force) >= minimum) & (new - new == 0) & (covariance - covariance == 0)
        next_state.set_value(self._estimate, self.stack(self.math.where(learn, new, old)))
        next_state.set_value(self._covariance, self.stack(self.math.where(learn, covariance, old_covariance)))

    def _bounded(self, context: Context) -> BatchValue:
        *_, lower, upper = self._values.Eval(context)
        return self.math.minimum(
            self.math.maximum(self.batch_value(context.get_discrete_state(self._estimate).value()), lower), upper
        )

    def _environment(self, context: Context, output: BasicVector) -> None:
        self.write(output, self._bounded(context))

    def _total(self, context: Context, output: BasicVector) -> None:
        _, robot, drive, *_ = self._values.Eval(context)
        self.write(output, self._bounded(context) + robot + drive)
