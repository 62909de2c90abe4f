"""Precomputed linear filters: the tabulated maximum-likelihood estimator.

A stripe's profile over the window of ``taps`` pixels around its peak is ``y(x) = b + g x + A m((x - mu) / s)`` with
the Gaussian ``m(t) = exp(-t^2 / 2)``. Around a node (mu0, s0) it is linear in ``A``, ``A (mu - mu0)``,
``A (s - s0)``, ``b`` and ``g``, so that one step of Fisher's scoring for Gaussian noise of known variance is a product
of the window with five fixed filters: weighted least squares, S. M. Kay, "Fundamentals of Statistical Signal
Processing: Estimation Theory" (1993), sections 4.5 and 7.7. The filters are computed once for a grid of phases
``mu0``, widths ``s0`` and, because speckle makes the variance grow with the light, amplitudes; two or three look-ups
then reach the bound.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from twinline.arrays import FloatArray
from twinline.geometry.noise import NoiseModel

SLOPE_SCALE = np.float32(0.1)
"""Unit of the gradient column in the fits, per pixel: keeps the normal equations well conditioned."""

LOWEST_AMPLITUDE_DN = 8.0
"""Amplitude of the first amplitude node; each next is twice as large."""


REACH_WIDTHS = 6.0
"""How far from the centre the profile is used: further out lie other things than the stripe, while the gradient, whose
price grows as the window shrinks, costs 2 % of the precision here."""

LEAST_REACH_TAPS = 8.0


_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 4), (1, 1), (1, 2), (1, 4), (2, 2), (2, 4), (4, 4))


@dataclass(frozen=True)
class WidthClass:
    """A family of tables: window length in taps, pixels averaged into one tap, widths in taps that it covers."""

    taps: int
    binning: int
    narrowest: float
    widest: float
    widths: int
    phases: int


# The window must be some seven widths to either side of the centre, or the ambient gradient costs precision (with
# +-4 widths 8 %, with +-6.5 widths 2 %); averaging two pixels costs 1 / (16 width^2) of the precision.
WIDTH_CLASSES: tuple[WidthClass, ...] = (
    WidthClass(32, 1, 0.6, 2.6, 34, 32),
    WidthClass(64, 1, 2.2, 5.2, 26, 16),
    WidthClass(64, 2, 2.2, 5.2, 26, 16),
    WidthClass(64, 4, 2.2, 5.2, 26, 16),
)


@dataclass(frozen=True, eq=False)
class FilterTable:
    """Filters for one width class and one noise model.

    Attributes
    ----------
    filters : (amplitudes, widths, phases, 6, taps) float32 array
        Filters for A, A dmu, A ds, b and g; then the inverse variances in 1/DN^2, 0 where a tap is not used. Amplitude
        0 stands for noise that does not grow with the light: it is the only one if there is none that does, and
        otherwise the one to start with, because weights that discount the core of the stripe only converge from
        nearby. A picture's stripes have few widths, so the phases of one width lie together.
    sums : (amplitudes, widths, phases, 12) float32 array
        What the residual's sum of squares needs: the sum of the weights; the normal equations' elements AA, Ap, Aq,
        Ag, pp, pq, pg, qq, qg and gg (p, q for A dmu, A ds); the taps that are used, less the five parameters.
    sd : (amplitudes, widths, phases) float32 array
        Standard deviation of ``A dmu`` in DN taps, and
    sd_amplitude, sd_width : same shape
        of ``A`` in DN and of ``A ds`` in DN taps, for the noise at that node.
    """

    width_class: WidthClass
    filters: FloatArray
    sums: FloatArray
    sd: FloatArray
    sd_amplitude: FloatArray
    sd_width: FloatArray


@lru_cache(maxsize=32)
def filter_table(width_class: WidthClass, noise: NoiseModel) -> FilterTable:
    """Filters for stripes of a width class under a noise model (both hashable; results are kept).

    Parameters
    ----------
    noise
        Noise of single pixels; averaging several into a tap is accounted for here.
    """
    c = width_class
    signal_dependent = noise.speckle > 0 or np.isfinite(noise.electrons_per_dn)
    amplitudes = [0.0, *(LOWEST_AMPLITUDE_DN * 2.0 ** np.arange(6))] if signal_dependent else [0.0]
    taps = np.arange(c.taps) - (c.taps // 2 - 1.0)
    phases = (np.arange(c.phases) + 0.5) / c.phases - 0.5
    widths = np.linspace(c.narrowest, c.widest, c.widths)
    shape = (len(amplitudes), c.widths, c.phases, c.taps)
    x = np.broadcast_to(taps - phases[None, :, None], shape[1:])
    s = widths[:, None, None]
    m = np.exp(-0.5 * (x / s) ** 2)
    near = (np.abs(x) <= np.maximum(REACH_WIDTHS * s, LEAST_REACH_TAPS)).astype(np.float64)
    columns = [m, m * x / s**2, m * x**2 / s**3, np.ones_like(m), np.broadcast_to(float(SLOPE_SCALE) * taps, m.shape)]
    jacobian = np.stack(columns, axis=2)
    filters, sums = np.empty((*shape[:3], 6, c.taps), np.float32), np.empty((*shape[:3], 12), np.float32)
    sd, sd_amplitude, sd_width = (np.empty(shape[:3], np.float32) for _ in range(3))
    used = near.sum(axis=-1) - 5.0
    for i, amplitude in enumerate(amplitudes):
        w = c.binning / noise.variance_dn2(amplitude * m) * near
        weighted = jacobian * w[:, :, None, :]
        normal = weighted @ np.swapaxes(jacobian, -1, -2)
        covariance = np.linalg.inv(normal)
        filters[i, :, :, :5] = covariance @ weighted
        filters[i, :, :, 5] = w
        sums[i] = np.stack([w.sum(axis=-1), *(normal[:, :, j, k] for j, k in _PAIRS), used], axis=-1)
        sd[i] = np.sqrt(covariance[:, :, 1, 1])
        sd_amplitude[i] = np.sqrt(covariance[:, :, 0, 0])
        sd_width[i] = np.sqrt(covariance[:, :, 2, 2])
    return FilterTable(c, filters, sums, sd, sd_amplitude, sd_width)
