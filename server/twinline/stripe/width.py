"""How wide a stripe usually is in one picture: from the mean profile of a sample of its columns."""

from typing import NamedTuple

import numpy as np
from numba import njit

from twinline.arrays import ByteArray, IntArray
from twinline.stripe.light import Light

SAMPLED_COLUMNS = 96
_REACH = 48
_LEAST, _MOST = 0.7, 20.0
_UNKNOWN = 2.0
_FWHM = 2.355
"""Full width of a Gaussian at half its height, in standard deviations."""


class UsualWidth(NamedTuple):
    """Width of a stripe: its standard deviation in pixels, how much that varies, relative; whether one was seen."""

    px: float
    spread: float
    seen: bool


@njit(cache=True, error_model="numpy")
def sample_places(count: int) -> IntArray:
    """Places of evenly spaced columns among ``count``, at most `SAMPLED_COLUMNS`; ascending."""
    number = min(SAMPLED_COLUMNS, count)
    places = np.empty(number, np.int64)
    step = (count - 1) / (number - 1) if number > 1 else 0.0
    for i in range(number):
        places[i] = int(i * step)
    places[number - 1] = count - 1
    return places


def usual_width(light: Light, columns: IntArray, rows: IntArray) -> float:
    """Width (standard deviation, pixels) of the stripe, from the mean profile of a sample of columns.

    Parameters
    ----------
    columns, rows : (n,) int arrays
        The stripe's coarse peaks, at least one.
    """
    return float(
        _usual_width(light.flat, light.off, light.has_off, light.step, light.channel, light.minus, columns, rows)
    )


@njit(cache=True, error_model="numpy")
def _usual_width(
    flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, columns: IntArray,
    rows: IntArray,
) -> float:  # fmt: skip
    around = _surroundings(flat, off, has_off, step, channel, minus, columns, rows)
    signed = minus >= 0 or has_off
    return _profile_width(around, -510 if signed else 0, 510 if signed else 255)


@njit(cache=True, error_model="numpy")
def _surroundings(
    flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, columns: IntArray,
    rows: IntArray,
) -> IntArray:  # fmt: skip
    """Measured light around the peaks of a sample of columns, (2 reach + 1, sample); the border is repeated."""
    places = sample_places(columns.size)
    height, pitch = flat.shape
    pixels, unlit = flat.reshape(flat.size), off.reshape(off.size)
    around = np.empty((2 * _REACH + 1, places.size), np.int16)
    for i in range(places.size):
        at = columns[places[i]] * step + channel
        under = np.uint64(channel - minus if minus >= 0 else 0)
        for k in range(2 * _REACH + 1):
            row = min(max(rows[places[i]] + k - _REACH, 0), height - 1)
            place = np.uint64(row * pitch + at)
            light = np.int16(pixels[place])
            if minus >= 0:
                light -= np.int16(pixels[place - under])
            if has_off:
                light -= np.int16(unlit[place])
                if minus >= 0:
                    light += np.int16(unlit[place - under])
            around[k, i] = light
    return around


@njit(cache=True, error_model="numpy")
def _medians(values: IntArray, least: int, most: int) -> IntArray:
    """Median of each column of whole numbers, of an odd number of rows, between bounds: by halving, all at once."""
    rows, n = values.shape
    low, high = np.full(n, least, np.int16), np.full(n, most, np.int16)
    middle, below = np.empty(n, np.int16), np.empty(n, np.int16)
    width = most - least + 1
    while width > 1:
        for i in range(n):
            middle[i] = np.int16((low[i] + high[i]) >> 1)
            below[i] = np.int16(0)
        for k in range(rows):
            line = values[k]
            for i in range(n):
                below[i] += np.int16(line[i] <= middle[i])
        for i in range(n):
            enough = below[i] > np.int16(rows // 2)
            high[i] = middle[i] if enough else high[i]
            low[i] = low[i] if enough else np.int16(middle[i] + 1)
        width = (width + 1) // 2
    return low


@njit(cache=True, error_model="numpy")
def _profile_width(around: IntArray, least: int, most: int) -> float:
    """Half-height width of the mean over the columns that are bright enough, over a line through its outer parts."""
    taps, n = around.shape
    median = _medians(around, least, most)
    height = np.empty(n, np.int16)
    for i in range(n):
        height[i] = around[_REACH, i] - median[i]
    highest = height.max()
    if highest <= 0:
        return _UNKNOWN
    # Counted in whole numbers: exact, and without a branch per pixel.
    bright, count = np.empty(n, np.int32), 0
    for i in range(n):
        bright[i] = height[i] > 0.3 * highest
        count += bright[i]
    mean = np.empty(taps)
    for k in range(taps):
        line, total = around[k], np.int32(0)
        for i in range(n):
            total = np.int32(total + np.int32(np.int32(line[i]) * bright[i]))
        mean[k] = total / count
    # The brightest pixel was chosen for being bright: under speckle it tells nothing of the profile's height.
    top = max(mean[_REACH - 1], mean[_REACH + 1])
    quarter = _REACH // 2
    left_level, right_level = mean[:quarter].mean(), mean[taps - quarter :].mean()
    rise = (right_level - left_level) / (taps - quarter)
    level = 0.5 * (left_level + right_level)
    half = 0.5 * (top - level)
    right = left = 0
    while _REACH + 1 + right < taps and mean[_REACH + 1 + right] - (level + rise * (right + 1)) > half:
        right += 1
    while left < _REACH and mean[_REACH - 1 - left] - (level - rise * (left + 1)) > half:
        left += 1
    return min(max((left + right + 1) / _FWHM, _LEAST), _MOST)
