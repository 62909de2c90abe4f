from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from twinline.arrays import FloatArray
from twinline.calibration.thesis_simplex import _Recorder, indifference, nelder_mead
from twinline.errors import CalibrationError


def bowl(x: FloatArray) -> float:
    return float(np.sum((x - [3.0, -2.0]) ** 2 * [1.0, 40.0]))


def creases(x: FloatArray) -> float:
    """Sum of absolute differences with a narrow valley, as of baseline and angle."""
    return float(np.abs(x[0] + 17.0 * x[1] - 20.0) + np.abs(x[0] + 15.0 * x[1] - 18.0))


def pits(x: FloatArray) -> float:
    """Full of holes, so that simplices shrink."""
    return float(np.sum(np.sin(37.0 * x) + np.floor(5.0 * np.abs(x))))


def terraces(x: FloatArray) -> float:
    """Levels on which neither reflection nor contraction gains anything."""
    return float(np.floor(np.abs(x)).sum())


@pytest.mark.parametrize("objective", [bowl, creases, pits, terraces])
@pytest.mark.parametrize("seed", range(6))
def test_the_recorded_simplex_is_the_one_that_the_search_ends_with(objective: Callable[..., float], seed: int) -> None:
    simplex = np.random.default_rng(seed).normal(0.0, 4.0, (3, 2))
    recorder = _Recorder(objective, simplex, (simplex[0], objective(simplex[0])))
    best: list[float] = []

    def callback(intermediate_result: object) -> None:
        recorder.iteration(intermediate_result)  # type: ignore[arg-type]
        assert recorder._vertices[0][1] == intermediate_result.fun  # type: ignore[attr-defined]
        best.append(recorder.rows[-1][0])

    result = minimize(
        recorder.evaluate, simplex[0], method="Nelder-Mead", callback=callback, options={"initial_simplex": simplex}
    )
    np.testing.assert_array_equal(np.sort([v for _, v in recorder._vertices]), result.final_simplex[1])
    np.testing.assert_array_equal(
        sorted(x.tolist() for x, _ in recorder._vertices), sorted(result.final_simplex[0].tolist())
    )
    assert recorder.evaluations == result.nfev - 1
    assert len(recorder.rows) in (result.nit, result.nit - 1)


@given(st.floats(-50, 50), st.floats(-5, 5))
def test_the_best_value_never_rises_and_the_minimum_is_found_from_anywhere(x: float, y: float) -> None:
    trace = nelder_mead(creases, np.array([x, y]), np.array([5.0, 2.0]), ("x", "y"), tolerance=1e-9)
    assert (np.diff(trace.values) <= 0).all()
    np.testing.assert_array_equal(trace.iterations, np.arange(len(trace)))
    np.testing.assert_allclose(trace.parameters[-1], [3.0, 1.0], atol=1e-6)
    assert trace.values[0] == creases(np.array([x, y]))


def test_the_trace_starts_with_the_start_and_ends_with_a_simplex_as_small_as_asked() -> None:
    trace = nelder_mead(bowl, np.zeros(2), np.array([1.0, 0.5]), ("a", "b"), tolerance=1e-6)
    np.testing.assert_array_equal(trace.parameters[0], 0.0)
    assert trace.simplex_size[0] == 1.0
    assert trace.simplex_size[-1] <= 1e-6
    assert all(trace.simplex_size[k + 1] > trace.simplex_size[k] for k in trace.restarts)
    assert 0 < trace.settled_after() < len(trace)
    assert trace.values[trace.settled_after()] <= 0.01 * trace.values[0] < trace.values[trace.settled_after() - 1]


def test_a_search_that_runs_out_of_iterations_says_so() -> None:
    with pytest.raises(CalibrationError, match="not converged after 5 iterations") as caught:
        nelder_mead(bowl, np.zeros(2), np.ones(2), ("a", "b"), tolerance=1e-6, most_iterations=5)
    assert caught.value.code == "not-converged"


def test_a_start_without_a_value_is_refused_by_name() -> None:
    with pytest.raises(CalibrationError, match="a 1, b 2") as caught:
        nelder_mead(lambda x: float("inf"), np.array([1.0, 2.0]), np.ones(2), ("a", "b"), tolerance=1e-6)
    assert caught.value.code == "bad-start"


def test_indifference_is_as_wide_as_the_valley_and_ends_at_the_reach() -> None:
    def gutter(x: FloatArray) -> float:
        return 1.0 + max(abs(float(x[0])) - 2.0, 0.0)

    ends = indifference(gutter, np.zeros(2), np.array([5.0, 1.0]))
    np.testing.assert_allclose(ends[0], [-2.0, 2.0], atol=0.4)
    np.testing.assert_array_equal(ends[1], [-1.0, 1.0])
