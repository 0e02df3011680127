"""Joint-reference filter, the model of the inner position loop.

    h(s) = w^2 / (s^2 + 2 z w s + w^2)                                   (2.3), w = 75.4 rad/s, z = 1 in Sec. 2.2

The command is held over a control tick, so the zero-order-hold discretisation is exact at the ticks; with `period = 0`
the same filter is a continuous state. A command delay of whole ticks sits in front of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import LinearSystem
from scipy.linalg import expm

from forcectl.arrays import Matrix
from forcectl.errors import invalid
from forcectl.framework.batch import batch_values, check, whole_multiple
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import behind_delay, interleave, sampled_system, state_space

if TYPE_CHECKING:
    from scipy.signal import StateSpace

LONGEST_DELAY = 1.0  # [s] largest delay of a sensor: a delay line stores every sample
LONGEST_COMMAND_DELAY = 0.3  # [s] largest command delay of a drive


def second_order(bandwidth: float, damping_ratio: float) -> tuple[Matrix, Matrix]:
    """State matrices A (2, 2) and B (2, 1) of h(s), state = [output, output rate]. (2.3)"""
    w, z = bandwidth, damping_ratio
    return np.array([[0.0, 1.0], [-w * w, -2 * z * w]]), np.array([[0.0], [w * w]])


def zero_order_hold(a: Matrix, b: Matrix, period: float) -> tuple[Matrix, Matrix]:
    """Exact sampled A, B for an input that is constant over each period [s]."""
    n, m = b.shape
    e = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * period)
    return e[:n, :n], e[:n, n:]


def first_order_hold(a: Matrix, b: Matrix, period: float) -> tuple[Matrix, Matrix, Matrix]:
    """Exact sampled Phi, G0, G1 for an input that is linear in time over each period [s].

    x[k+1] = Phi x[k] + G0 u[k] + G1 (u[k+1] - u[k])
    """
    n, m = b.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m], block[n : n + m, n + m :] = a * period, b * period, np.eye(m)
    e = expm(block)
    return e[:n, :n], e[:n, n : n + m], e[:n, n + m :]


@lru_cache(maxsize=1024)  # in a batch most elements have the same values
def _held(bandwidth: float, damping_ratio: float, period: float) -> tuple[Matrix, Matrix]:
    return zero_order_hold(*second_order(bandwidth, damping_ratio), period)


class PositionLoop(PythonDiagram):
    """The inner position loop: command delay, then the joint-reference filter.

    ```
    name: PositionLoop
    input_ports: [command]
    output_ports: [reference]
    ```

    command: shape (n,), [rad] or [m], sampled every `period`.
    reference: shape (2n,), filtered command and its rate, [rad, rad/s] or [m, m/s]. State, no direct feedthrough.

    Sampling: every `period` [s]; continuous with a period of 0 (then `delay` must be 0). Delay from command to
    reference: `delay` [s] plus the lag of the filter.

    Args:
        size: number of joints or batch size n.
        bandwidth: w [rad/s], number or shape (n,), > 0.
        damping_ratio: z [-], number or shape (n,), > 0.
        period: [s], >= 0.
        delay: [s], a whole multiple of period.
        initial_command: [rad] or [m], number or shape (n,): rest value of the filter and of the delay line.
        unit: "rad" or "m", for graphs.
    """

    def __init__(
        self,
        size: int,
        *,
        bandwidth: ArrayLike = 75.4,
        damping_ratio: ArrayLike = 1.0,
        period: float = 0.002,
        delay: float = 0.0,
        initial_command: ArrayLike = 0.0,
        unit: str = "rad",
    ):
        super().__init__()
        self.port_units = {"command": unit, "reference": f"{unit},{unit}/s"}
        w = batch_values("bandwidth", bandwidth, size, "positive and finite")
        z = batch_values("damping_ratio", damping_ratio, size, "positive and finite")
        start = batch_values("initial_command", initial_command, size)
        check("period", period, "not negative")
        if period == 0 and delay != 0:
            raise invalid("delay", delay, "0 for a continuous filter (period = 0)")
        ticks = whole_multiple("delay", delay, period, "period") if delay else 0
        self.sample_delay = {("command", "reference"): ticks * period}

        rest = np.concatenate([start, np.zeros(size)])
        if period:
            held = [_held(wi, zi, period) for wi, zi in zip(w.tolist(), z.tolist(), strict=True)]
            a, b = (np.array(matrices) for matrices in zip(*held, strict=True))
            filter_: System = sampled_system(a, b, None, None, period, ticks, state=rest, line=start)
        else:
            each = [second_order(wi, zi) for wi, zi in zip(w, z, strict=True)]
            a, b = (interleave(matrices) for matrices in zip(*each, strict=True))
            continuous_filter = LinearSystem(a, b, np.eye(2 * size), np.zeros((2 * size, size)))
            continuous_filter.configure_default_state(rest)
            filter_ = continuous_filter

        builder = DiagramBuilder()
        builder.AddNamedSystem("delayed_filter" if ticks else "filter", filter_)
        builder.ExportInput(filter_.get_input_port(), "command")
        builder.ExportOutput(filter_.get_output_port(), "reference")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class PositionLoopConfig(Config, in_batches=True):
    """Scenario part `position_loop`."""

    bandwidth: float = key(
        75.4, "bandwidth w of the joint-reference filter", unit="rad/s", bounds="from 0.1 to 10000", each=True
    )
    damping_ratio: float = key(
        1.0, "damping ratio z of the joint-reference filter", unit="1", bounds="from 0.01 to 10", each=True
    )
    delay: float = key(
        0.002,
        "delay T_t of the command before the joint-reference filter, a whole number of ticks",
        unit="s",
        bounds=f"not negative, at most {LONGEST_COMMAND_DELAY:g}",
    )

    def sampled_response(self, period: float, least_delay: float = 0.0) -> StateSpace:
        """From [command, its rate] to [reference, its rate] of one axis; the rate of the command is not used.

        Args:
            period: tick [s].
            least_delay: of the command, in place of a smaller `delay`; from 0 to the tick [s].
        """
        a, b = _held(self.bandwidth, self.damping_ratio, period)
        ticks = whole_multiple("delay", self.delay, period, "period")
        late = least_delay if ticks == 0 else 0.0
        if 0.0 < late < period:
            # Until `late` after a tick the filter has the command of the tick before, u_old. State [x, u_old].
            _, old = _held(self.bandwidth, self.damping_ratio, late)
            rest, new = _held(self.bandwidth, self.damping_ratio, period - late)
            a, b = np.block([[a, rest @ old], [np.zeros((1, 3))]]), np.vstack([new, [[1.0]]])
        elif late:
            ticks = 1
        one = behind_delay(a, b, np.eye(2, len(a)), np.zeros((2, 1)), ticks, period)
        return state_space(one.A(), one.B() @ [[1.0, 0.0]], one.C(), np.zeros((2, 2)), period)

    def add_to(
        self, builder: DiagramBuilder, size: int, period: float, initial_command: ArrayLike = 0.0, unit: str = "rad"
    ) -> PositionLoop:
        """Add the block for n joints or batch elements."""
        block = PositionLoop(
            size,
            bandwidth=self.bandwidth,
            damping_ratio=self.damping_ratio,
            period=period,
            delay=self.delay,
            initial_command=initial_command,
            unit=unit,
        )
        return builder.AddNamedSystem("position_loop", block)
