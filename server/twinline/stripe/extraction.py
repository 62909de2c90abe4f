"""Stripe extraction: one picture in, one `StripeProfile` out."""

import numpy as np

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.errors import StripeError
from twinline.geometry.noise import NoiseModel
from twinline.geometry.rig import StripeRuns
from twinline.stripe import tabulated
from twinline.stripe.censored import fit_carefully
from twinline.stripe.classical import fit_classical
from twinline.stripe.continuity import broken_columns, fragments
from twinline.stripe.light import Light, take_light
from twinline.stripe.model import ExtractionSettings, Flag, StripeProfile
from twinline.stripe.noise import estimate_noise, read_noise
from twinline.stripe.peaks import TILE_COLUMNS, find_peaks
from twinline.stripe.tables import LOWEST_AMPLITUDE_DN, SLOPE_SCALE, WIDTH_CLASSES, filter_table

_CAREFUL_REACH_WIDTHS = 7.0
_SAMPLED_COLUMNS = 96
_SAMPLED_REACH = 48
_COARSE_GRAIN = (0.28, 1.4)
"""Speckle contrast above which, and width in pixels below which, only the full likelihood stays near the bound."""
_NARROWEST = 0.5
"""A peak narrower than this share of the usual width is a hot pixel or noise, not a stripe. Below 0.6 px, the narrowest
table, nothing is accepted: no lens draws a finer line."""
_WIDTH_SPREAD = (0.06, 0.5)
"""Least and most assumed relative spread of a stripe's width along one image."""


def extract(
    image: ByteArray,
    settings: ExtractionSettings | None = None,
    *,
    runs: StripeRuns = "along-u",
    bands: IntArray | None = None,
    off: ByteArray | None = None,
) -> StripeProfile:
    """Find the stripes of one picture.

    Parameters
    ----------
    image : (height, width) or (height, width, 3) uint8 array
        Gray, or blue, green, red.
    runs
        "along-u": a stripe crosses every image column once; "along-v": every row.
    bands : (lasers, columns, 2) int array, optional
        Where to look for each laser: image rows [low, high) per column (columns and rows swapped for "along-v").
        Without it one laser is sought in the whole picture.
    off : array like image, optional
        The same view with the lasers off; it is subtracted.

    Returns
    -------
    StripeProfile
        One row per laser in the order of ``bands``.

    Raises
    ------
    StripeError
        If the picture, the bands or the settings are impossible.
    """
    settings = settings or ExtractionSettings()
    light = take_light(image, settings.channel, along_v=runs == "along-v", off=off)
    limits = _bands(light, bands)
    noise = settings.noise or estimate_noise(light, limits, settings)
    return extract_light(light, limits, settings, noise)


def extract_light(light: Light, bands: IntArray, settings: ExtractionSettings, noise: NoiseModel) -> StripeProfile:
    """Find the stripes in prepared light, in bands of shape (lasers, columns, 2), under a known noise model."""
    lasers, columns = bands.shape[0], light.columns
    peak = np.empty((lasers, columns), np.int32)
    runner_up = np.empty((lasers, columns), np.int32)
    runner_up_value = np.empty((lasers, columns), np.uint8)
    find_peaks(light.search, light.step, light.channel, light.minus, tile_bands(bands), settings.exclusion_px,
               peak, runner_up, runner_up_value)  # fmt: skip
    profile = StripeProfile.empty(lasers, columns)
    for laser in range(lasers):
        _fit_laser(light, settings, noise, peak[laser], runner_up[laser], runner_up_value[laser], profile, laser)
    return profile


def tile_bands(bands: IntArray) -> IntArray:
    """Bands per tile of columns, (lasers, tiles, 2): the hull of the columns' bands, split where two lasers overlap."""
    lasers, columns = bands.shape[:2]
    starts = np.arange(0, columns, TILE_COLUMNS)
    tiles = np.empty((lasers, len(starts), 2), np.int32)
    tiles[..., 0] = np.minimum.reduceat(bands[..., 0], starts, axis=1)
    tiles[..., 1] = np.maximum.reduceat(bands[..., 1], starts, axis=1)
    if lasers == 2:
        upper, lower = (0, 1) if bands[0, :, 0].mean() < bands[1, :, 0].mean() else (1, 0)
        overlap = tiles[upper, :, 1] > tiles[lower, :, 0]
        middle = (tiles[upper, :, 1] + tiles[lower, :, 0]) // 2
        tiles[upper, overlap, 1] = middle[overlap]
        tiles[lower, overlap, 0] = middle[overlap]
    return tiles


