"""The joint adjustment of a whole scanner, against a simplex search over the same parameters."""

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from twinline.arrays import FloatArray
from twinline.bench.figures import Figure, Quartiles, Ratio, Section
from twinline.bench.scanner import Problem, simulated_problem
from twinline.bench.turns import take_turns
from twinline.calibration.joint import adjust, cost_of, first_scatter
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_patches import associate
from twinline.calibration.joint_rows import evaluate

JOINT = "joint adjustment"
SIMPLEX = "Nelder-Mead"
LIMIT = "1 s"
MUST, AIM = 1.0, 0.2
_US_PER_S = 1e6
_NS_PER_S = 1e9
_ASSOCIATIONS = 4
_FIRST_STEP_SDS = 0.25


def joint_adjustment(rounds: int, observations: int, evaluations: int) -> Section:
    """All parameters of a scanner adjusted to simulated observations, and the same problem by Nelder-Mead.

    Parameters
    ----------
    observations
        Stripe centres and ToF readings together, at least.
    evaluations
        Bound of the simplex search, which runs once because it takes long.
    """
    problem = simulated_problem(observations)
    seconds = take_turns({JOINT: lambda _: _jointly(problem)}, rounds)[JOINT] / _US_PER_S
    before = time.process_time_ns()
    by_simplex = _by_simplex(problem, evaluations)
    simplex_s = (time.process_time_ns() - before) / _NS_PER_S
    figures = (
        Figure(JOINT, Quartiles.of(seconds), "s", (Ratio(LIMIT, Quartiles.of(seconds), MUST, AIM),)),
        Figure(SIMPLEX, _single(simplex_s), "s", (Ratio(JOINT, Quartiles.of(simplex_s / seconds)),)),
        Figure("shape error before", _single(problem.shape_error_mm(problem.start)), "mm"),
        Figure(f"shape error after the {JOINT}", _single(problem.shape_error_mm(_jointly(problem))), "mm"),
        Figure(f"shape error after {SIMPLEX}", _single(problem.shape_error_mm(by_simplex)), "mm"),
    )
    return Section(
        "joint-adjustment",
        f"Joint adjustment of {int(problem.free.sum())} parameters to {problem.count} observations",
        "Camera, travel, bed, two laser sheets and the ToF mount from simulated stripe centres and readings, from a "
        f"start that is out by up to 6 mm and 1 degree. {SIMPLEX} minimises the same robust cost over the same "
        f"parameters in units of their prior standard deviations, bounded at {evaluations} evaluations, once. The "
        "shape error is the root mean square distance of the scanned points from the true ones after the best rigid "
        "motion.",
        rounds,
        figures,
    )


def _jointly(problem: Problem) -> Scanner:
    return adjust(
        problem.start, problem.observations, problem.priors, cell_mm=problem.cell_mm, free=problem.free
    ).scanner


def _by_simplex(problem: Problem, evaluations: int) -> Scanner:
    """Where the search ends, points being compared anew after every quarter of it."""
    scanner = problem.start
    number = int(problem.free.sum())
    simplex = np.vstack([np.zeros(number), _FIRST_STEP_SDS * np.eye(number)])
    for _ in range(_ASSOCIATIONS):
        found = minimize(
            _cost(problem, scanner),
            np.zeros(number),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": evaluations // _ASSOCIATIONS, "adaptive": True},
        )
        scanner = _moved(problem, scanner, found.x)
    return scanner


def _moved(problem: Problem, scanner: Scanner, sds: FloatArray) -> Scanner:
    theta = scanner.vector()
    theta[problem.free] += sds * problem.prior_sd[problem.free]
    return scanner.with_vector(theta)


def _cost(problem: Problem, scanner: Scanner) -> Callable[[FloatArray], float]:
    link = associate(scanner, problem.observations, problem.cell_mm)
    scatter = first_scatter()

    def cost(sds: FloatArray) -> float:
        moved = _moved(problem, scanner, sds)
        rows = evaluate(moved, problem.observations, link, derivatives=False)
        return cost_of(rows, problem.priors, moved.vector(), scatter)

    return cost


def _single(value: float) -> Quartiles:
    return Quartiles(value, value, value)
