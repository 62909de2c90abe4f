"""The field's usual centre estimators, for comparison with the default one.

Each works on the same window around the same coarse peak: R. B. Fisher, D. K. Naidu, "A comparison of algorithms for
subpixel peak detection" (1996) for the centre of gravity; C. Steger, "An unbiased detector of curvilinear structures",
IEEE PAMI 20 (1998), in one dimension; the Gaussian fit is that of the thesis, unweighted least squares of amplitude,
centre, width and a constant background to the brightness profile around the brightest pixel.
"""

import math

import numpy as np
from numba import njit

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.geometry.noise import NoiseModel
from twinline.stripe.censored import solve
from twinline.stripe.light import Light
from twinline.stripe.model import ExtractionSettings
from twinline.stripe.tabulated import AMPLITUDE, BACKGROUND, MISFIT, MU, RESULTS, SD, SD_AMPLITUDE, WIDTH

GRAVITY_REACH = 7
GAUSSIAN_REACH = 15
STEGER_WIDTH_PX = 2.0
STEGER_REACH = 8
_PIXEL_SNR = 5.0

_BRIGHTEST, _GRAVITY, _GAUSSIAN, _STEGER = range(4)
_CODES = {
    "brightest-pixel": (_BRIGHTEST, GRAVITY_REACH),
    "centre-of-gravity": (_GRAVITY, GRAVITY_REACH),
    "gaussian": (_GAUSSIAN, GAUSSIAN_REACH),
    "steger": (_STEGER, STEGER_REACH),
}


def fit_classical(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray
) -> FloatArray:
    """Fit each column with one of the classical methods; returns (RESULTS, n) as `tabulated` names them."""
    code, reach = _CODES[settings.method]
    out = np.full((RESULTS, len(columns)), np.nan)
    _fit(light.flat, light.off, light.has_off, light.step, light.channel, light.minus, columns, rows, code, reach,
         noise.read_dn, out)  # fmt: skip
    return out


@njit(cache=True, error_model="numpy")
def _fit(
    flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, columns: IntArray,
    rows: IntArray, code: int, reach: int, read_dn: float, out: FloatArray,
) -> None:  # fmt: skip
    y = np.empty(2 * reach + 1)
    for j in range(rows.size):
        first, last = max(rows[j] - reach, 0), min(rows[j] + reach + 1, flat.shape[0])
        n = last - first
        at, under = columns[j] * step + channel, columns[j] * step + minus
        low = 1e9
        for r in range(first, last):
            value = float(flat[r, at])
            if minus >= 0:
                value -= float(flat[r, under])
            if has_off:
                value -= float(off[r, at])
                if minus >= 0:
                    value += float(off[r, under])
            y[r - first] = value
            low = min(low, value)
        peak = rows[j] - first
        if n < 5:
            continue
        # The background is the mean of the two ends: the minimum would be biased by the noise.
        background = 0.25 * (y[0] + y[1] + y[n - 2] + y[n - 1])
        if code != _GAUSSIAN and y[peak] - background < _PIXEL_SNR * read_dn:
            # These take their amplitude from one pixel, the highest of hundreds, which noise alone makes 3.5 n high.
            continue
        if code == _GAUSSIAN:
            _gaussian(y, n, peak, background, read_dn, out, j)
        elif code == _STEGER:
            _steger(y, n, peak, background, read_dn, out, j)
        else:
            _gravity(y, n, peak, background, read_dn, out, j)
            if code == _BRIGHTEST:
                out[MU, j] = peak
                out[SD, j] = math.sqrt(1.0 / 12.0 + out[WIDTH, j] ** 2 * read_dn / max(y[peak] - background, 1.0))
                out[AMPLITUDE, j] = y[peak] - background
        out[MU, j] += first
        out[MISFIT, j] = np.nan


@njit(cache=True, error_model="numpy")
def _gravity(y: FloatArray, n: int, peak: int, background: float, read_dn: float, out: FloatArray, j: int) -> None:
    mass = moment = 0.0
    for k in range(n):
        mass += y[k] - background
        moment += (y[k] - background) * k
    if not mass > 0.0:
        return
    mu = moment / mass
    if not (mu > -0.5 and mu < n - 0.5):
        return
    second = spread = 0.0
    for k in range(n):
        second += max(y[k] - background, 0.0) * (k - mu) ** 2
        spread += (k - mu) ** 2
    out[MU, j] = mu
    out[SD, j] = read_dn * math.sqrt(spread) / mass
    out[AMPLITUDE, j] = y[peak] - background
    out[WIDTH, j] = math.sqrt(max(second / mass, 0.1))
    out[BACKGROUND, j] = background
    out[SD_AMPLITUDE, j] = read_dn


