"""Sampled linear systems of a batch: one large matrix for all elements, or a small matrix for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues
from pydrake.systems.primitives import LinearSystem
from scipy.linalg import block_diag

from forcectl.arrays import Matrix
from forcectl.framework.block import PythonBlock

if TYPE_CHECKING:
    from scipy.signal import StateSpace

WIDE = 32  # number of batch elements from which on small matrices are as fast as a large one; measured
_LONG = 256  # number of samples in all delay lines from which on the large matrix is slower; measured


def state_space(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, period: float) -> StateSpace:
    """x[k+1] = a x[k] + b u[k], y[k] = c x[k] + d u[k], sampled every `period` [s].

    `scipy.signal` takes most of a second to import, and few loops need it: so it is imported here.
    """
    from scipy.signal import StateSpace

    return StateSpace(a, b, c, d, dt=period)


class LinearBatch(PythonBlock):
    """n sampled linear systems of equal structure behind delay lines, one small matrix for each::

        x[k+1] = A x[k] + B u[k-d],    y[k] = C x[k] + D u[k-d]

    ```
    name: LinearBatch
    input_ports: [u0]
    output_ports: [y0]
    ```

    u0: shape (p n,), grouped by quantity, in the units of the systems, here [1].
    y0: shape (q n,), likewise [1]. Feedthrough of u0 when `ticks` is 0.

    Time and memory grow with n; those of one `LinearSystem` for all elements grow with n^2. A NaN stays in its element.

    Sampling: every `period` [s].

    Args:
        a: A, shape (n, m, m).
        b: B, shape (n, m, p).
        c: C, shape (n, q, m); None: the output is the state.
        d: D, shape (n, q, p); None with C.
        period: [s].
        ticks: delay d in samples.
        state: x before the first tick, shape (m n,).
        line: u before the first tick, shape (p n,).
    """

    def __init__(
        self,
        a: Matrix,
        b: Matrix,
        c: Matrix | None,
        d: Matrix | None,
        period: float,
        ticks: int = 0,
        *,
        state: ArrayLike,
        line: ArrayLike,
    ):
        super().__init__()
        n, p = len(b), b.shape[2]
        # Elements are the last axis: numpy then adds the products in the same order for any n.
        self._a, self._b = np.ascontiguousarray(np.moveaxis(a, 0, -1)), np.ascontiguousarray(np.moveaxis(b, 0, -1))
        self._input = self.DeclareVectorInputPort("u0", p * n)
        self._state = self.DeclareDiscreteState(np.asarray(state, dtype=float))
        self._line = self.DeclareDiscreteState(np.tile(np.asarray(line, dtype=float), ticks)) if ticks else None
        late = self._input.ticket() if self._line is None else self.discrete_state_ticket(self._line)
        if c is None or d is None:
            self.DeclareStateOutputPort("y0", self._state)
        else:
            self._c, self._d = np.ascontiguousarray(np.moveaxis(c, 0, -1)), np.ascontiguousarray(np.moveaxis(d, 0, -1))
            reads = {self.discrete_state_ticket(self._state), late}
            self.DeclareVectorOutputPort("y0", c.shape[1] * n, self._output, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def _late(self, context: Context) -> Matrix:
        """u[k-d], shape (p, n)."""
        if self._line is None:
            values = self._input.Eval(context)
        else:
            values = context.get_discrete_state(self._line).value()[-self._input.size() :]
        return values.reshape(self._b.shape[1:])

    def _output(self, context: Context, output: BasicVector) -> None:
        x = context.get_discrete_state(self._state).value().reshape(self._a.shape[1:])
        output.SetFromVector((_each(self._c, x) + _each(self._d, self._late(context))).ravel())

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        x = context.get_discrete_state(self._state).value().reshape(self._a.shape[1:])
        next_state.set_value(self._state, (_each(self._a, x) + _each(self._b, self._late(context))).ravel())
        if self._line is not None:
            line = context.get_discrete_state(self._line).value()
            now = self._input.Eval(context)
            next_state.set_value(self._line, np.concatenate([now, line[: -now.size]]))


def _each(matrices: Matrix, vectors: Matrix) -> Matrix:
    """Matrix times vector of each element, shapes (i, j, n) and (j, n)."""
    return np.add.reduce(matrices * vectors, axis=1)


def interleave(blocks: Sequence[Matrix] | Matrix) -> Matrix:
    """One matrix for n equal-shaped systems, with the states grouped by quantity instead of by batch element."""
    rows, cols = blocks[0].shape
    order = [np.arange(count * len(blocks)).reshape(len(blocks), count).T.ravel() for count in (rows, cols)]
    return block_diag(*blocks)[np.ix_(*order)]


def sampled_system(
    a: Matrix,
    b: Matrix,
    c: Matrix | None,
    d: Matrix | None,
    period: float,
    ticks: int = 0,
    *,
    state: ArrayLike | None = None,
    line: ArrayLike | None = None,
) -> LinearSystem | LinearBatch:
    """n sampled systems behind delay lines, as a `LinearSystem` or a `LinearBatch`, whichever is faster.

    Args:
        a, b, c, d: of each system, shapes (n, m, m), (n, m, p), (n, q, m) and (n, q, p); without c and d the output is
            the state.
        period: [s].
        ticks: samples of delay.
        state: x before the first tick, shape (m n,); None: zero.
        line: u before the first tick, shape (p n,); None: zero.
    """
    n, m, p = b.shape
    state = np.zeros(m * n) if state is None else np.asarray(state, dtype=float)
    line = np.zeros(p * n) if line is None else np.asarray(line, dtype=float)
    if n >= WIDE or n * p * ticks >= _LONG:
        return LinearBatch(a, b, c, d, period, ticks, state=state, line=line)
    A, B = interleave(a), interleave(b)
    C, D = (np.eye(m * n), np.zeros((m * n, p * n))) if c is None or d is None else (interleave(c), interleave(d))
    system = behind_delay(A, B, C, D, ticks, period)
    system.configure_default_state(np.concatenate([state, np.tile(line, ticks)]))
    return system


def behind_delay(a: Matrix, b: Matrix, c: Matrix, d: Matrix, ticks: int, period: float) -> LinearSystem:
    """A system behind a delay line. Its state: that of the system, then the samples of the line, newest first.

    Args:
        a, b, c, d: matrices of the system.
        ticks: delay in samples.
        period: [s].
    """
    if not ticks:
        return LinearSystem(a, b, c, d, period)
    n, size = b.shape
    line = ticks * size
    A, B = np.zeros((n + line, n + line)), np.zeros((n + line, size))
    A[:n, :n], A[:n, -size:], A[n + size :, n:-size] = a, b, np.eye(line - size)
    B[n : n + size] = np.eye(size)
    C = np.hstack([c, np.zeros((len(c), line - size)), d])
    return LinearSystem(A, B, C, np.zeros_like(d), period)
