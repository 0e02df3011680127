"""The equivalent scheme of a governed loop (Fig. 4.13): four transfer functions in place of the problem (4.31).

Without limits and with a horizon of one tick, (4.33)* is linear, and the loop of governor and inner loop is::

    F_bar -> A -> (+) -> B -> M* -+-> y
                   ^-             |
                   +-- feedback <-+

    A  = alpha/(1-A) F1 + (1-alpha)                                      (4.37)
    B  = 1/(1 + alpha F2)                                                (4.38)
    F1 = ((1-P) z - At + P)/(z - At),     P = At^N_p: F_bar -> yt[t+N_p]
    F2 = A/z + ... + (A/z)^N                                             (4.36)
    M* = (1-A)/(z^Nbar (z - A)),          the inner loop with its true delay Nbar        (4.28)
    feedback = alpha A^N_p/(1-A)

(4.35)* is the same for a constant F_bar, in steps of N_p ticks, with N_p states that start on the wanted response. Here
F1 has one state, is updated every tick, and holds for any F_bar. A stands before the loop, so the poles of (4.39) are
those of B, M* and the feedback: the roots of (4.40), see `stability`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, LinearSystem, MatrixGain

from forcectl.force.governor.program import check_pole, check_ticks
from forcectl.force.governor.stability import feedback_weight
from forcectl.framework.batch import check
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import through


class EquivalentScheme(PythonDiagram):
    """The governed loop as its four transfer functions, for one force (Fig. 4.13).

    ```
    name: EquivalentScheme
    input_ports: [desired_force]
    output_ports: [force, governed_reference]
    ```

    desired_force: shape (1,), F_bar [N].
    force: shape (1,), y of the inner loop [N]. State, no direct feedthrough.
    governed_reference: shape (1,), r [N]. Feedthrough of desired_force.

    Sampling: every `period` [s]; it starts at rest, with all past forces and references zero.

    Args:
        inner_pole: A, in (0, 1).
        reference_pole: At, in (0, 1).
        delay_ticks: N >= 0, delay in the governor's model.
        true_delay_ticks: Nbar >= 0, delay of the inner loop.
        output_weight: Q_y >= 0.
        reference_weight: Q_r > 0.

    Raises:
        BadInputError: a value outside of its range.
    """

    port_units = {"governed_reference": "N"}

    def __init__(
        self,
        *,
        inner_pole: float = 0.997,
        reference_pole: float = 0.985,
        delay_ticks: int = 40,
        true_delay_ticks: int = 40,
        output_weight: float = 1.0,
        reference_weight: float = 1e-3,
        period: float = 0.002,
    ):
        super().__init__()
        check_pole("reference_pole", reference_pole)
        check("period", period, "positive")
        n = check_ticks("delay_ticks", delay_ticks)
        true = check_ticks("true_delay_ticks", true_delay_ticks)
        alpha = feedback_weight(inner_pole, n, output_weight, reference_weight)
        gain = alpha / (1.0 - inner_pole)
        decay = reference_pole ** (n + 1)
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect

        # x[k+1] = At x[k] + (1-At) F_bar is yt; F1 looks N_p ticks ahead of it.
        f1 = add("F1", _linear([[reference_pole]], [[1.0 - reference_pole]], [[decay]], 1.0 - decay, period))
        wanted = through(builder, "of_wanted", _gain(gain), f1.get_output_port())
        direct = add("of_desired", _gain(1.0 - alpha))
        reference = add("A", Adder(2, 1))
        connect(wanted, reference.get_input_port(0))
        connect(direct.get_output_port(), reference.get_input_port(1))

        # The state of F2 is r[t-1], ..., r[t-N].
        past = np.array([[inner_pole ** (i + 1) for i in range(n)]])
        f2 = add("F2", _linear(np.eye(n, k=-1), np.eye(n, 1), past, 0.0, period))
        taken = through(builder, "of_past", _gain(-alpha), f2.get_output_port())
        summed = add("B", Adder(3, 1))
        connect(reference.get_output_port(), summed.get_input_port(0))
        connect(taken, summed.get_input_port(1))
        connect(summed.get_output_port(), f2.get_input_port())

        inner = through(builder, "M", delayed_loop(inner_pole, true, period), summed.get_output_port())
        feedback = through(builder, "feedback", _gain(-gain * inner_pole ** (n + 1)), inner)
        connect(feedback, summed.get_input_port(2))

        desired = builder.ExportInput(f1.get_input_port(), "desired_force")
        builder.ConnectInput(desired, direct.get_input_port())
        builder.ExportOutput(inner, "force")
        builder.ExportOutput(summed.get_output_port(), "governed_reference")
        builder.BuildInto(self)


def delayed_loop(inner_pole: float, true_delay_ticks: int, period: float) -> LinearSystem:
    """M*: y[t+1] = A y[t] + (1-A) r[t-Nbar], with the state y, r[t-1], ..., r[t-Nbar]. (4.28)"""
    check_pole("inner_pole", inner_pole)
    n = check_ticks("true_delay_ticks", true_delay_ticks)
    matrix, column = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 1))
    matrix[0, 0] = inner_pole
    if n == 0:
        column[0] = 1.0 - inner_pole
    else:
        matrix[0, n] = 1.0 - inner_pole
        matrix[2:, 1:-1] = np.eye(n - 1)
        column[1] = 1.0
    return _linear(matrix, column, np.eye(1, n + 1), 0.0, period)


def _linear(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: float, period: float) -> LinearSystem:
    """A sampled system with one input and one output."""
    return LinearSystem(np.asarray(a), np.asarray(b), np.asarray(c), np.array([[d]]), period)


def _gain(value: float) -> MatrixGain:
    return MatrixGain(np.array([[value]]))
