"""Which way the stripes of an unknown picture run, how many there are, and where to look for each.

A calibrated rig knows all this; a picture on its own has to tell.
"""

from dataclasses import dataclass, replace

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.geometry.rig import StripeRuns
from twinline.stripe.choice import choose_light
from twinline.stripe.extraction import extract
from twinline.stripe.model import Channel, ExtractionSettings, StripeProfile

SECOND_STRIPE_SHARE = 0.2
"""A second peak counts as a second stripe when so many of the columns with a stripe show it, in one line."""

SECOND_STRIPE_HEIGHT = 0.2
_SMOOTH_PX = 3.0


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the stripes of a picture are.

    Attributes
    ----------
    bands : (lasers, columns, 2) int array
        Rows [low, high) per column; laser 1 is the stripe at larger v (along-v: larger u).
    channel
        The light in which the stripes stand out most.
    """

    runs: StripeRuns
    bands: IntArray
    channel: Channel


def find_layout(
    image: ByteArray,
    settings: ExtractionSettings,
    *,
    off: ByteArray | None = None,
    runs: StripeRuns | None = None,
    lasers: int | None = None,
) -> Layout:
    """Find out what is not given.

    Parameters
    ----------
    runs, lasers
        Given if known; else the direction in which more columns show a continuous stripe, and two lasers if a second
        peak forms a line of its own.
    """
    choices: tuple[StripeRuns, ...] = ("along-u", "along-v") if runs is None else (runs,)
    tried = {choice: _try(image, settings, off, choice) for choice in choices}
    best = max(choices, key=lambda choice: tried[choice][0])
    _, channel, profile = tried[best]
    columns = profile.centre_px.shape[1]
    rows = image.shape[0] if best == "along-u" else image.shape[1]
    if lasers == 1 or (lasers is None and not _has_second(profile)):
        bands = np.zeros((1, columns, 2), np.int32)
        bands[..., 1] = rows
        return Layout(best, bands, channel)
    return Layout(best, _split(profile, rows), channel)


def _try(
    image: ByteArray, settings: ExtractionSettings, off: ByteArray | None, runs: StripeRuns
) -> tuple[float, Channel, StripeProfile]:
    """How much a picture looks like stripes in one direction: contrast times continuity; and the stripes."""
    light = choose_light([image], None, along_v=runs == "along-v", off=off, channel=settings.channel, same_view=True)
    quick = replace(settings, method="maximum-likelihood", channel=light.channel)
    profile = extract(image, quick, runs=runs, off=off)
    return light.contrast * _continuity(profile.centre_px[0]), light.channel, profile


def _continuity(centre: FloatArray) -> float:
    """Share of columns whose stripe goes on smoothly in the next one."""
    with np.errstate(invalid="ignore"):
        return float(np.mean(np.abs(np.diff(centre)) < _SMOOTH_PX)) if len(centre) > 1 else 0.0


def _pairs(profile: StripeProfile) -> tuple[IntArray, FloatArray, FloatArray]:
    """Columns with two peaks of comparable height, and the upper and lower of the two."""
    first, second = profile.centre_px[0], profile.runner_up_px[0]
    with np.errstate(invalid="ignore"):
        both = profile.runner_up_dn[0] > SECOND_STRIPE_HEIGHT * profile.amplitude_dn[0]
    columns = np.flatnonzero(both & np.isfinite(first) & np.isfinite(second))
    return columns, np.minimum(first, second)[columns], np.maximum(first, second)[columns]


def _has_second(profile: StripeProfile) -> bool:
    columns, upper, lower = _pairs(profile)
    found = int(profile.found[0].sum())
    if len(columns) < max(SECOND_STRIPE_SHARE * found, 8):
        return False
    # Peaks of texture and glare lie anywhere; those of a stripe follow one another.
    next_to = np.diff(columns) == 1
    smooth = (np.abs(np.diff(upper)) < _SMOOTH_PX) & (np.abs(np.diff(lower)) < _SMOOTH_PX) & next_to
    return bool(smooth.sum() > 0.5 * SECOND_STRIPE_SHARE * found)


def _split(profile: StripeProfile, rows: int) -> IntArray:
    """Bands either side of a straight line midway between the two stripes; the middle of the picture without one."""
    count = profile.centre_px.shape[1]
    columns, upper, lower = _pairs(profile)
    middle = np.full(count, rows / 2.0)
    if len(columns) >= 8:
        between = 0.5 * (upper + lower)
        slope, offset = 0.0, float(np.median(between))
        for _ in range(5):
            near = np.abs(between - offset - slope * columns) < 0.25 * np.median(lower - upper)
            if near.sum() < 8:
                break
            slope, offset = (float(c) for c in np.polyfit(columns[near], between[near], 1))
        middle = offset + slope * np.arange(count)
    cut = np.clip(np.rint(middle), 1, rows - 1).astype(np.int32)
    bands = np.zeros((2, count, 2), np.int32)
    bands[0, :, 0], bands[0, :, 1] = cut, rows
    bands[1, :, 1] = cut
    return bands
