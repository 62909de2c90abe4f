"""How well any unbiased estimator can do: Cramer-Rao bounds of a sampled stripe, by Fisher information.

H. Cramer, "Mathematical Methods of Statistics" (1946), section 32.3. Rounding to whole grey levels counts as noise of
variance 1/12. Bounds depend on the sub-pixel phase; what a root mean square over many columns is compared with is the
root mean square of the bound over the phases.
"""

import numpy as np
from scipy.stats import norm

from tests.accuracy.synthetic_columns import Floats, Stripe

ROUNDING = 1.0 / 12.0
PHASES = (np.arange(40) + 0.5) / 40 - 0.5
REACH_PX = 80
CLIP_DN = 254.5


def centre_bound_px(stripe: Stripe, *, exposures: int = 1) -> float:
    """The combined bound ``1 / sqrt(sum m'^2 / (n^2 + 1/12 + m / K + C^2 m^2))``, for pixels that are not clipped.

    Amplitude, width and a constant background may be unknown: by symmetry they cost nothing. A gradient costs a
    percent at most, which is not conceded here.

    Parameters
    ----------
    exposures
        Pixels that are added or subtracted per tap, each with its own read noise and rounding: 2 where a laser-off
        picture or another channel is subtracted, 4 where both are.
    """
    k = np.arange(-REACH_PX, REACH_PX + 1)
    x = k - PHASES[:, None]
    m = stripe.amplitude_dn * np.exp(-(x**2) / (2 * stripe.width_px**2))
    slope = m * x / stripe.width_px**2
    variance = exposures * (stripe.noise_dn**2 + ROUNDING) + m / stripe.electrons_per_dn + (stripe.contrast * m) ** 2
    return float(np.sqrt(np.mean(1.0 / (slope**2 / variance).sum(axis=1))))


def clipped_bounds_px(stripe: Stripe, *, clip_dn: float = CLIP_DN, width_known: bool = False) -> Floats:
    """Bounds of the centre, one per phase of `PHASES`, where brighter pixels than the clip only say so.

    Centre, amplitude, width and background are unknown. The information of a clipped pixel about its mean f is
    ``Phi(z) (1 - Phi(z))``'s share: ``phi(z)^2 / Phi(z)``, z = (f - clip) / n, and that of its complement follows from
    the truncated normal distribution; together ``(Phi(-z) + z phi(z) + phi(z)^2 / Phi(z)) / n^2`` for additive noise.
    """
    return np.array([_clipped_bound(stripe, float(phase), clip_dn, width_known) for phase in PHASES])


def cut_bounds_px(stripe: Stripe, rows: int, centres: Floats) -> Floats:
    """Bounds of the centre, (n,), where only pixels 0..rows-1 exist; amplitude, width and background are unknown."""
    k = np.arange(rows, dtype=np.float64)
    bounds = [np.sqrt(np.linalg.inv(_information(stripe, k - mu, np.inf, False))[0, 0]) for mu in centres]
    return np.array(bounds)


def _clipped_bound(stripe: Stripe, phase: float, clip_dn: float, width_known: bool) -> float:
    x = np.arange(-REACH_PX, REACH_PX + 1) - phase
    return float(np.sqrt(np.linalg.inv(_information(stripe, x, clip_dn, width_known))[0, 0]))


def _information(stripe: Stripe, x: Floats, clip_dn: float, width_known: bool) -> Floats:
    m = np.exp(-(x**2) / (2 * stripe.width_px**2))
    a, s = stripe.amplitude_dn, stripe.width_px
    derivatives = [a * m * x / s**2, m, np.ones_like(x)]
    if not width_known:
        derivatives.append(a * m * x**2 / s**3)
    jacobian = np.column_stack(derivatives)
    deviation = np.sqrt(stripe.noise_dn**2 + ROUNDING)
    z = (stripe.background_dn + a * m - clip_dn) / deviation
    per_pixel = (norm.cdf(-z) + _edge(z)) / deviation**2
    return np.asarray(jacobian.T @ (jacobian * per_pixel[:, None]))


def _edge(z: Floats) -> Floats:
    near = np.abs(z) < 30
    safe = np.where(near, z, 0.0)
    tail = np.exp(norm.logpdf(safe) * 2 - norm.logcdf(safe))
    return np.asarray(np.where(near, safe * norm.pdf(safe) + tail, 0.0))
