"""Nelder-Mead with its iteration trace, for the convergence graphs of the thesis's methods.

The method: J. A. Nelder and R. Mead, "A simplex method for function minimization", The Computer Journal 7 (1965).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from twinline.arrays import FloatArray, IntArray
from twinline.errors import CalibrationError

Objective = Callable[[FloatArray], float]

_RESTARTS = 12
_RESTART_SHRINK = 0.3
_WORTH_A_RESTART = 1e-4
_INDIFFERENT = 0.05
_SCAN_STEPS = 25


@dataclass(frozen=True, eq=False)
class NelderMeadTrace:
    """The way of a simplex to its minimum, one row per iteration.

    Attributes
    ----------
    iterations : (k,) int array
        0 for the start, then 1, 2, ...
    values : (k,) array
        Best value so far; never rises.
    parameters : (k, p) array
        Where it was found, in the units that ``names`` say.
    simplex_size : (k,) array
        Largest difference of any coordinate of any vertex to the best vertex; grows where the search was restarted.
    names : (p,) tuple
    restarts : tuple of int
        Iterations after which the search began again from the best point with a fresh simplex.
    evaluations
        How often the objective was computed.
    """

    iterations: IntArray
    values: FloatArray
    parameters: FloatArray
    simplex_size: FloatArray
    names: tuple[str, ...]
    restarts: tuple[int, ...] = ()
    evaluations: int = 0

    def __len__(self) -> int:
        return len(self.iterations)

    def settled_after(self, share: float = 0.99) -> int:
        """First iteration at which this share of the whole improvement was reached."""
        goal = self.values[0] - share * (self.values[0] - self.values[-1])
        return int(self.iterations[int(np.argmax(self.values <= goal))])


class _Recorder:
    """Follows the simplex from the evaluations of each iteration, which is all that scipy shows of it."""

    def __init__(self, objective: Objective, simplex: FloatArray, known: tuple[FloatArray, float]) -> None:
        self._objective = objective
        self._pending: list[tuple[FloatArray, float]] = []
        self._vertices: list[tuple[FloatArray, float]] = []
        self._count = len(simplex)
        self._known = known
        self.evaluations = 0
        self.rows: list[tuple[float, FloatArray, float]] = []

    def evaluate(self, x: FloatArray) -> float:
        """The objective; the start's value is not computed twice."""
        if np.array_equal(x, self._known[0]):
            value = self._known[1]
        else:
            value = self._objective(x)
            self.evaluations += 1
        self._pending.append((x.copy(), value))
        if len(self._vertices) < self._count:
            self._vertices.append(self._pending.pop())
            self._vertices.sort(key=_value)
        return value

    def iteration(self, intermediate_result: OptimizeResult) -> None:
        """What scipy calls after each iteration, and once more without one when it stops."""
        if not self._pending:
            return
        first = self._pending[0]
        if len(self._pending) > 2:
            self._vertices = [self._vertices[0], *self._pending[2:]]
        elif len(self._pending) == 2 and first[1] >= self._vertices[0][1]:
            self._vertices[-1] = self._pending[1]
        else:
            self._vertices[-1] = min(self._pending, key=_value)
        self._pending = []
        self._vertices.sort(key=_value)
        self.rows.append((float(intermediate_result.fun), np.array(intermediate_result.x), self.size()))

    def size(self) -> float:
        """What scipy compares with its tolerance for the parameters."""
        best = self._vertices[0][0]
        return float(max(np.abs(x - best).max() for x, _ in self._vertices[1:]))


def _value(vertex: tuple[FloatArray, float]) -> float:
    return vertex[1]


def nelder_mead(
    objective: Objective,
    start: FloatArray,
    steps: FloatArray,
    names: tuple[str, ...],
    *,
    tolerance: float,
    most_iterations: int = 5000,
) -> NelderMeadTrace:
    """Minimise by Nelder-Mead; the last row of the trace is the result.

    A sum of absolute differences has creases, across which a simplex can collapse before the minimum. So a search that
    has converged begins again around its best point with a simplex of 0.3 times the steps before, until that gains less
    than a ten-thousandth.

    Parameters
    ----------
    start, steps : (p,) arrays
        First vertex, and the other vertices' distance from it along each parameter.
    tolerance
        Largest spread of the simplex, in parameters and in values, at which the search ends.
    most_iterations
        Of all searches together.

    Raises
    ------
    CalibrationError
        ``not-converged``, or ``bad-start`` where the objective is not finite at the start.
    """
    best_x = np.array(start, dtype=np.float64)
    best = objective(best_x)
    if not np.isfinite(best):
        shown = ", ".join(f"{name} {value:.6g}" for name, value in zip(names, best_x, strict=True))
        raise CalibrationError(
            f"Nothing can be computed at the start ({shown}): check the nominal values of the rig.", code="bad-start"
        )
    rows: list[tuple[float, FloatArray, float]] = [(best, best_x, float(np.abs(steps).max()))]
    restarts: list[int] = []
    evaluations, simplex_steps = 1, np.array(steps, dtype=np.float64)
    for _ in range(_RESTARTS + 1):
        simplex = np.vstack([best_x, best_x + np.diag(simplex_steps)])
        recorder = _Recorder(objective, simplex, (best_x, best))
        result = minimize(
            recorder.evaluate,
            best_x,
            method="Nelder-Mead",
            callback=recorder.iteration,
            options={
                "initial_simplex": simplex,
                "xatol": tolerance,
                "fatol": tolerance,
                # scipy counts the first simplex as an iteration; so does len(rows).
                "maxiter": most_iterations - len(rows) + 2,
                "maxfev": 100 * most_iterations,
            },
        )
        rows.extend(recorder.rows)
        evaluations += recorder.evaluations
        if not result.success:
            raise CalibrationError(
                f"Nelder-Mead has not converged after {len(rows) - 1} iterations (best value {rows[-1][0]:.6g}, "
                f"simplex {rows[-1][2]:.3g}): check that the points lie at two heights at least, or use the joint "
                "method.",
                code="not-converged",
            )
        improved = best - float(result.fun)
        best_x, best = np.array(result.x), float(result.fun)
        if improved <= max(tolerance, _WORTH_A_RESTART * best):
            break
        restarts.append(len(rows) - 1)
        simplex_steps = simplex_steps * _RESTART_SHRINK
    return NelderMeadTrace(
        np.arange(len(rows)),
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]),
        names,
        tuple(restarts),
        evaluations,
    )


def indifference(objective: Objective, best: FloatArray, reach: FloatArray) -> FloatArray:
    """How far each parameter alone can go from the minimum before the value rises by a twentieth.

    A wide interval says that the data do not determine the parameter, whatever number the search ended at.

    Parameters
    ----------
    best, reach : (p,) arrays
        The minimum, and how far to look to either side of it.

    Returns
    -------
    (p, 2) array
        Lower and upper end, absolute.
    """
    limit = objective(best) * (1.0 + _INDIFFERENT) + 1e-9
    ends = np.empty((len(best), 2))
    for i in range(len(best)):
        for side, sign in enumerate((-1.0, 1.0)):
            ends[i, side] = best[i]
            for k in range(1, _SCAN_STEPS + 1):
                trial = best.copy()
                trial[i] += sign * reach[i] * (k / _SCAN_STEPS) ** 2
                if not objective(trial) <= limit:
                    break
                ends[i, side] = trial[i]
    return ends
