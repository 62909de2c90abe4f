"""Sub-pixel centres by full maximum likelihood: for profiles that are saturated or cut by the image border.

A pixel at the top of the scale only says "at least so bright". Its likelihood is the Gaussian's upper tail (a Tobit
model: J. Tobin, "Estimation of relationships for limited dependent variables", Econometrica 26 (1958)), and the
position is carried by the flanks. Scored with expected information, damped as by Levenberg and Marquardt.
"""

import math

import numpy as np
from numba import njit

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.stripe.tabulated import (
    AMPLITUDE,
    BACKGROUND,
    DONE,
    MISFIT,
    MU,
    NOTHING,
    SD,
    SD_AMPLITUDE,
    WIDTH,
)

UNKNOWNS = 5
"""Centre, logarithm of the width, logarithm of the amplitude, background, gradient."""

MOST_TAPS = 192
_STEPS = 40


@njit(cache=True, error_model="numpy")
def _hazard(z: float) -> float:
    """phi(z) / Phi(z) of the standard normal distribution, safe for large negative z."""
    if z < -8.0:
        return -z + 1.0 / -z
    return math.exp(-0.5 * z * z) * 0.3989422804014327 / (0.5 * math.erfc(-z * 0.7071067811865476))


@njit(cache=True, error_model="numpy")
def _log_tail(z: float) -> float:
    """log Phi(z)."""
    if z < -8.0:
        return -0.5 * z * z - math.log(-z * 2.5066282746310002)
    return math.log(0.5 * math.erfc(-z * 0.7071067811865476))


@njit(cache=True, error_model="numpy")
def solve(matrix: FloatArray, vector: FloatArray, out: FloatArray) -> bool:
    """Solve a small symmetric positive definite system in place by Cholesky; False if it is not definite."""
    n = vector.size
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-300:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(n):
        total = vector[i]
        for k in range(i):
            total -= matrix[i, k] * out[k]
        out[i] = total / matrix[i, i]
    for i in range(n - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, n):
            total -= matrix[k, i] * out[k]
        out[i] = total / matrix[i, i]
    return True


@njit(cache=True, error_model="numpy")
def _score(
    y: FloatArray, clipped: ByteArray, n: int, theta: FloatArray, noise: FloatArray, level: float,
    usual: float, prior: float, information: FloatArray, gradient: FloatArray,
) -> tuple[float, float, float]:  # fmt: skip
    """Log-likelihood, misfit sum and count of free taps; fills information and gradient."""
    mu, s, a = theta[0], math.exp(theta[1]), math.exp(theta[2])
    b, g = theta[3], theta[4]
    j = np.empty(UNKNOWNS)
    information[:] = 0.0
    gradient[:] = 0.0
    likelihood = 0.0
    misfit = 0.0
    free = 0.0
    for k in range(n):
        x = k - mu
        t = x / s
        signal = a * math.exp(-0.5 * t * t)
        f = b + g * (k - 0.5 * n) + signal
        variance = noise[0] + noise[1] * signal + noise[2] * signal * signal
        deviation = math.sqrt(variance)
        j[0] = signal * t / s
        j[1] = signal * t * t
        j[2] = signal
        j[3] = 1.0
        j[4] = k - 0.5 * n
        if clipped[k]:
            z = (f - level) / deviation
            if z > 8.0:
                continue
            hazard = _hazard(z)
            slope = hazard / deviation
            weight = max(hazard * (hazard + z), 0.0) / variance
            likelihood += _log_tail(z)
        else:
            r = y[k] - f
            slope = r / variance
            weight = 1.0 / variance
            likelihood -= 0.5 * r * r / variance + 0.5 * math.log(variance)
            misfit += r * r / variance
            free += 1.0
        for p in range(UNKNOWNS):
            gradient[p] += j[p] * slope
            for q in range(p + 1):
                information[p, q] += j[p] * j[q] * weight
    if prior > 0.0:
        # A grain of speckle can pass for a very narrow stripe: few data leave the width near its fellows'.
        pull = (math.log(usual) - theta[1]) / (prior * prior)
        likelihood -= 0.5 * pull * pull * prior * prior
        gradient[1] += pull
        information[1, 1] += 1.0 / (prior * prior)
    return likelihood, misfit, free


