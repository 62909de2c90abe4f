"""Sub-pixel centres by tabulated maximum likelihood: the fast path for whole, unsaturated profiles."""

import numpy as np
from numba import njit

from twinline.arrays import ByteArray, FloatArray, IntArray

_FAST = {"reassoc", "contract", "nsz", "arcp"}
GATHER_COLUMNS = 64

DONE, TOO_WIDE, TOO_NARROW, NEEDS_CARE, NOTHING = range(5)
"""Outcome of a column: fitted; belongs to the next or previous width class; needs the careful fit; no stripe."""

MU, AMPLITUDE, WIDTH, BACKGROUND, SD, SD_AMPLITUDE, MISFIT = range(7)
"""Rows of the result array."""
RESULTS = 7

FITTED = 255
"""Of a column in a block: no more to do."""


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _gather(
    pixels: ByteArray, unlit: ByteArray, has_off: bool, height: int, pitch: int, step: int, channel: int, minus: int,
    columns: IntArray, rows: IntArray, first: int, last: int, taps: int, binning: int, saturation: int,
    raw: ByteArray, beside: ByteArray, window: FloatArray, care: ByteArray,
) -> None:  # fmt: skip
    """Copy each column's window, averaged to taps; note columns that are saturated or cut by the border."""
    before = (taps // 2 - 1) * binning + (binning - 1) // 2
    down = np.uint64(pitch)
    plain = binning == 1 and minus < 0 and not has_off
    for j in range(first, last):
        top = rows[j] - before
        care[j - first] = np.uint8(top < 0 or top + taps * binning > height)
        if care[j - first] != 0:
            continue
        place = np.uint64(top) * down + np.uint64(columns[j] * step + channel)
        line = np.uint64((j - first) * taps)
        if plain:
            for k in range(taps):
                raw[line + np.uint64(k)] = pixels[place]
                place += down
            continue
        under = place - np.uint64(channel - minus) if minus >= 0 else place
        brightest = np.uint8(0)
        if binning == 1 and not has_off:
            for k in range(taps):
                raw[line + np.uint64(k)] = pixels[place]
                beside[line + np.uint64(k)] = pixels[under]
                place += down
                under += down
            continue
        for k in range(taps):
            total = np.int64(0)
            for _ in range(binning):
                value = pixels[place]
                brightest = max(brightest, value)
                total += np.int64(value)
                if has_off:
                    total -= np.int64(unlit[place])
                if minus >= 0:
                    total -= np.int64(pixels[under])
                    if has_off:
                        total += np.int64(unlit[under])
                place += down
                under += down
            window[line + np.uint64(k)] = np.float32(total) / np.float32(binning)
        care[j - first] = np.uint8(brightest >= saturation)
    if binning > 1 or has_off:
        return
    # Bytes first, numbers afterwards: the second loop is vectorised, which the first, striding, cannot be.
    for j in range(last - first):
        line = np.uint64(j * taps)
        brightest = np.uint8(0)
        for k in range(taps):
            value = raw[line + np.uint64(k)]
            brightest = max(brightest, value)
            other = np.int32(0) if plain else np.int32(beside[line + np.uint64(k)])
            window[line + np.uint64(k)] = np.float32(np.int32(value) - other)
        care[j] |= np.uint8(brightest >= saturation)


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _look_up(
    table: FloatArray, filters: np.uint64, window: FloatArray, line: np.uint64, taps: int
) -> tuple[np.float32, np.float32, np.float32]:
    """A, A dmu and A ds of a window by the filters that start at a place of the table."""
    row = np.uint64(taps)
    a = p = q = np.float32(0.0)
    for k in range(taps):
        at = filters + np.uint64(k)
        y = window[line + np.uint64(k)]
        a += table[at] * y
        p += table[at + row] * y
        q += table[at + row + row] * y
    return a, p, q


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _remainder(
    table: FloatArray, sums: FloatArray, place: np.uint64, window: FloatArray, line: np.uint64, taps: int,
    a: np.float32, p: np.float32, q: np.float32, kept_p: np.float32, kept_q: np.float32,
) -> tuple[np.float32, np.float32]:  # fmt: skip
    """Background of a window, and the mean weighted square that its model leaves.

    For the least squares solution ``t`` of a linear model the sum of squares is ``y W y - t N t`` with the normal
    equations N; a deviation d of the parameters from it adds ``d N d``.

    Parameters
    ----------
    a, p, q
        The solution's A, A dmu and A ds.
    kept_p, kept_q
        The last two as far as they were followed.
    """
    row = np.uint64(taps)
    filters, at_sums = place * np.uint64(6) * row, place * np.uint64(12)
    three = filters + row + row + row
    base = window[line]
    b = g = square = total = np.float32(0.0)
    for k in range(taps):
        at = three + np.uint64(k)
        # Over a level near the background, so that the squares keep their digits.
        y = window[line + np.uint64(k)] - base
        weighted = table[at + row + row] * y
        b += table[at] * y
        g += table[at + row] * y
        square += weighted * y
        total += weighted
    n = sums[at_sums : at_sums + np.uint64(12)]
    explained = a * (a * n[1] + np.float32(2.0) * (p * n[2] + q * n[3] + g * n[4]))
    explained += p * (p * n[5] + np.float32(2.0) * (q * n[6] + g * n[7]))
    explained += q * (q * n[8] + np.float32(2.0) * g * n[9]) + g * g * n[10]
    dp, dq = kept_p - p, kept_q - q
    added = dp * (dp * n[5] + np.float32(2.0) * dq * n[6]) + dq * dq * n[8]
    left = square - b * (np.float32(2.0) * total - b * n[0]) - explained + added
    return b + base, max(left, np.float32(0.0)) / n[11]


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _next_width(
    node: np.float32, step: np.float32, usual: np.float32, prior_weight: np.float32, sd: np.float32
) -> np.float32:
    """Width after a step from a node, drawn to the usual one: a grain of speckle can pass for a very narrow stripe."""
    pull = prior_weight * sd * sd
    return np.float32((node + step + usual * pull) / (np.float32(1.0) + pull))


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _amplitude_node(a: np.float32, lowest: np.float32, amplitudes: int) -> int:
    """The amplitude node whose noise is that of an amplitude."""
    ia, level = 1, lowest * np.float32(1.41421356)
    while ia < amplitudes - 1 and a > level:
        ia += 1
        level *= np.float32(2.0)
    return ia


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _between_amplitudes(
    values: FloatArray, ia: int, in_node: np.uint64, nodes: np.uint64, a: np.float32, lowest: np.float32,
    amplitudes: int,
) -> np.float32:  # fmt: skip
    """A standard deviation at an amplitude: between amplitude nodes it follows a power law."""
    value = np.float32(values[np.uint64(ia) * nodes + in_node])
    if amplitudes == 1:
        return value
    place = np.log2(max(a, np.float32(1.0)) / lowest) - np.float32(ia - 1)
    other = min(max(ia + (1 if place > 0 else -1), 1), amplitudes - 1)
    if other == ia:
        return value
    return np.float32(value * (values[np.uint64(other) * nodes + in_node] / value) ** abs(place))


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _usual_columns(
    table: FloatArray, shape: tuple[int, int, int], sums: FloatArray, sds: FloatArray, sds_amplitude: FloatArray,
    sds_width: FloatArray, window: FloatArray, care: ByteArray, usual: np.float32, prior_weight: np.float32,
    low: np.float32, width_step: np.float32, lowest: np.float32, binning: int, taps: int, rows: IntArray, first: int,
    last: int, kept: tuple[FloatArray, ...], places: IntArray, out: FloatArray, outcome: ByteArray,
) -> None:  # fmt: skip
    """Fit the columns that two or three look-ups settle, and mark them as fitted.

    Nearly all columns are of this kind. Taken through the same step one after another, they keep the processor busy
    while each would wait for its own last result.
    """
    one, half, quarter, close = np.float32(1.0), np.float32(0.5), np.float32(0.25), np.float32(0.06)
    amplitudes, phases, widths = shape
    step, nodes = np.uint64(6 * taps), np.uint64(phases * widths)
    n = last - first
    mu, s, amplitude, dm, ds, free_p, free_q, anchor, spread = kept
    per_width, per_phase = one / width_step, one / np.float32(phases)
    last_phase, last_width = np.float32(phases - 1), np.float32(widths - 1)
    for j in range(n):
        mu[j], s[j], outcome[first + j] = np.float32(0.0), usual, NEEDS_CARE if care[j] != 0 else NOTHING
    for turn in range(2 if amplitudes == 1 else 3):
        for j in range(n):
            if outcome[first + j] != NOTHING:
                continue
            before = s[j]
            phase = np.floor(min(max((mu[j] + half) * np.float32(phases), np.float32(0.0)), last_phase))
            width = np.floor(min(max((before - low) * per_width + half, np.float32(0.0)), last_width))
            ia = _amplitude_node(amplitude[j], lowest, amplitudes) if turn > 0 and amplitudes > 1 else 0
            place = np.uint64((ia * widths + np.int32(width)) * phases + np.int32(phase))
            a, p, q = _look_up(table, place * step, window, np.uint64(j * taps), taps)
            width = low + width * width_step
            over = one / max(a, half)
            # Far from the node the profile is no longer linear: a step longer than a width means little.
            reach = width if ia == 0 else half * width
            dm[j] = min(max(p * over, -reach), reach)
            ds[j] = min(max(q * over, -half * width), half * width)
            mu[j] = (phase + half) * per_phase - half + dm[j]
            s[j] = _next_width(width, ds[j], usual, prior_weight, sds_width[place] * over)
            amplitude[j], free_p[j], free_q[j], places[j] = a, p, q, place
            moved, widened = abs(dm[j]), abs(s[j] - before)
            if not a > half or abs(mu[j]) > half:
                outcome[first + j] = NEEDS_CARE
            elif turn == 0:
                anchor[j], spread[j] = mu[j], s[j]
                if amplitudes > 1 and not (moved < quarter * s[j] and widened < quarter * s[j]):
                    outcome[first + j] = NEEDS_CARE
            elif moved < close and widened < close + width_step:
                outcome[first + j] = DONE
    high = low + width_step * last_width
    for j in range(n):
        a, at = amplitude[j], first + j
        lost = amplitudes > 1 and abs(mu[j] - anchor[j]) > spread[j]
        if outcome[at] != DONE or lost:
            continue
        care[j] = FITTED
        if s[j] > high or s[j] < low:
            outcome[at] = TOO_WIDE if s[j] > high else TOO_NARROW
            continue
        place = places[j]
        b, misfit = _remainder(table, sums, place, window, np.uint64(j * taps), taps, a, free_p[j], free_q[j],
                               dm[j] * a, ds[j] * a)  # fmt: skip
        ia, in_node = int(place // nodes), place % nodes
        sd = _between_amplitudes(sds, ia, in_node, nodes, a, lowest, amplitudes)
        out[MU, at] = rows[at] - (binning - 1) // 2 + np.float32(0.5 * (binning - 1)) + mu[j] * np.float32(binning)
        out[AMPLITUDE, at] = a
        out[WIDTH, at] = s[j] * np.float32(binning)
        out[BACKGROUND, at] = b
        out[SD, at] = sd / a * np.float32(binning)
        out[SD_AMPLITUDE, at] = _between_amplitudes(sds_amplitude, ia, in_node, nodes, a, lowest, amplitudes)
        out[MISFIT, at] = misfit


def make_fit(taps: int):  # type: ignore[no-untyped-def]
    """Compile the fit for windows of a fixed number of taps; a constant length lets the compiler unroll it."""

    @njit(cache=True, error_model="numpy", fastmath=_FAST)
    def fit(
        flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, saturation: int,
        columns: IntArray, rows: IntArray, usual_width: float, prior: float, binning: int, filters: FloatArray,
        sums: FloatArray, sds: FloatArray, sds_amplitude: FloatArray, sds_width: FloatArray,
        narrowest: float, widest: float, lowest_amplitude: float, out: FloatArray,
        outcome: ByteArray,
    ) -> None:  # fmt: skip
        half, quarter = np.float32(0.5), np.float32(0.25)
        one_place, two = np.uint64(1), np.uint64(2)
        amplitudes, widths, phases = filters.shape[0], filters.shape[1], filters.shape[2]
        width_step = np.float32((widest - narrowest) / (widths - 1))
        low, high = np.float32(narrowest), np.float32(widest)
        # Flat buffers and unsigned places: views of rows would be counted, and signed places tested, in every column.
        height, pitch = flat.shape
        pixels, unlit = flat.reshape(flat.size), off.reshape(off.size)
        table, flat_sums = filters.reshape(filters.size), sums.reshape(sums.size)
        window, raw = np.zeros(GATHER_COLUMNS * taps, np.float32), np.zeros(GATHER_COLUMNS * taps, np.uint8)
        beside, care = np.zeros(GATHER_COLUMNS * taps, np.uint8), np.empty(GATHER_COLUMNS, np.uint8)
        flat_sds, flat_sds_amplitude = sds.reshape(sds.size), sds_amplitude.reshape(sds.size)
        flat_sds_width, lowest = sds_width.reshape(sds.size), np.float32(lowest_amplitude)
        scratch, places = np.empty((9, GATHER_COLUMNS), np.float32), np.empty(GATHER_COLUMNS, np.uint64)
        kept = (scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5], scratch[6], scratch[7],
                scratch[8])  # fmt: skip
        row = np.uint64(taps)
        before = (taps // 2 - 1) * binning + (binning - 1) // 2
        centre_of_first = np.float32(0.5 * (binning - 1))
        usual = np.float32(usual_width) / np.float32(binning)
        # Inverse variance of a stripe's width among its fellows; 0 leaves the width free.
        prior_weight = np.float32(1.0 / (prior * usual) ** 2) if prior > 0.0 else np.float32(0.0)
        for first in range(0, rows.size, GATHER_COLUMNS):
            last = min(first + GATHER_COLUMNS, rows.size)
            _gather(pixels, unlit, has_off, height, pitch, step, channel, minus, columns, rows, first, last, taps,
                    binning, saturation, raw, beside, window, care)  # fmt: skip
            _usual_columns(table, (amplitudes, phases, widths), flat_sums, flat_sds, flat_sds_amplitude, flat_sds_width,
                           window, care, usual, prior_weight, low, width_step, lowest, binning, taps, rows, first, last,
                           kept, places, out, outcome)  # fmt: skip
            for j in range(first, last):
                if care[j - first] == FITTED:
                    continue
                if care[j - first] != 0:
                    outcome[j] = NEEDS_CARE
                    continue
                line = np.uint64((j - first) * taps)
                mu = np.float32(0.0)
                s = usual
                a = window[line + row // two - one_place] - half * (window[line] + window[line + row - one_place])
                ia = ip = iw = 0
                place = np.uint64(0)
                p = q = np.float32(0.0)
                dm = ds = np.float32(0.0)
                steps = 10 if amplitudes > 1 else 6
                near = amplitudes == 1
                anchor, spread, moved = mu, s, 0
                converged = False
                for step_number in range(steps):
                    ip = min(max(int((mu + half) * np.float32(phases)), 0), phases - 1)
                    iw = min(max(int((s - low) / width_step + half), 0), widths - 1)
                    if amplitudes > 1 and near:
                        ia = _amplitude_node(a, lowest, amplitudes)
                    place = np.uint64((ia * widths + iw) * phases + ip)
                    a, p, q = _look_up(table, place * np.uint64(6 * taps), window, line, taps)
                    if not a > np.float32(0.5):
                        break
                    before_s = s
                    # Far from the node the profile is no longer linear: a step longer than a width means little.
                    node = low + np.float32(iw) * width_step
                    reach = node if ia == 0 else half * node
                    dm = min(max(p / a, -reach), reach)
                    ds = min(max(q / a, -half * node), half * node)
                    mu_node = (np.float32(ip) + half) / np.float32(phases) - half
                    mu = mu_node + dm
                    s = _next_width(node, ds, usual, prior_weight, flat_sds_width[place] / a)
                    if mu > half or mu < -half:
                        # Move the window to the pixel that holds the centre, so that a node is always near.
                        move = int(np.floor(mu + half))
                        top = rows[j] - before + move * binning
                        if top < 0 or top + taps * binning > height or abs(rows[j] - before - top) > 8 * taps:
                            care[j - first] = np.uint8(1)
                            break
                        rows[j] += move * binning
                        moved += move
                        mu -= np.float32(move)
                        here = j - first
                        _gather(pixels, unlit, has_off, height, pitch, step, channel, minus, columns, rows, j, j + 1,
                                taps, binning, saturation, raw, beside, window[here * taps : (here + 1) * taps],
                                care[here : here + 1])  # fmt: skip
                        if care[j - first] != 0:
                            break
                        continue
                    if not near:
                        anchor = mu + np.float32(moved)
                        spread = s
                        near = step_number > 3 or (abs(dm) < quarter * s and abs(s - before_s) < quarter * s)
                        continue
                    if (
                        step_number > 0
                        and abs(dm) < np.float32(0.06)
                        and abs(s - before_s) < np.float32(0.06) + width_step
                    ):
                        converged = True
                        break
                if amplitudes > 1 and (not converged or not a > half or abs(mu + np.float32(moved) - anchor) > spread):
                    care[j - first] = np.uint8(1)
                if care[j - first] != 0:
                    outcome[j] = NEEDS_CARE
                    continue
                if not a > np.float32(0.5):
                    outcome[j] = NOTHING
                    continue
                if s > high:
                    outcome[j] = TOO_WIDE
                    continue
                if s < low:
                    outcome[j] = TOO_NARROW
                    continue
                b, misfit = _remainder(table, flat_sums, place, window, line, taps, a, p, q, dm * a, ds * a)
                out[MU, j] = rows[j] - (binning - 1) // 2 + centre_of_first + mu * np.float32(binning)
                out[AMPLITUDE, j] = a
                out[WIDTH, j] = s * np.float32(binning)
                out[BACKGROUND, j] = b
                in_node, nodes = np.uint64(iw * phases + ip), np.uint64(phases * widths)
                sd = _between_amplitudes(flat_sds, ia, in_node, nodes, a, lowest, amplitudes)
                out[SD, j] = sd / a * np.float32(binning)
                sd_a = _between_amplitudes(flat_sds_amplitude, ia, in_node, nodes, a, lowest, amplitudes)
                out[SD_AMPLITUDE, j] = sd_a
                out[MISFIT, j] = misfit
                outcome[j] = DONE

    return fit


fit_32 = make_fit(32)
fit_64 = make_fit(64)