@njit(cache=True, error_model="numpy")
def _steger(y: FloatArray, n: int, peak: int, background: float, read_dn: float, out: FloatArray, j: int) -> None:
    """Zero of the Gaussian-smoothed first derivative, from its value and slope at the nearest pixel."""
    s = STEGER_WIDTH_PX
    at = peak
    for _ in range(4):
        first = second = first2 = 0.0
        for k in range(n):
            x = float(at - k)
            kernel = math.exp(-0.5 * x * x / (s * s)) / (math.sqrt(2.0 * math.pi) * s)
            slope = -x / (s * s) * kernel
            first += slope * y[k]
            second += (x * x / (s * s) - 1.0) / (s * s) * kernel * y[k]
            first2 += slope * slope
        if not second < 0.0:
            return
        shift = -first / second
        if abs(shift) <= 0.6 or at + round(shift) < 0 or at + round(shift) >= n:
            break
        at += 1 if shift > 0 else -1
    if abs(shift) > 2.0:
        return
    out[MU, j] = at + shift
    out[SD, j] = read_dn * math.sqrt(first2) / -second
    a = y[peak] - background
    if not a > 0.0:
        out[MU, j] = out[SD, j] = math.nan
        return
    out[AMPLITUDE, j] = a
    # For a Gaussian of width w smoothed with s: -r'' = a w / (w^2 + s^2)^1.5; two fixed-point steps suffice here.
    w = s
    for _ in range(20):
        w = math.sqrt(max((a * w / -second) ** (2.0 / 3.0) - s * s, 0.25))
    out[WIDTH, j] = w
    out[BACKGROUND, j] = background
    out[SD_AMPLITUDE, j] = read_dn


@njit(cache=True, error_model="numpy")
def _gaussian(y: FloatArray, n: int, peak: int, background: float, read_dn: float, out: FloatArray, j: int) -> None:
    """Unweighted least squares of four parameters by Levenberg-Marquardt."""
    a, mu, s, b = max(y[peak] - background, 1.0), float(peak), 2.0, background
    normal, rhs, row, step = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4)
    damped = np.empty((4, 4))
    damping, cost = 1e-3, 1e300
    best_a, best_mu, best_s, best_b = a, mu, s, b
    for _ in range(60):
        normal[:] = 0.0
        rhs[:] = 0.0
        total = 0.0
        for k in range(n):
            t = (k - mu) / s
            m = math.exp(-0.5 * t * t)
            r = y[k] - b - a * m
            total += r * r
            row[0], row[1], row[2], row[3] = m, a * m * t / s, a * m * t * t / s, 1.0
            for p in range(4):
                rhs[p] += row[p] * r
                for q in range(p + 1):
                    normal[p, q] += row[p] * row[q]
        if total <= cost:
            small = cost - total < 1e-10 * cost
            cost, best_a, best_mu, best_s, best_b = total, a, mu, s, b
            damping = max(0.2 * damping, 1e-9)
            if small:
                break
        else:
            damping *= 6.0
            a, mu, s, b = best_a, best_mu, best_s, best_b
            if damping > 1e9:
                break
            continue
        for p in range(4):
            for q in range(p + 1):
                damped[p, q] = normal[p, q]
            damped[p, p] *= 1.0 + damping
        if not solve(damped, rhs, step):
            return
        a, b = a + step[0], b + step[3]
        mu += min(max(step[1], -2.0), 2.0)
        s = min(max(s + step[2], 0.3), float(n))
    if not (best_mu > -0.5 and best_mu < n - 0.5 and best_a > 0.0):
        return
    out[MU, j], out[AMPLITUDE, j], out[WIDTH, j], out[BACKGROUND, j] = best_mu, best_a, abs(best_s), best_b
    out[SD, j] = 1.0623 * math.sqrt(best_s) * read_dn / best_a
    out[SD_AMPLITUDE, j] = read_dn
