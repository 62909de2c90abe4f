"""Which fits are stripes, and with what flags they enter the profile: compiled, since it runs for every frame."""

import numpy as np
from numba import njit

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.stripe.continuity import broken_columns, fragments
from twinline.stripe.model import Flag
from twinline.stripe.tabulated import AMPLITUDE, BACKGROUND, DONE, MISFIT, MU, SD, WIDTH

_NARROWEST = 0.5
"""A peak narrower than this share of the usual width is a hot pixel or noise, not a stripe. Below 0.6 px, the narrowest
table, nothing is accepted: no lens draws a finer line."""

_RUNNER_UP_SNR = 5.0
_FEW = 32
_SAMPLED_MISFITS = 256

_WEAK, _WIDE, _NARROW = int(Flag.WEAK), int(Flag.WIDE), int(Flag.NARROW)
_SECOND_PEAK, _SATURATED = int(Flag.SECOND_PEAK), int(Flag.SATURATED)
_NEAR_EDGE, _POOR_FIT = int(Flag.NEAR_EDGE), int(Flag.POOR_FIT)
_MISSING, _BROKEN = int(Flag.MISSING), int(Flag.BROKEN)


@njit(cache=True, error_model="numpy")
def _ranked(values: FloatArray, rank: int, least: float, most: float) -> float:
    """The value that has ``rank`` others before it in ascending order, of values from ``least`` to ``most``.

    Found by halving the range: counting a whole array is quicker than sorting it, whose branches cannot be foreseen.
    """
    low, high = np.nextafter(least, -np.inf), most
    before, upto = 0, values.size
    while upto - before > _FEW:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return float(high)
        count = 0
        for i in range(values.size):
            count += values[i] <= middle
        if count > rank:
            high, upto = middle, count
        else:
            low, before = middle, count
    left, n = np.empty(_FEW), 0
    for i in range(values.size):
        if low < values[i] <= high:
            left[n] = values[i]
            n += 1
    return float(np.sort(left[:n])[rank - before])