def _bands(light: Light, bands: IntArray | None) -> IntArray:
    if bands is None:
        whole = np.zeros((1, light.columns, 2), np.int32)
        whole[..., 1] = light.rows
        return whole
    bands = np.asarray(bands)
    if bands.ndim != 3 or bands.shape[1:] != (light.columns, 2):
        raise StripeError(f"Search bands must have shape (lasers, {light.columns}, 2), not {bands.shape}.")
    return np.clip(bands, 0, light.rows).astype(np.int32)


def _fit_laser(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, peak: IntArray, runner_up: IntArray,
    runner_up_value: ByteArray, profile: StripeProfile, laser: int,
) -> None:  # fmt: skip
    columns = np.flatnonzero(peak >= 0).astype(np.int32)
    if not len(columns):
        return
    fit = fit_at(light, settings, noise, columns, peak[columns])
    usual = _median_width(fit)
    found = _significant(fit, settings, noise, usual)
    again = np.flatnonzero(~found & (runner_up[columns] >= 0))
    swapped = np.zeros(len(columns), bool)
    if len(again):
        second = fit_at(light, settings, noise, columns[again], runner_up[columns[again]])
        better = _significant(second, settings, noise, usual)
        fit[:, again[better]] = second[:, better]
        swapped[again[better]] = True
        found[again[better]] = True
    _write(light, settings, noise, columns, fit, found, usual, profile, laser)
    background = fit[tabulated.BACKGROUND]
    other = np.where(swapped, np.nan, runner_up_value[columns] - background)
    real = other > 5.0 * noise.read_dn
    profile.runner_up_dn[laser, columns] = np.where(real, other, np.nan)
    profile.runner_up_px[laser, columns] = np.where(real, runner_up[columns], np.nan)
    strong = real & (other > 0.5 * fit[tabulated.AMPLITUDE])
    profile.flags[laser, columns] |= np.where(strong, int(Flag.SECOND_PEAK), 0).astype(np.uint16)


def _detection_snr(fit: FloatArray, noise: NoiseModel) -> FloatArray:
    """Amplitude over its standard deviation if there were no stripe: then there would be no speckle either.

    For a Gaussian of width w on a free background that is ``0.92 n / sqrt(w)`` (Fisher information of amplitude and
    width, background from a long window).
    """
    return np.asarray(fit[tabulated.AMPLITUDE] * np.sqrt(fit[tabulated.WIDTH]) / (0.92 * noise.read_dn))


def _significant(fit: FloatArray, settings: ExtractionSettings, noise: NoiseModel, usual: float) -> BoolArray:
    with np.errstate(invalid="ignore"):
        wide_enough = fit[tabulated.WIDTH] > _NARROWEST * usual
        snr = _detection_snr(fit, noise)
        return np.asarray(np.isfinite(fit[tabulated.MU]) & (snr > settings.detection_snr) & wide_enough)


def _median_width(fit: FloatArray) -> float:
    width = fit[tabulated.WIDTH]
    return float(np.nanmedian(width)) if np.isfinite(width).any() else 1.0