@njit(cache=True, error_model="numpy")
def _start(y: FloatArray, clipped: ByteArray, n: int, peak: int, guess_width: float, theta: FloatArray) -> None:
    """First guess from the run of clipped (or highest) taps around the peak and the flanks beside it."""
    # Background line through the means of the outer taps: an ambient gradient must not pass for the flank.
    first = (y[0] + y[1] + y[2]) / 3.0
    last = (y[n - 1] + y[n - 2] + y[n - 3]) / 3.0
    g = (last - first) / (n - 3.0)
    b = 0.5 * (first + last)
    middle = 0.5 * (n - 1.0)
    lo = hi = peak
    while lo > 0 and clipped[lo - 1]:
        lo -= 1
    while hi < n - 1 and clipped[hi + 1]:
        hi += 1
    top = max(y[peak] - b - g * (peak - middle), 2.0)
    left, right = lo, hi
    while left > 0 and y[left] - b - g * (left - middle) > 0.5 * top:
        left -= 1
    while right < n - 1 and y[right] - b - g * (right - middle) > 0.5 * top:
        right += 1
    run, half = 0.5 * (hi - lo + 1), max(0.5 * (right - left), 0.7)
    theta[0] = 0.5 * (left + right)
    if hi > lo and half > run:
        # Two points of a Gaussian's flank, at the clip level and at half of it, give its width and height.
        s2 = max((half * half - run * run) / (2.0 * math.log(2.0)), 0.2)
        a = top * math.exp(min(0.5 * run * run / s2, 5.0))
    else:
        s2 = (half / 1.1774) ** 2 if guess_width <= 0.0 else guess_width * guess_width
        a = top
    theta[1] = 0.5 * math.log(s2)
    theta[2] = math.log(a)
    theta[3] = b
    theta[4] = g


@njit(cache=True, error_model="numpy")
def _climb(
    y: FloatArray, clipped: ByteArray, n: int, theta: FloatArray, noise: FloatArray, level: float,
    usual: float, prior: float, information: FloatArray,
) -> tuple[bool, float]:  # fmt: skip
    """Maximise the likelihood from theta; returns success and the mean squared residual over its expectation."""
    gradient, step, trial = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    spare, spare_gradient = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    likelihood, misfit, free = _score(y, clipped, n, theta, noise, level, usual, prior, information, gradient)
    damping = 1e-3
    for _ in range(_STEPS):
        for p in range(UNKNOWNS):
            for q in range(p + 1):
                spare[p, q] = information[p, q]
            spare[p, p] += damping * information[p, p] + 1e-12
        if not solve(spare, gradient, step):
            return False, 0.0
        # Steps are held to half a width, half an e-fold of width and one of amplitude.
        s = math.exp(theta[1])
        scale = 1.0
        scale = min(scale, 1.0 * s / max(abs(step[0]), 1e-12))
        scale = min(scale, 0.5 / max(abs(step[1]), 1e-12))
        scale = min(scale, 1.0 / max(abs(step[2]), 1e-12))
        for p in range(UNKNOWNS):
            trial[p] = theta[p] + scale * step[p]
        trial[1] = min(max(trial[1], -1.2), 4.0)
        trial[2] = min(max(trial[2], -1.0), 10.5)
        new, new_misfit, new_free = _score(y, clipped, n, trial, noise, level, usual, prior, spare, spare_gradient)
        if new >= likelihood - 1e-9:
            moved = abs(trial[0] - theta[0]) + 0.1 * s * abs(trial[1] - theta[1])
            for p in range(UNKNOWNS):
                theta[p] = trial[p]
                gradient[p] = spare_gradient[p]
                for q in range(p + 1):
                    information[p, q] = spare[p, q]
            likelihood, misfit, free = new, new_misfit, new_free
            damping = max(damping * 0.2, 1e-9)
            if moved < 2e-4:
                break
        else:
            damping *= 8.0
            if damping > 1e8:
                break
    return True, misfit / max(free - UNKNOWNS, 1.0)


@njit(cache=True, error_model="numpy")
def _observe(
    y: FloatArray, clipped: ByteArray, n: int, theta: FloatArray, noise: FloatArray, level: float, usual: float,
    prior: float, information: FloatArray,
) -> None:  # fmt: skip
    """Replace the expected information by the likelihood's own curvature at the maximum, where that is definite.

    Clipped pixels make the likelihood far from quadratic in width and height, and the expectation over all that might
    have been seen says little of the one profile that was.
    """
    observed, spare = np.empty((UNKNOWNS, UNKNOWNS)), np.empty((UNKNOWNS, UNKNOWNS))
    up, down, at, unit, answer = (np.zeros(UNKNOWNS), np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.zeros(UNKNOWNS),
                                  np.empty(UNKNOWNS))  # fmt: skip
    for p in range(UNKNOWNS):
        h = 0.05 * math.sqrt(1.0 / max(information[p, p], 1e-12))
        at[:] = theta
        at[p] = theta[p] + h
        _score(y, clipped, n, at, noise, level, usual, prior, spare, up)
        at[p] = theta[p] - h
        _score(y, clipped, n, at, noise, level, usual, prior, spare, down)
        for q in range(UNKNOWNS):
            observed[p, q] = (down[q] - up[q]) / (2.0 * h)
    for p in range(UNKNOWNS):
        for q in range(p + 1):
            observed[p, q] = 0.5 * (observed[p, q] + observed[q, p])
    spare[:] = observed
    unit[0] = 1.0
    if solve(spare, unit, answer) and answer[0] > 0.0:
        information[:] = observed


