"""Stripe extraction: one picture in, one `StripeProfile` out."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.errors import StripeError
from twinline.geometry.noise import NoiseModel
from twinline.geometry.rig import StripeRuns
from twinline.stripe import tabulated
from twinline.stripe.censored import fit_carefully
from twinline.stripe.classical import fit_classical
from twinline.stripe.light import Light, take_light
from twinline.stripe.model import ExtractionSettings, StripeProfile
from twinline.stripe.noise import estimate_noise, read_noise
from twinline.stripe.peaks import find_peaks, tile_bands
from twinline.stripe.tables import LOWEST_AMPLITUDE_DN, WIDTH_CLASSES, filter_table
from twinline.stripe.verdict import enter_stripes, median, settle_width, significant
from twinline.stripe.width import UsualWidth, sample_places, usual_width

_CAREFUL_REACH_WIDTHS = 7.0
_COARSE_GRAIN = (0.28, 1.4)
"""Speckle contrast above which, and width in pixels below which, only the full likelihood stays near the bound."""
_MARGIN = 1.0 / 0.85
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


def extract_light(
    light: Light,
    bands: IntArray,
    settings: ExtractionSettings,
    noise: NoiseModel,
    widths: Sequence[UsualWidth] | None = None,
) -> StripeProfile:
    """Find the stripes in prepared light.

    Parameters
    ----------
    bands : (lasers, columns, 2) int array
        See `extract`.
    noise
        Noise of the pixels.
    widths
        How wide each laser's stripe is in this pass, as `usual_widths` finds it; found in this picture alone where not
        given.
    """
    peaks = _peaks(light, bands, settings)
    profile = StripeProfile.empty(*peaks.row.shape)
    for laser in range(len(peaks.row)):
        _fit_laser(light, settings, noise, peaks, widths[laser] if widths else None, profile, laser)
    return profile


def usual_widths(
    lights: Sequence[Light], bands: IntArray, settings: ExtractionSettings, noise: NoiseModel
) -> tuple[UsualWidth, ...] | None:
    """How wide each laser's stripe is over some pictures of one pass, and how much that varies.

    None if the method needs no width, or for lack of stripes.
    """
    if settings.method != "maximum-likelihood":
        return None
    pictures = [(light, _peaks(light, bands, settings)) for light in lights]
    widths = []
    for laser in range(len(bands)):
        seen = []
        for light, peaks in pictures:
            columns = np.flatnonzero(peaks.row[laser] >= 0).astype(np.int32)
            if len(columns):
                width = _settled_width(light, settings, noise, columns, peaks.row[laser][columns])
                seen += [width] if width.seen else []
        if not seen:
            return None
        middle = float(np.median([width.px for width in seen]))
        between = float(np.std([width.px for width in seen])) / middle
        spread = float(np.hypot(np.median([width.spread for width in seen]), between))
        widths.append(UsualWidth(middle, min(spread, _WIDTH_SPREAD[1]), seen=True))
    return tuple(widths)


class _Peaks(NamedTuple):
    """The most and the next most prominent pixel of each column, (lasers, columns); see `find_peaks`."""

    row: IntArray
    runner_up: IntArray
    runner_up_value: ByteArray


def _peaks(light: Light, bands: IntArray, settings: ExtractionSettings) -> _Peaks:
    shape = bands.shape[:2]
    peaks = _Peaks(np.empty(shape, np.int32), np.empty(shape, np.int32), np.empty(shape, np.uint8))
    find_peaks(light.search, light.step, light.channel, light.minus, tile_bands(bands), settings.exclusion_px, *peaks)
    return peaks


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
    light: Light, settings: ExtractionSettings, noise: NoiseModel, peaks: _Peaks, width: UsualWidth | None,
    profile: StripeProfile, laser: int,
) -> None:  # fmt: skip
    peak, runner_up = peaks.row[laser], peaks.runner_up[laser]
    columns = np.flatnonzero(peak >= 0).astype(np.int32)
    if not len(columns):
        return
    fit = fit_at(light, settings, noise, columns, peak[columns], width)
    usual = width.px if width else median(fit[tabulated.WIDTH], 1.0)
    found = significant(fit, noise.read_dn, settings.detection_snr, usual)
    swapped = np.zeros(len(columns), bool)
    if not found.all() and len(again := np.flatnonzero(~found & (runner_up[columns] >= 0))):
        second = fit_at(light, settings, noise, columns[again], runner_up[columns[again]], width)
        better = significant(second, noise.read_dn, settings.detection_snr, usual)
        fit[:, again[better]] = second[:, better]
        swapped[again[better]] = True
        found[again[better]] = True
    enter_stripes(fit, found, swapped, columns, light.flat, light.step, light.channel, settings.saturation_dn,
                  noise.read_dn, settings.detection_snr, usual, runner_up, peaks.runner_up_value[laser],
                  profile.rows(laser), profile.flags[laser])  # fmt: skip


def fit_at(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray,
    usual: UsualWidth | None = None,
) -> FloatArray:  # fmt: skip
    """Fit a stripe near the given pixel of each column with the chosen method.

    Returns
    -------
    (RESULTS, n) array
        Rows as named in `tabulated`; NaN where nothing could be fitted.
    """
    if settings.method != "maximum-likelihood":
        return fit_classical(light, settings, noise, columns, rows)
    out = np.full((tabulated.RESULTS, len(columns)), np.nan)
    width, prior, _ = usual or _settled_width(light, settings, noise, columns, rows)
    if noise.speckle > _COARSE_GRAIN[0] and width < _COARSE_GRAIN[1]:
        return _careful(light, settings, noise, columns, rows, width, prior)
    classes = range(len(WIDTH_CLASSES))
    first = _width_class(width, prior)
    outcome = _run_table(light, settings, noise, columns, rows, first, width, prior, out)
    if (outcome == tabulated.DONE).all():
        return out
    todo: IntArray = np.flatnonzero(outcome == tabulated.TOO_WIDE)
    narrow: list[IntArray] = [np.flatnonzero(outcome == tabulated.TOO_NARROW)]
    careful: list[IntArray] = [np.flatnonzero(outcome == tabulated.NEEDS_CARE)]
    for index in classes[first + 1 :]:
        if not len(todo):
            break
        outcome = _tabulated(light, settings, noise, columns, rows, todo, index, width, prior, out)
        careful.append(todo[outcome == tabulated.NEEDS_CARE])
        todo = todo[outcome == tabulated.TOO_WIDE]
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
) -> UsualWidth:
    """Median width of a sample of columns, each fitted with its width free, and the relative spread beyond noise.

    For a Gaussian profile the width is known as well as the centre (both have the information
    ``A^2 sqrt(pi) / (2 w n^2)``), so the centre's reported deviation serves for both.
    """
    width = usual_width(light, columns, rows)
    index = _width_class(width, _WIDTH_SPREAD[1])
    sample = sample_places(len(columns))
    out = np.full((tabulated.RESULTS, len(sample)), np.nan)
    outcome = _run_table(light, settings, noise, columns[sample], rows[sample], index, width, 0.0, out)
    middle, spread = settle_width(out, outcome, noise.read_dn, settings.detection_snr, _WIDTH_SPREAD)
    seen = bool(np.isfinite(middle))
    return UsualWidth(middle if seen else width, spread, seen)


def _width_class(width: float, spread: float) -> int:
    """The narrowest class of tables that holds nearly all widths of such a spread."""
    widest = width * min(1.0 + 2.0 * spread, _MARGIN)
    fitting = (i for i, c in enumerate(WIDTH_CLASSES) if widest <= c.widest * c.binning)
    return next(fitting, len(WIDTH_CLASSES) - 1)


def _tabulated(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray, todo: IntArray,
    index: int, width: float, prior: float, out: FloatArray,
) -> ByteArray:  # fmt: skip
    """Fit the columns ``todo`` with one width class, writing into ``out``; returns their outcomes."""
    part = np.full((tabulated.RESULTS, len(todo)), np.nan)
    outcome = _run_table(light, settings, noise, columns[todo], rows[todo], index, width, prior, part)
    out[:, todo] = part
    return outcome


def _run_table(
    light: Light, settings: ExtractionSettings, noise: NoiseModel, columns: IntArray, rows: IntArray, index: int,
    width: float, prior: float, out: FloatArray,
) -> ByteArray:  # fmt: skip
    """Fit columns with one width class, writing into ``out`` where that succeeds; returns their outcomes."""
    outcome = np.zeros(len(columns), np.uint8)
    if not len(columns):
        return outcome
    width_class = WIDTH_CLASSES[index]
    table = filter_table(width_class, noise)
    fit = tabulated.fit_32 if width_class.taps == 32 else tabulated.fit_64
    fit(light.flat, light.off, light.has_off, light.step, light.channel, light.minus, settings.saturation_dn,
        columns, rows.copy(), width, prior, width_class.binning, table.filters, table.sums,
        table.sd, table.sd_amplitude, table.sd_width, width_class.narrowest, width_class.widest, LOWEST_AMPLITUDE_DN,
        out, outcome)  # fmt: skip
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


__all__ = ["extract", "extract_light", "fit_at", "read_noise", "tile_bands", "usual_width"]
