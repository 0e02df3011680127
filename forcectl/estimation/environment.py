"""Environment compliance by exponentially weighted recursive least squares (EWRLS)::

    z = phi C_E,    z = -dx - C_R_hat F,    phi = F                                                    (2.10)*
    k = P phi/(mu + phi P phi),    C_E += k (z - phi C_E),    P = (P - k phi P)/mu

The product form never divides by the force; (2.10) as printed does. The displacement must be the actual motor-side one,
passed through the same filter as the force: otherwise the force lags it and every transient biases the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check_order
from forcectl.framework.sampled_block import Memory, SampledBatch

# Bounds of C_E_hat [m/N]: contacts of 10 N/m to 1e8 N/m.
COMPLIANCE_BOUNDS = (1e-8, 1e-1)


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


class EnvironmentComplianceEstimator(SampledBatch):
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
    compliance: shape (n,), from the command to the contact: C_R_hat + C_E_hat + that of the drives [m/N]. State, no
    direct feedthrough.

    Parameters (Context, shape (n,)): forgetting mu in (0, 1], robot_compliance C_R_hat [m/N] >= 0 between motors and
    tool, drive_compliance [m/N] >= 0 between command and motors (of joint impedance control), minimum_force [N] >= 0
    below which the estimate is held, lower_bound and upper_bound [m/N] of C_E_hat at the outputs.

    A force or displacement that is not finite is skipped.

    Sampling: every `period` [s]; the outputs change one tick after the samples they use.

    Args:
        initial_compliance: C_E_hat at the start [m/N], > 0.
        initial_covariance: P_0 [1/N^2], > 0: the thesis does not give it, and the settling depends on it; 1e-6
            reproduces that of the thesis (targets, section 4).
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
        lower_bound: ArrayLike = COMPLIANCE_BOUNDS[0],
        upper_bound: ArrayLike = COMPLIANCE_BOUNDS[1],
        period: float = 0.002,
    ):
        super().__init__(
            size,
            {
                "forgetting": BatchParameter(forgetting, "above 0 and at most 1", "1"),
                "robot_compliance": BatchParameter(robot_compliance, "not negative and finite", "m/N"),
                "drive_compliance": BatchParameter(drive_compliance, "not negative and finite", "m/N"),
                "minimum_force": BatchParameter(minimum_force, "not negative", "N"),
                "lower_bound": BatchParameter(lower_bound, "positive", "m/N"),
                "upper_bound": BatchParameter(upper_bound, "positive", "m/N"),
            },
        )
        inputs = [self.DeclareVectorInputPort(name, size) for name in ("measured_force", "displacement")]
        memory = {
            "estimate": batch_values("initial_compliance", initial_compliance, size, "positive and finite"),
            "covariance": batch_values("initial_covariance", initial_covariance, size, "positive and finite"),
        }
        self.declare_memory(memory, inputs, period)
        reads: Any = {self.discrete_state_ticket(self._state), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("environment_compliance", size, self._environment, prerequisites_of_calc=reads)
        self.DeclareVectorOutputPort("compliance", size, self._total, prerequisites_of_calc=reads)

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The bounds are in order."""
        check_order("lower_bound", "upper_bound", values)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One sample."""
        mu, robot, _, minimum, _, _ = self.values(context)
        force = inputs["measured_force"]
        target = -inputs["displacement"] - robot * force
        new, covariance = ewrls_step(memory["estimate"], memory["covariance"], target, force, mu)
        # Infinity minus infinity is not a number, so one comparison catches both NaN and overflow.
        learn = (abs(force) >= minimum) & (new - new == 0) & (covariance - covariance == 0)
        return self.choose(learn, {"estimate": new, "covariance": covariance}, memory)

    def _bounded(self, context: Context) -> BatchValue:
        *_, lower, upper = self.values(context)
        return self.math.minimum(self.math.maximum(self.held(context)["estimate"], lower), upper)

    def _environment(self, context: Context, output: BasicVector) -> None:
        self.write(output, self._bounded(context))

    def _total(self, context: Context, output: BasicVector) -> None:
        _, robot, drive, *_ = self.values(context)
        self.write(output, self._bounded(context) + robot + drive)
