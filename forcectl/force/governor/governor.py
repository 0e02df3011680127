"""MPC command governor: gives a force loop of moderate bandwidth the reference that makes it fast (Sec. 4.6).

`program` states the problem; `stability` tests for which true delays the governed loop is stable. r[0] is meant to be
far above the desired force: that makes a slow loop fast.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram
from pydrake.systems.framework import Context, DiagramBuilder, System

from forcectl.arrays import Array
from forcectl.errors import BadInputError, about, invalid
from forcectl.force.governor.program import (
    LONGEST_HORIZON,
    MOST_TICKS,
    GovernorLimits,
    GovernorProgram,
    Horizon,
    Situation,
    check_horizon,
    check_pole,
    check_weights,
    closed_form,
    coefficients,
    free_force,
    model_step,
    over_horizon,
)
from forcectl.force.governor.stability import StabilityReport, feedback_weight, stability_report
from forcectl.force.law import FORCES, AroundLawConfig, model_bandwidth
from forcectl.force.linear_law import VrftConfig
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check, check_order, whole_multiple
from forcectl.framework.block import scratch
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.framework.wiring import Around, export_all_inputs, export_all_outputs
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import DEFAULT_SOLVER, Solver, make_solver, solver_choices

_OPTIMAL, _NOT_FINITE = float(Status.OPTIMAL), float(Status.NOT_FINITE)


class CommandGovernor(SampledBatch):
    """Reference governor of n independent force loops: computes their references anew at every tick. (4.31), (4.33)*

    ```
    name: CommandGovernor
    input_ports: [desired_force, measured_force]
    output_ports: [governed_reference, status]
    parameters: [inner_pole, reference_pole, output_weight, reference_weight, lower_limit, upper_limit, rate_limit,
    lower_force, upper_force]
    ```

    desired_force, measured_force: shape (n,) [N].
    governed_reference: shape (n,), r[t] [N], for the `desired_force` of the inner loop. Feedthrough of both inputs.
    status: shape (n,), see `Status` [1]: OPTIMAL; NOT_FINITE while a force is not a finite number: the last reference
    is held; with a horizon of more than one tick also SLACK (the predicted force cannot stay within its limits) and
    SOLVER_FAILED (the last reference is held as well). Feedthrough of both inputs.

    Parameters (Context, shape (n,)): inner_pole A and reference_pole At of the models per tick, in (0, 1);
    output_weight Q_y >= 0, reference_weight Q_r > 0; lower_limit and upper_limit of r [N], rate_limit of r [N/s] > 0,
    lower_force and upper_force [N] of the predicted force; infinite: no limit. These two bound the force that the model
    of the inner loop predicts. They do not bound the reference, which exceeds them in transients (lower_limit and
    upper_limit bound it), and not the deviation of the true loop from its model.

    Sampling: every `period` [s]; no delay from measured_force to governed_reference, see `SampledBlock`.

    Args:
        size: batch size n.
        delay: of the inner loop, T_d = N `period` [s].
        horizon: h, 1 to 500 [ticks]; 1, as in the thesis, has a closed form with all limits, more needs a quadratic
            program per batch element and tick.
        initial_force: force at which the loop is at rest before the first tick, shape (n,) or a number [N].
        solver: of the quadratic program: its name, or the solver.
    """

    def __init__(
        self,
        size: int,
        *,
        inner_pole: ArrayLike = 0.997,
        reference_pole: ArrayLike = 0.985,
        delay: float = 0.08,
        output_weight: ArrayLike = 1.0,
        reference_weight: ArrayLike = 1e-3,
        horizon: int = 1,
        lower_limit: ArrayLike = -inf,
        upper_limit: ArrayLike = inf,
        rate_limit: ArrayLike = inf,
        lower_force: ArrayLike = -inf,
        upper_force: ArrayLike = inf,
        initial_force: ArrayLike = 0.0,
        period: float = 0.002,
        solver: str | Solver = DEFAULT_SOLVER,
    ):
        ticks = whole_multiple("delay", check("delay", delay), check("period", period, "positive"), "period")
        if ticks > MOST_TICKS:
            raise invalid("delay", delay, f"at most {MOST_TICKS * period:g} s, {MOST_TICKS} control ticks")
        self._ticks = ticks
        self._horizon = check_horizon(horizon)
        solver = make_solver(solver)
        parameters = {
            "inner_pole": BatchParameter(inner_pole, "a number", "1"),
            "reference_pole": BatchParameter(reference_pole, "a number", "1"),
            "output_weight": BatchParameter(output_weight, "not negative", "1"),
            "reference_weight": BatchParameter(reference_weight, "positive and finite", "1"),
            "lower_limit": BatchParameter(lower_limit, "a number", "N"),
            "upper_limit": BatchParameter(upper_limit, "a number", "N"),
            "rate_limit": BatchParameter(rate_limit, "positive", "N/s"),
            "lower_force": BatchParameter(lower_force, "a number", "N"),
            "upper_force": BatchParameter(upper_force, "a number", "N"),
        }
        super().__init__(size, parameters)
        self._period = period
        self.sample_delay = {("measured_force", "governed_reference"): 0.0}
        inputs = [self.DeclareVectorInputPort(name, size) for name in FORCES]
        self._program = scratch(self, "quadratic program", partial(GovernorProgram, self._horizon, solver=solver))
        start = batch_values("initial_force", initial_force, size)
        memory = {
            "governed_reference": start,
            "status": 0.0,
            "wanted_force": start,
            # r of the last N ticks, the newest first.
            "references": np.tile(start, (max(1, self._ticks), 1)),
            # Inputs of the last tick's program, for `program`.
            "posed": np.zeros((len(Situation._fields), size)),
        }
        self.declare_memory(memory, inputs, period)
        self.show("governed_reference", "status")

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The poles are within (0, 1), the weights finite, the limits in order."""
        for name in ("inner_pole", "reference_pole"):
            check_pole(name, values[name])
        check_weights(values["output_weight"], values["reference_weight"])
        _check_limits(values)

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """Coefficients and limits of all batch elements together and, for a longer horizon, of each by itself."""
        model, (lower, upper, rate, *forces) = values[:4], values[4:]
        limits = GovernorLimits(lower, upper, rate * self._period, *forces)
        inner, wanted, output, reference = model
        elements = [
            (over_horizon(a, at, self._ticks, q_y, q_r, horizon=self._horizon), GovernorLimits(*bounds))
            for (a, at, q_y, q_r), bounds in zip(_by_element(model), _by_element(limits), strict=True)
        ]
        c = coefficients(inner, wanted, self._ticks, output, reference)
        return c, None if limits.none else limits, elements

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the governor."""
        m = self.math
        numbers, limits, elements = self.values(context)
        wanted, last, past = memory["wanted_force"], memory["governed_reference"], memory["references"]
        desired = inputs["desired_force"]
        free = free_force(numbers, inputs["measured_force"], past[: self._ticks])
        posed = Situation(wanted, desired, free, last)
        reference = closed_form(numbers, wanted, desired, free)
        fine = abs(reference) < inf
        status = m.where(fine, _OPTIMAL, _NOT_FINITE)
        if self._horizon > 1:
            reference, status = self._solve(context, elements, posed)
        elif limits is not None:
            reference = limits.nearest(numbers, reference, last, free, m)
        after = model_step(numbers, wanted, desired)
        reference = m.where(fine, reference, last)
        return {
            "governed_reference": reference,
            "status": status,
            "wanted_force": m.where(abs(after) < inf, after, wanted),
            "references": [reference, *past[:-1]],
            "posed": posed,
        }

    def program(self, context: Context, element: int = 0) -> MathematicalProgram:
        """The quadratic program of the last tick of one batch element, in r[t], ..., r[t+h-1] [N]; variables, rows and
        costs have names.

        Its r[t] is the governed reference, also where the closed form gives it. Where the forces have slack, its
        weights are too large for some solvers, among Drake's for Clarabel. The program belongs to the context, and the
        next call fills it anew.

        Args:
            context: of this block.
            element: 0 to n-1.

        Raises:
            BadInputError: there is no such batch element, or a force of the last tick is not a number.
        """
        if element not in range(self._size):
            raise invalid("element", element, f"from 0 to {self._size - 1}")
        memory, (_, _, elements) = self.memory(context), self.values(context)
        posed = _by_element(memory["posed"])[element]
        program: GovernorProgram = self._program.Eval(context)
        return program.program(elements[element][0], Situation(*posed), elements[element][1])

    def _solve(
        self, context: Context, elements: Sequence[tuple[Horizon, GovernorLimits]], posed: Situation
    ) -> tuple[BatchValue, BatchValue]:
        """The first reference and the status of every batch element's program."""
        program: GovernorProgram = self._program.Eval(context)
        found = np.empty((2, self._size))
        for i, (forces, (numbers, limits)) in enumerate(zip(_by_element(posed), elements, strict=True)):
            solution = program.solve(numbers, Situation(*forces), limits)
            found[:, i] = solution.u[0], solution.status
        reference, status = found
        return self.batch_value(reference), self.batch_value(status)