def _write(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, fit: FloatArray,
    found: BoolArray, typical: float, profile: StripeProfile, laser: int,
) -> None:  # fmt: skip
    """Put the fits of one laser into the profile, with their flags."""
    kept = columns[found]
    good = fit[:, found]
    mu, width = good[tabulated.MU], good[tabulated.WIDTH]
    profile.centre_px[laser, kept] = mu
    profile.sd_px[laser, kept] = good[tabulated.SD]
    profile.amplitude_dn[laser, kept] = good[tabulated.AMPLITUDE]
    profile.width_px[laser, kept] = width
    profile.background_dn[laser, kept] = good[tabulated.BACKGROUND]
    profile.misfit[laser, kept] = good[tabulated.MISFIT]
    snr = _detection_snr(good, noise)
    rows = np.clip(np.rint(mu).astype(np.int64), 0, light.rows - 1)
    top = light.flat[rows, kept * light.step + light.channel]
    reach = 2.0 * width
    flags = np.zeros(len(kept), np.uint16)
    for flag, where in (
        (Flag.WEAK, snr < 2 * settings.detection_snr),
        (Flag.WIDE, width > 2.0 * typical),
        (Flag.NARROW, width < max(0.55, 0.7 * typical)),
        (Flag.SATURATED, top >= settings.saturation_dn),
        (Flag.NEAR_EDGE, (mu < reach) | (mu > light.rows - 1 - reach)),
        (Flag.POOR_FIT, good[tabulated.MISFIT] > _misfit_limit(good[tabulated.MISFIT])),
    ):
        flags |= np.where(where, int(flag), 0).astype(np.uint16)
    profile.flags[laser, kept] = flags
    drop = fragments(profile.centre_px[laser], profile.sd_px[laser], profile.flags[laser])
    if drop.any():
        for values in (profile.centre_px, profile.sd_px, profile.amplitude_dn, profile.width_px, profile.background_dn,
                       profile.misfit):  # fmt: skip
            values[laser, drop] = np.nan
        profile.flags[laser, drop] = int(Flag.MISSING)
    broken = broken_columns(profile.centre_px[laser], profile.sd_px[laser])
    profile.flags[laser] |= np.where(broken, int(Flag.BROKEN), 0).astype(np.uint16)


def _misfit_limit(misfit: FloatArray) -> float:
    """A stripe fits poorly when it does so by far compared with its fellows: the noise model may be a little off."""
    usual = float(np.nanmedian(misfit)) if np.isfinite(misfit).any() else 1.0
    return 4.0 * max(usual, 1.0)


def fit_at(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray
) -> FloatArray:
    """Fit a stripe near the given pixel of each column with the chosen method.

    Returns
    -------
    (RESULTS, n) array
        Rows as named in `tabulated`; NaN where nothing could be fitted.
    """
    if settings.method != "maximum-likelihood":
        return fit_classical(light, settings, noise, columns, rows)
    out = np.full((tabulated.RESULTS, len(columns)), np.nan)
    width, prior = _settled_width(light, settings, noise, columns, rows)
    if noise.speckle > _COARSE_GRAIN[0] and width < _COARSE_GRAIN[1]:
        return _careful(light, settings, noise, columns, rows, width, prior)
    classes = range(len(WIDTH_CLASSES))
    first = _width_class(width)
    todo: IntArray = np.arange(len(columns))
    narrow: list[IntArray] = []
    careful: list[IntArray] = []
    for index in classes[first:]:
        outcome = _tabulated(light, settings, noise, columns, rows, todo, index, width, prior, out)
        careful.append(todo[outcome == tabulated.NEEDS_CARE])
        if index == first:
            narrow.append(todo[outcome == tabulated.TOO_NARROW])
        todo = todo[outcome == tabulated.TOO_WIDE]
        if not len(todo):
            break
    for index in reversed(classes[:first]):
        todo = narrow.pop()
        outcome = _tabulated(light, settings, noise, columns, rows, todo, index, width, prior, out)
        careful.append(todo[outcome == tabulated.NEEDS_CARE])
        narrow.append(todo[outcome == tabulated.TOO_NARROW])
    if len(care := np.concatenate(careful)):
        out[:, care] = _careful(light, settings, noise, columns[care], rows[care], width, prior)
    return out


def _settled_width(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray
) -> tuple[float, float]:
    """Median width of a sample of columns, each fitted with its width free, and the relative spread beyond noise.

    For a Gaussian profile the width is known as well as the centre (both have the information
    ``A^2 sqrt(pi) / (2 w n^2)``), so the centre's reported deviation serves for both.
    """
    width = usual_width(light, columns, rows)
    index = _width_class(width)
    sample = np.unique(np.linspace(0, len(columns) - 1, min(_SAMPLED_COLUMNS, len(columns))).astype(np.int64))
    out = np.full((tabulated.RESULTS, len(columns)), np.nan)
    outcome = _tabulated(light, settings, noise, columns, rows, sample, index, width, 0.0, out)
    done = sample[outcome == tabulated.DONE]
    good = done[_significant(out[:, done], settings, noise, 1.0)]
    if len(good) <= len(sample) // 2:
        return width, _WIDTH_SPREAD[1]
    widths = out[tabulated.WIDTH, good]
    middle = float(np.median(widths))
    spread = 1.4826 * float(np.median(np.abs(widths - middle)))
    explained = float(np.median(out[tabulated.SD, good]))
    own = np.sqrt(max(spread**2 - explained**2, 0.0)) / middle
    return middle, float(np.clip(own, *_WIDTH_SPREAD))