@njit(cache=True, error_model="numpy")
def median(values: FloatArray, otherwise: float) -> float:
    """Median of the finite ones of (n,) values; ``otherwise`` if there are none."""
    finite, n = np.empty(values.size), 0
    least, most = np.inf, -np.inf
    for i in range(values.size):
        value = values[i]
        if np.isfinite(value):
            finite[n] = value
            n += 1
            least = min(least, value)
            most = max(most, value)
    if n == 0:
        return otherwise
    finite = finite[:n]
    upper = _ranked(finite, n // 2, least, most)
    if n % 2 == 1:
        return upper
    below, lower = 0, -np.inf
    for i in range(n):
        if finite[i] < upper:
            below += 1
            lower = max(lower, finite[i])
    return 0.5 * ((lower if below == n // 2 else upper) + upper)


@njit(cache=True, error_model="numpy", inline="always")
def _snr(amplitude: float, width: float, read_dn: float) -> float:
    """Amplitude over its standard deviation if there were no stripe: then there would be no speckle either.

    For a Gaussian of width w on a free background that is ``0.92 n / sqrt(w)`` (Fisher information of amplitude and
    width, background from a long window).
    """
    return float(amplitude * np.sqrt(width) / (0.92 * read_dn))


@njit(cache=True, error_model="numpy")
def significant(fit: FloatArray, read_dn: float, least_snr: float, usual: float) -> BoolArray:
    """Which of the fitted columns show a stripe, (n,) bool.

    Parameters
    ----------
    fit : (RESULTS, n) array
        As `twinline.stripe.extraction.fit_at` gives it.
    usual
        Width of the stripe in this picture.
    """
    found = np.empty(fit.shape[1], np.bool_)
    for i in range(found.size):
        strong = _snr(fit[AMPLITUDE, i], fit[WIDTH, i], read_dn) > least_snr
        found[i] = strong and np.isfinite(fit[MU, i]) and fit[WIDTH, i] > _NARROWEST * usual
    return found


@njit(cache=True, error_model="numpy")
def settle_width(
    fit: FloatArray, outcome: ByteArray, read_dn: float, least_snr: float, spreads: tuple[float, float]
) -> tuple[float, float]:
    """Median width of a sample of columns, and its relative spread beyond noise within the given least and most.

    Returns
    -------
    width, spread
        The width is NaN if not even half of the sample shows a stripe.
    """
    good = significant(fit, read_dn, least_snr, 1.0)
    for i in range(good.size):
        good[i] = good[i] and outcome[i] == DONE
    if good.sum() <= good.size // 2:
        return np.nan, spreads[1]
    widths = fit[WIDTH][good]
    middle = median(widths, np.nan)
    spread = 1.4826 * median(np.abs(widths - middle), np.nan)
    explained = median(fit[SD][good], np.nan)
    own = np.sqrt(max(spread**2 - explained**2, 0.0)) / middle
    return middle, min(max(own, spreads[0]), spreads[1])


@njit(cache=True, error_model="numpy")
def enter_stripes(
    fit: FloatArray, found: BoolArray, swapped: BoolArray, columns: IntArray, light: ByteArray, step: int, channel: int,
    saturation: int, read_dn: float, least_snr: float, usual: float, runner_up: IntArray, runner_up_value: ByteArray,
    rows: tuple[FloatArray, ...], flags: IntArray,
) -> None:  # fmt: skip
    """Put the fits of one laser into its rows of the profile, with all flags.

    Parameters
    ----------
    found, swapped : (n,) bool arrays
        Columns with a stripe, and those whose stripe is the next highest peak.
    columns : (n,) int array
        What was fitted.
    light : (rows, columns * step) uint8 array
        The picture.
    runner_up, runner_up_value : (columns,) arrays
        Row and grey level of the next highest peaks.
    rows, flags : (columns,) arrays
        As `twinline.stripe.model.StripeProfile.rows` gives them, still empty; filled.
    """
    centre, sd, amplitude, width, background, runner_up_px, runner_up_dn, misfit = rows
    _enter_fits(fit, found, columns, light, step, channel, saturation, read_dn, least_snr, usual, centre, sd, amplitude,
                width, background, misfit, flags)  # fmt: skip
    drop = fragments(centre, sd, flags)
    for c in range(drop.size):
        if drop[c]:
            centre[c] = sd[c] = amplitude[c] = width[c] = background[c] = misfit[c] = np.nan
            flags[c] = np.uint16(_MISSING)
    broken = broken_columns(centre, sd)
    for c in range(broken.size):
        if broken[c]:
            flags[c] |= np.uint16(_BROKEN)
    _enter_runners_up(fit, swapped, columns, runner_up, runner_up_value, read_dn, runner_up_px, runner_up_dn, flags)


@njit(cache=True, error_model="numpy")
def _enter_fits(
    fit: FloatArray, found: BoolArray, columns: IntArray, light: ByteArray, step: int, channel: int, saturation: int,
    read_dn: float, least_snr: float, usual: float, centre: FloatArray, sd: FloatArray, amplitude: FloatArray,
    width: FloatArray, background: FloatArray, misfit: FloatArray, flags: IntArray,
) -> None:  # fmt: skip
    """Put the fits of one laser into its rows of the profile, with the flags that a column can give by itself.

    Parameters
    ----------
    light : (rows, columns * step) uint8 array
        The picture.
    centre, sd, amplitude, width, background, misfit, flags : (columns,) arrays
        To be filled where ``found``.
    """
    last = light.shape[0] - 1
    of_found, n = np.empty(found.size), 0
    every = max(found.size // _SAMPLED_MISFITS, 1)
    for i in range(0, found.size, every):
        if found[i]:
            of_found[n] = fit[MISFIT, i]
            n += 1
    # A stripe fits poorly when it does so by far compared with its fellows: the noise model may be a little off.
    poor = 4.0 * max(median(of_found[:n], 1.0), 1.0)
    narrow, wide = max(0.55, 0.7 * usual), 2.0 * usual
    for i in range(found.size):
        if not found[i]:
            continue
        c = columns[i]
        mu, w = fit[MU, i], fit[WIDTH, i]
        centre[c], sd[c], amplitude[c], width[c] = mu, fit[SD, i], fit[AMPLITUDE, i], w
        background[c], misfit[c] = fit[BACKGROUND, i], fit[MISFIT, i]
        row = min(max(int(np.rint(mu)), 0), last)
        flag = 0
        if _snr(fit[AMPLITUDE, i], w, read_dn) < 2 * least_snr:
            flag |= _WEAK
        if w > wide:
            flag |= _WIDE
        if w < narrow:
            flag |= _NARROW
        if light[row, c * step + channel] >= saturation:
            flag |= _SATURATED
        if mu < 2.0 * w or mu > last - 2.0 * w:
            flag |= _NEAR_EDGE
        if fit[MISFIT, i] > poor:
            flag |= _POOR_FIT
        flags[c] = np.uint16(flag)


@njit(cache=True, error_model="numpy")
def _enter_runners_up(
    fit: FloatArray, swapped: BoolArray, columns: IntArray, row: IntArray, value: ByteArray, read_dn: float,
    runner_up_px: FloatArray, runner_up_dn: FloatArray, flags: IntArray,
) -> None:  # fmt: skip
    """Put the next highest peaks of one laser into its rows of the profile, where they stand out of the noise.

    Parameters
    ----------
    swapped : (n,) bool array
        Columns whose stripe is the next highest peak itself.
    row, value : (columns,) arrays
        Row and grey level of the next highest peaks.
    """
    for i in range(columns.size):
        c = columns[i]
        height = value[c] - fit[BACKGROUND, i]
        if swapped[i] or not height > _RUNNER_UP_SNR * read_dn:
            continue
        runner_up_px[c], runner_up_dn[c] = row[c], height
        if height > 0.5 * fit[AMPLITUDE, i]:
            flags[c] |= np.uint16(_SECOND_PEAK)