def _check_limits(values: Mapping[str, Array]) -> None:
    """BadInputError unless each pair of limits is in order and admits a finite number."""
    for lower, upper in (("lower_limit", "upper_limit"), ("lower_force", "upper_force")):
        check_order(lower, upper, values)
        if np.any(values[lower] == inf) or np.any(values[upper] == -inf):
            raise invalid(lower, values[lower].tolist(), f"a number, or infinite on its own side, as {upper}")


def _by_element(values: Sequence[BatchValue]) -> list[list[float]]:
    """Batch values as one row of numbers per batch element."""
    return np.reshape(values, (len(values), -1)).T.tolist()


class GovernedForceLaw(Around):
    """A force law behind a command governor (Fig. 4.12).

    ```
    name: GovernedForceLaw
    input_ports: [desired_force, measured_force, (further inputs of the law)]
    output_ports: [governed_reference, governor_status, displacement_command, (further outputs of the law)]
    ```

    desired_force, measured_force: shape (n,) [N]. displacement_command: shape (n,) [m], of the law.
    governed_reference, governor_status: shape (n,), of the `CommandGovernor` [N, 1].
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the two; no delay beyond that of the law.

    Args:
        builder: holds the law; it is built into this diagram.
        law: a ForceLaw or a ForceController.

    Raises:
        BadInputError: the law lacks the input desired_force or measured_force.
    """

    port_units = {"governed_reference": "N", "governor_status": "1"}

    def __init__(self, builder: DiagramBuilder, law: System, governor: CommandGovernor):
        super().__init__(law)
        for name in FORCES:
            if not law.HasInputPort(name):
                raise BadInputError(f"{type(law).__name__} has no input port {name!r}: a governed law must have one")
        builder.AddNamedSystem("governor", governor)
        builder.ExportInput(governor.GetInputPort("desired_force"), "desired_force")
        measured = builder.ExportInput(governor.GetInputPort("measured_force"), "measured_force")
        builder.ConnectInput(measured, law.GetInputPort("measured_force"))
        builder.Connect(governor.GetOutputPort("governed_reference"), law.GetInputPort("desired_force"))
        export_all_inputs(builder, law, but=FORCES)
        builder.ExportOutput(governor.GetOutputPort("governed_reference"), "governed_reference")
        builder.ExportOutput(governor.GetOutputPort("status"), "governor_status")
        export_all_outputs(builder, law)
        builder.BuildInto(self)