@njit(cache=True, error_model="numpy")
def _window(
    flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, column: int, row: int,
    low: int, high: int, reach: int, saturation: int, y: FloatArray, clipped: ByteArray,
) -> tuple[int, int]:  # fmt: skip
    """Copy a column's profile around a row; grows with the run of saturated pixels. Returns (first row, taps)."""
    at, under = column * step + channel, column * step + minus
    lo = hi = row
    while lo > low and row - lo < MOST_TAPS // 4 and flat[lo - 1, at] >= saturation:
        lo -= 1
    while hi < high - 1 and hi - row < MOST_TAPS // 4 and flat[hi + 1, at] >= saturation:
        hi += 1
    grown = min(reach + (hi - lo), MOST_TAPS // 2 - 1)
    middle = (lo + hi) // 2
    first, last = max(middle - grown, 0), min(middle + grown + 1, flat.shape[0])
    for r in range(first, last):
        value = float(flat[r, at])
        clipped[r - first] = 1 if flat[r, at] >= saturation else 0
        if minus >= 0:
            value -= float(flat[r, under])
        if has_off:
            value -= float(off[r, at])
            if minus >= 0:
                value += float(off[r, under])
        y[r - first] = value
    return first, last - first


@njit(cache=True, error_model="numpy")
def fit_carefully(
    flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, saturation: int,
    columns: IntArray, rows: IntArray, usual_width: float, prior: float, reach: int, noise: FloatArray, out: FloatArray,
    outcome: ByteArray,
) -> None:  # fmt: skip
    """Fit each column by censored maximum likelihood.

    Parameters
    ----------
    noise : (3,) array
        Read variance, variance per DN of signal, and squared speckle contrast.
    prior
        Relative spread of the stripe's width about ``usual_width``; 0 leaves it free.
    reach
        Taps to either side of the peak or of the run of saturated pixels.
    """
    y, clipped = np.empty(MOST_TAPS), np.empty(MOST_TAPS, np.uint8)
    theta = np.empty(UNKNOWNS)
    information = np.empty((UNKNOWNS, UNKNOWNS))
    unit, answer = np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    for j in range(rows.size):
        first, n = _window(flat, off, has_off, step, channel, minus, columns[j], rows[j], 0, flat.shape[0], reach,
                           saturation, y, clipped)  # fmt: skip
        outcome[j] = NOTHING
        free = 0
        for k in range(n):
            free += 1 - clipped[k]
        if free < UNKNOWNS + 3:
            continue
        under = 0.0
        if minus >= 0 or has_off:
            # The level at which the measured light is clipped is lower by what was subtracted.
            at = columns[j] * step + channel
            under = float(flat[rows[j], at]) - y[rows[j] - first]
        level = saturation - 0.5 - under
        _start(y, clipped, n, rows[j] - first, usual_width, theta)
        good, misfit = _climb(y, clipped, n, theta, noise, level, usual_width, prior, information)
        if not good:
            continue
        a = math.exp(theta[2])
        if not (theta[0] > -0.5 and theta[0] < n - 0.5):
            continue
        if free < n:
            _observe(y, clipped, n, theta, noise, level, usual_width, prior, information)
        for p in (0, 2):
            unit[:] = 0.0
            unit[p] = 1.0
            spare = information.copy()
            if not solve(spare, unit, answer):
                good = False
                break
            if p == 0:
                out[SD, j] = math.sqrt(answer[0])
            else:
                out[SD_AMPLITUDE, j] = a * math.sqrt(answer[2])
        if not good:
            continue
        out[MU, j] = first + theta[0]
        out[AMPLITUDE, j] = a
        out[WIDTH, j] = math.exp(theta[1])
        out[BACKGROUND, j] = theta[3] + theta[4] * (theta[0] - 0.5 * n)
        out[MISFIT, j] = misfit
        outcome[j] = DONE
