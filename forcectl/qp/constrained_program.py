"""The quadratic program of a controller in joint accelerations: regulated outputs, constraints, joint torques, braking.

    min  u'H u/2 + f'u    s.t.   R u <= r  (soft),   E u <= f,   lower <= u <= upper,   |M u + h| <= limit

The rows of the torques are in it only in ticks in which a joint would exceed its torque without them: a quarter of the
time of a tick otherwise, for rows that seldom bind.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forcectl.qp.quadratic_program import QuadraticProgram, Solution, SolverFactory
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import ConstraintSet, JointTorqueLimit, Rows

Vector = NDArray[np.float64]

_SLACK_WEIGHT = 1e6  # of regulated outputs: what slack costs beside the objective
_FIRST = 100.0  # times that for the first one: it gives way after the others
_HOLDS = -1e-9  # a row that is missed by less holds with equality


class Outcome(NamedTuple):
    """solution: its u brakes when there was none. active: rows and bounds that hold with equality.

    beyond: the largest violation of a row of relative degree 0 [its unit], a torque included; 0 when none is.
    """

    solution: Solution
    active: int
    beyond: float


class ConstrainedProgram:
    """Built once, solved at every tick.

    Args:
        constraints: the hard rows and bounds. outputs: number of soft rows, the most important one first. torque: limit
            of the joints, infinite where there is none (n,) [Nm]. solver: of the programs.
    """

    def __init__(self, constraints: ConstraintSet, outputs: int, torque: Vector, solver: SolverFactory):
        self._constraints, self._outputs = constraints, outputs
        weights = np.full(outputs + constraints.size, np.inf)
        weights[:outputs] = _SLACK_WEIGHT
        weights[0] *= _FIRST
        self._program = QuadraticProgram(len(torque), len(weights), slack_weight=weights, solver=solver)
        self._torque = JointTorqueLimit(torque) if np.isfinite(torque).any() else None
        if self._torque is not None:
            weights = np.append(weights, np.full(self._torque.size, np.inf))
            self._limited = QuadraticProgram(len(torque), len(weights), slack_weight=weights, solver=solver)

    def solve(
        self, motion: RobotMotion, rows: Rows, hessian: Vector, gradient: Vector, soft: tuple[Vector, Vector]
    ) -> Outcome:
        """The optimum, the nearest to it, or braking.

        Args:
            rows: of the constraints at this tick. hessian, gradient: H (n, n) and f (n,). soft: R (k, n) and r (k,).
        """
        k, torque, beyond = self._outputs, self._torque, 0.0
        matrix, limit = np.concatenate([soft[0], rows.matrix]), np.concatenate([soft[1], rows.limit])
        solution = self._attempt(self._program, motion, rows, hessian, gradient, matrix, limit)
        if torque is not None and torque.excess(motion, solution.u) > 0.0:
            more, allowed = torque.rows(motion)
            matrix, limit = np.concatenate([matrix, more]), np.concatenate([limit, allowed])
            solution = self._attempt(self._limited, motion, rows, hessian, gradient, matrix, limit)
            beyond = torque.excess(motion, solution.u)
        u = solution.u
        missed = (matrix @ u - limit).tolist()
        active = sum(by > _HOLDS for by in missed)
        active += sum(not low < a < high for low, a, high in zip(rows.lower, u.tolist(), rows.upper, strict=True))
        return Outcome(solution, active, max(0.0, beyond, *missed[k : k + rows.direct]))

    def _attempt(
        self,
        program: QuadraticProgram,
        motion: RobotMotion,
        rows: Rows,
        hessian: Vector,
        gradient: Vector,
        matrix: Vector,
        limit: Vector,
    ) -> Solution:
        solution = program.solve(
            hessian, gradient, matrix, limit, u_lower=rows.lower, u_upper=rows.upper, fallback=motion.v
        )
        return solution._replace(u=self._constraints.brake(motion.v, rows)) if solution.status.brakes else solution