def _width_class(width: float) -> int:
    fitting = (i for i, c in enumerate(WIDTH_CLASSES) if width <= 0.85 * c.widest * c.binning)
    return next(fitting, len(WIDTH_CLASSES) - 1)


def _tabulated(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray, todo: IntArray,
    index: int, width: float, prior: float, out: FloatArray,
) -> ByteArray:  # fmt: skip
    """Fit the columns ``todo`` with one width class, writing into ``out``; returns their outcomes."""
    outcome = np.zeros(len(todo), np.uint8)
    if not len(todo):
        return outcome
    width_class = WIDTH_CLASSES[index]
    table = filter_table(width_class, noise)
    fit = tabulated.fit_32 if width_class.taps == 32 else tabulated.fit_64
    part = np.full((tabulated.RESULTS, len(todo)), np.nan)
    fit(light.flat, light.off, light.has_off, light.step, light.channel, light.minus, settings.saturation_dn,
        columns[todo], rows[todo].copy(), width, prior, width_class.binning, table.filters, table.sd,
        table.sd_amplitude, table.sd_width, table.weights, width_class.narrowest, width_class.widest,
        LOWEST_AMPLITUDE_DN, float(SLOPE_SCALE), part, outcome)  # fmt: skip
    out[:, todo] = part
    return outcome


def _careful(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray, width: float,
    prior: float,
) -> FloatArray:  # fmt: skip
    out = np.full((tabulated.RESULTS, len(columns)), np.nan)
    outcome = np.zeros(len(columns), np.uint8)
    reach = int(np.clip(np.ceil(_CAREFUL_REACH_WIDTHS * width), 12, 64))
    parameters = np.array([noise.read_dn**2, 1.0 / noise.electrons_per_dn, noise.speckle**2])
    fit_carefully(light.flat, light.off, light.has_off, light.step, light.channel, light.minus, settings.saturation_dn,
                  columns, rows, width, prior, reach, parameters, out, outcome)  # fmt: skip
    out[:, outcome != tabulated.DONE] = np.nan
    return out


def usual_width(light: Light, columns: IntArray, rows: IntArray) -> float:
    """Width (standard deviation, pixels) of the stripe, from the mean profile of a sample of columns."""
    sample = np.unique(np.linspace(0, len(columns) - 1, min(_SAMPLED_COLUMNS, len(columns))).astype(np.int64))
    offsets = np.arange(-_SAMPLED_REACH, _SAMPLED_REACH + 1)[:, None]
    near = light.values(np.clip(rows[sample] + offsets, 0, light.rows - 1), columns[sample])
    height = near[_SAMPLED_REACH] - np.median(near, axis=0)
    if not np.max(height) > 0.0:
        return 2.0
    mean = near[:, height > 0.3 * np.max(height)].mean(axis=1)
    # The brightest pixel was chosen for being bright: under speckle it tells nothing of the profile's height.
    middle = mean[_SAMPLED_REACH - 1 : _SAMPLED_REACH + 2]
    top = max(middle[0], middle[2])
    quarter = _SAMPLED_REACH // 2
    left_level, right_level = mean[:quarter].mean(), mean[-quarter:].mean()
    rise = (right_level - left_level) / (len(mean) - quarter)
    low = 0.5 * (left_level + right_level) + rise * np.arange(-_SAMPLED_REACH, _SAMPLED_REACH + 1)
    above = mean - low > 0.5 * (top - low[_SAMPLED_REACH])
    right = int(np.argmin(np.append(above[_SAMPLED_REACH + 1 :], False)))
    left = int(np.argmin(np.append(above[_SAMPLED_REACH - 1 :: -1], False)))
    return float(np.clip((left + right + 1) / 2.355, 0.7, 20.0))


__all__ = ["extract", "extract_light", "fit_at", "read_noise", "tile_bands", "usual_width"]