@dataclass(kw_only=True)
class GovernedConfig(AroundLawConfig, Config):
    """Scenario part `!Governed`: an MPC reference governor that makes a force loop of moderate bandwidth fast.

    The defaults are those of Sec. 4.6.3.

    It stands in front of any force controller. One that does not state the bandwidth of its closed loop needs
    `inner_bandwidth`.
    """

    law: Any = slot("controller", VrftConfig, meaning="force controller whose reference the governor computes")
    inner_bandwidth: float | None = key(
        None,
        "bandwidth (1-A)/Ts of the modelled inner force loop; null: that stated by the law",
        unit="rad/s",
        bounds="positive",
        each=True,
    )
    reference_bandwidth: float = key(
        7.5,
        "bandwidth (1-At)/Ts of the desired response; 7.5: At = 0.985 at 2 ms, 4.5: the 0.991 of the thesis' text",
        unit="rad/s",
        bounds="positive",
        each=True,
    )
    delay: float = key(0.08, "delay T_d of the modelled inner loop, whole ticks", unit="s", bounds="not negative")
    output_weight: float = key(
        1.0, "weight Q_y of predicted force minus desired response", bounds="not negative", each=True
    )
    reference_weight: float = key(1e-3, "weight Q_r of desired force minus reference", bounds="positive", each=True)
    horizon: int = key(
        1,
        "prediction horizon; 1: closed form, more: a quadratic program per tick",
        unit="ticks",
        bounds=f"from 1 to {LONGEST_HORIZON}",
    )
    lower_limit: float = key(-inf, "lower limit of the reference given to the law", unit="N")
    upper_limit: float = key(
        inf, "upper limit of the reference given to the law", unit="N", bounds="positive or infinite"
    )
    rate_limit: float = key(
        inf, "largest rate of change of the reference given to the law", unit="N/s", bounds="positive"
    )
    lower_force: float = key(
        -inf, "lower limit of the predicted force; bounds neither the reference nor the error of the model", unit="N"
    )
    upper_force: float = key(
        inf, "upper limit of the predicted force; bounds neither the reference nor the error of the model", unit="N"
    )
    solver: str = key(DEFAULT_SOLVER, "solver of the quadratic program of a horizon above 1", choices=solver_choices)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.refuse_another("governor")
        inner = self._inner_bandwidth()
        if inner is None:
            fault = " is missing: must be a number, because the law does not state its own"
            raise BadInputError(fault, key="inner_bandwidth")
        check("inner_bandwidth", inner, "positive")
        names = ("lower_limit", "upper_limit", "lower_force", "upper_force")
        _check_limits({name: np.array([getattr(self, name)]) for name in names})
        if self.upper_force <= 0:
            raise invalid("upper_force", self.upper_force, "positive")

    @property
    def in_batches(self) -> bool:  # type: ignore[override]
        """Whether it makes blocks for a batch: a solver of quadratic programs continues from the one before."""
        return self.horizon == 1

    def _inner_bandwidth(self) -> float | None:
        return model_bandwidth(self.law) if self.inner_bandwidth is None else self.inner_bandwidth

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth [rad/s] of the wanted response."""
        return self.reference_bandwidth

    def stability(self, period: float, *, true_delay_ticks: Sequence[int]) -> StabilityReport:
        """For which true delays of the inner loop this governor is stable, as long as no limit acts (Sec. 4.6.2).

        Args:
            period: tick [s].
            true_delay_ticks: Nbar, see `stability_report`.
        """
        check("period", period, "positive")
        inner = 1.0 - period * float(self._inner_bandwidth() or 0.0)
        ticks = whole_multiple("delay", self.delay, period, "period")
        alpha = feedback_weight(inner, ticks, self.output_weight, self.reference_weight, horizon=self.horizon)
        return stability_report(inner, ticks, alpha, true_delay_ticks=true_delay_ticks)

    def governor(self, model: PlantModel) -> CommandGovernor:
        """The block of the governor, without the law.

        Raises:
            BadInputError: a bandwidth that is not below 1/period, or a delay that is not a whole number of periods.
        """

        def pole(name: str, bandwidth: Any) -> Any:
            if bandwidth is None or not np.all(bandwidth * model.period < 1):
                raise invalid(name, bandwidth, f"below 1/period = {1 / model.period:g}")
            return 1 - bandwidth * model.period

        return CommandGovernor(
            model.size,
            inner_pole=pole("inner_bandwidth", self._inner_bandwidth()),
            reference_pole=pole("reference_bandwidth", self.reference_bandwidth),
            delay=self.delay,
            output_weight=self.output_weight,
            reference_weight=self.reference_weight,
            horizon=self.horizon,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            rate_limit=self.rate_limit,
            lower_force=self.lower_force,
            upper_force=self.upper_force,
            period=model.period,
            solver=self.solver,
        )

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> GovernedForceLaw:
        """Add the governor and its law."""
        inner = DiagramBuilder()
        with about(self.law):
            law = self.law.add_to(inner, model)
        return builder.AddNamedSystem("force_law", GovernedForceLaw(inner, law, self.governor(model)))
