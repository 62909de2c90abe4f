"""The noise of the pixels, estimated from pictures of stripes themselves.

The residuals of a fit tell the noise only after the fit's own appetite is accounted for: with ``H`` the projection
onto the model, ``E[r_k^2] = sum_l (I - H)_kl^2 var_l``. With ``var = n^2 + m / K + C^2 m^2`` this is linear in
(n^2, 1/K, C^2), which are found by bounded least squares over many columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.geometry.noise import NoiseModel
from twinline.stripe.light import Light
from twinline.stripe.model import ExtractionSettings, Flag, StripeProfile

_COLUMNS = 400
_FEWEST_COLUMNS = 40
_FEWEST_TAPS = 9
_LAG = 3
_REACH_WIDTHS = 7.0
_LIT_SHARE = 0.01
_SHAPE_SHARE = 0.5
"""What columns have in common is shape if it is more than this share of what they have not. Synthetic Gaussian stripes
reach 0.3 under the strongest speckle; real ones start at 0.7, compressed ones at 10."""
_MOST_SHOT = 0.1
"""Largest 1/K, in DN per electron: 8 bits over a full well of 2500 electrons, fewer than any camera's pixel holds. A
narrow stripe's profile alone can hardly tell shot noise from speckle."""


def read_noise(light: Light) -> float:
    """Standard deviation of dark pixels in DN, quantisation included, from second differences down the columns."""
    if light.rows < 3:
        return 1.0
    rows = np.arange(1, light.rows - 1, max(1, light.rows // 120))
    columns = np.arange(0, light.columns, max(1, light.columns // 320))[None, :]

    def pixels(at: IntArray) -> FloatArray:
        return light.values(at[:, None], columns)

    # Second differences, so that an ambient gradient does not count; their variance is 6 n^2.
    difference = np.abs(pixels(rows + 1) - 2.0 * pixels(rows) + pixels(rows - 1)).ravel()
    # A robust start, then the root mean square of what is not stripe or edge: the median of whole numbers is coarse.
    limit = max(3.5 * 1.4826 * float(np.median(difference)), 4.0)
    kept = difference[difference <= limit]
    return float(np.clip(np.sqrt(np.mean(kept**2) / 6.0), 0.3, 40.0)) if len(kept) else 1.0


def rounded(noise: NoiseModel) -> NoiseModel:
    """The same to two digits, so that nearly equal estimates share their filter tables."""

    def two(value: float) -> float:
        return float(f"{value:.2g}")

    return NoiseModel(two(noise.read_dn), two(noise.electrons_per_dn), two(noise.speckle))


def estimate_noise(light: Light, bands: IntArray, settings: ExtractionSettings) -> NoiseModel:
    """Noise model of one picture: fitted to its own stripes, or the read noise alone if they are too few."""
    from twinline.stripe.extraction import extract_light

    start = rounded(NoiseModel(read_dn=read_noise(light)))
    if settings.method != "maximum-likelihood":
        return start
    noise = start
    for _ in range(2):
        # Weights of the second round come from the first: under strong speckle the first fit is a poor one.
        profile = extract_light(light, bands, settings, noise)
        noise = noise_from_residuals([(light, profile)], start, settings)
    return noise


def noise_from_residuals(
    pictures: list[tuple[Light, StripeProfile]], start: NoiseModel, settings: ExtractionSettings
) -> NoiseModel:
    """Noise model from fitted stripes of one or more pictures.

    Pairs of columns `_LAG` apart tell what is random from what is not: noise differs between them, while a stripe
    whose shape is no Gaussian (a halo, a posterised or compressed picture) leaves the same residuals in both. The
    latter says nothing of the light's noise; it counts as error everywhere in the window.

    Parameters
    ----------
    start
        Model with which the stripes were fitted; returned unchanged if fewer than 40 columns are fit to use.
    """
    pairs = [p for light, profile in pictures for p in _pairs(light, profile, settings, len(pictures))]
    if len(pairs) < _FEWEST_COLUMNS:
        return start
    # Columns on edges or glossy spots are no sample of the noise: drop those whose residuals are out of the ordinary.
    level = np.array([p.random.sum() / p.regressors[:, 0].sum() for p in pairs])
    usual = [pairs[i] for i in np.flatnonzero(level <= 4.0 * np.median(level))]
    random = np.concatenate([p.random for p in usual])
    regressors = np.concatenate([p.regressors for p in usual])
    variances = np.array([start.read_dn**2, 1.0 / start.electrons_per_dn, start.speckle**2])
    for _ in range(4):
        weight = 1.0 / np.maximum(regressors @ variances, 1e-3 * start.read_dn**2)
        # The triangle of the QR decomposition has the same least squares solution as the thousands of rows.
        triangle = np.asarray(np.linalg.qr(np.column_stack([regressors, random]) * weight[:, None], mode="r"))
        fit = lsq_linear(triangle[:3, :3], triangle[:3, 3], bounds=(0.0, [np.inf, _MOST_SHOT, 1.0]))
        variances = fit.x
    n2, shot, speckle2 = variances
    common = np.array([p.common for p in usual])
    sure = float(common.mean()) - 2.0 * float(common.std()) / np.sqrt(len(common))
    if sure > _SHAPE_SHARE * float(np.mean([p.random[p.lit].sum() for p in usual])):
        n2 += sure / float(np.mean([p.regressors[p.lit, 0].sum() for p in usual]))
    elif sure > 0.0:
        # So little is the fit's own bend under strong speckle, alike in all columns: it grows with the light.
        speckle2 = min(speckle2 + sure / float(np.mean([p.regressors[:, 2].sum() for p in usual])), 1.0)
    return rounded(
        NoiseModel(
            read_dn=float(np.sqrt(max(n2, 0.08))),
            electrons_per_dn=float(1.0 / shot) if shot > 1e-4 else float("inf"),
            speckle=float(np.sqrt(speckle2)) if speckle2 > 1e-6 else 0.0,
        )
    )


@dataclass(frozen=True, eq=False)
class _Pair:
    """Residuals of two columns: half their squared difference and its regressors, and the sum of their products.

    Only the taps with light, ``lit``, enter the sum: a stripe's shape has no errors where there is no stripe.
    """

    random: FloatArray
    regressors: FloatArray
    lit: BoolArray
    common: float


def _pairs(light: Light, profile: StripeProfile, settings: ExtractionSettings, pictures: int) -> list[_Pair]:
    """Residuals of a sample of clean columns, each with its neighbour `_LAG` columns on."""
    found: list[_Pair] = []
    spoilt = ~np.uint16(Flag.SATURATED | Flag.WEAK | Flag.BROKEN)
    for laser in range(len(profile.centre_px)):
        clean = profile.found[laser] & (profile.flags[laser] & spoilt == 0)
        both = np.flatnonzero(clean[:-_LAG] & clean[_LAG:])
        if len(both) == 0:
            continue
        wanted = max(_COLUMNS // (pictures * len(profile.centre_px)), 8)
        sample = both[np.unique(np.linspace(0, len(both) - 1, min(wanted, len(both))).astype(np.int64))]
        reach = int(np.ceil(_REACH_WIDTHS * float(np.median(profile.width_px[laser, sample]))))
        for column in sample:
            here = _residuals(light, profile, laser, int(column), reach, settings.saturation_dn)
            there = _residuals(light, profile, laser, int(column) + _LAG, reach, settings.saturation_dn)
            if here is None or there is None:
                continue
            (free, r, a), (other_free, q, b) = here, there
            shared = free & other_free
            if shared.sum() < _FEWEST_TAPS:
                continue
            r, q, a, b = r[shared], q[shared], a[shared], b[shared]
            regressors = 0.5 * (a + b)
            lit = regressors[:, 1] > _LIT_SHARE * regressors[:, 1].max()
            found.append(_Pair(0.5 * (r - q) ** 2, regressors, lit, float(r[lit] @ q[lit])))
    return found


def _residuals(
    light: Light, profile: StripeProfile, laser: int, column: int, reach: int, saturation: int
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """Unsaturated taps, residuals (taps,) and the regressors (taps, 3) of their squares, of one column."""
    mu, s = profile.centre_px[laser, column], profile.width_px[laser, column]
    first = round(float(mu)) - reach
    last = first + 2 * reach + 1
    if first < 0 or last > light.rows:
        return None
    rows = np.arange(first, last)
    free = np.asarray(light.raw(rows, np.array(column)) < saturation)
    if free.sum() < _FEWEST_TAPS:
        return None
    y = light.values(rows, np.array(column))
    x = rows - mu
    m = np.exp(-0.5 * (x / s) ** 2)
    jacobian = np.column_stack([m, m * x / s, m * (x / s) ** 2, np.ones_like(x), 0.1 * x])
    # Saturated pixels are left out of the fit, and then tell nothing of the noise.
    q, _ = np.linalg.qr(jacobian[free])
    left_over = np.eye(int(free.sum())) - q @ q.T
    residual, regressors = np.zeros(len(x)), np.zeros((len(x), 3))
    residual[free] = left_over @ y[free]
    signal = np.maximum(profile.amplitude_dn[laser, column] * m[free], 0.0)
    regressors[free] = (left_over**2) @ np.column_stack([np.ones_like(signal), signal, signal**2])
    return free, residual, regressors
