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


def make_fit(taps: int):  # type: ignore[no-untyped-def]
    """Compile the fit for windows of a fixed number of taps; a constant length lets the compiler unroll it."""

    @njit(cache=True, error_model="numpy", fastmath=_FAST)
    def fit(
        flat: ByteArray, off: ByteArray, has_off: bool, step: int, channel: int, minus: int, saturation: int,
        columns: IntArray, rows: IntArray, usual_width: float, prior: float, binning: int, filters: FloatArray,
        sds: FloatArray, sds_amplitude: FloatArray, sds_width: FloatArray, weights: FloatArray, narrowest: float,
        widest: float, lowest_amplitude: float, slope_scale: float, out: FloatArray, outcome: ByteArray,
    ) -> None:  # fmt: skip
        one, half, quarter = np.float32(1.0), np.float32(0.5), np.float32(0.25)
        one_place, two, three, four = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
        five, six, seven, eight = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8)
        amplitudes, phases, widths = filters.shape[0], filters.shape[1], filters.shape[2]
        width_step = np.float32((widest - narrowest) / (widths - 1))
        low, high = np.float32(narrowest), np.float32(widest)
        # Flat buffers and unsigned places: views of rows would be counted, and signed places tested, in every column.
        height, pitch = flat.shape
        pixels, unlit = flat.reshape(flat.size), off.reshape(off.size)
        table, inverse_variances = filters.reshape(filters.size), weights.reshape(weights.size)
        window, raw = np.zeros(GATHER_COLUMNS * taps, np.float32), np.zeros(GATHER_COLUMNS * taps, np.uint8)
        beside, care = np.zeros(GATHER_COLUMNS * taps, np.uint8), np.empty(GATHER_COLUMNS, np.uint8)
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
            for j in range(first, last):
                if care[j - first] != 0:
                    outcome[j] = NEEDS_CARE
                    continue
                line = np.uint64((j - first) * taps)
                mu = np.float32(0.0)
                s = usual
                a = window[line + row // two - one_place] - half * (window[line] + window[line + row - one_place])
                ia = ip = iw = 0
                dm = ds = np.float32(0.0)
                steps = 10 if amplitudes > 1 else 6
                near = amplitudes == 1
                anchor, spread, moved = mu, s, 0
                converged = False
                for step_number in range(steps):
                    ip = min(max(int((mu + half) * np.float32(phases)), 0), phases - 1)
                    iw = min(max(int((s - low) / width_step + half), 0), widths - 1)
                    if amplitudes > 1 and near:
                        ia = 1
                        level = np.float32(lowest_amplitude) * np.float32(1.41421356)
                        while ia < amplitudes - 1 and a > level:
                            ia += 1
                            level *= np.float32(2.0)
                    f = np.uint64(((ia * phases + ip) * widths + iw) * 8 * taps)
                    a = np.float32(0.0)
                    p = np.float32(0.0)
                    q = np.float32(0.0)
                    for k in range(taps):
                        at = f + np.uint64(k)
                        y = window[line + np.uint64(k)]
                        a += table[at] * y
                        p += table[at + row] * y
                        q += table[at + two * row] * y
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
                    # A grain of speckle can pass for a very narrow stripe: few data leave the width near the usual one.
                    sd_s = sds_width[ia, ip, iw] / a
                    s = (node + ds + usual * prior_weight * sd_s * sd_s) / (one + prior_weight * sd_s * sd_s)
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
                node_place = np.uint64((ia * phases + ip) * widths + iw)
                f = node_place * eight * row
                b = np.float32(0.0)
                g = np.float32(0.0)
                used = np.float32(0.0)
                for k in range(taps):
                    at = f + np.uint64(k)
                    y = window[line + np.uint64(k)]
                    b += table[at + three * row] * y
                    g += table[at + four * row] * y
                    w = inverse_variances[node_place * row + np.uint64(k)]
                    used += one if w > np.float32(0.0) else np.float32(0.0)
                p, q, g = dm * a, ds * a, g * np.float32(slope_scale)
                misfit = np.float32(0.0)
                for k in range(taps):
                    at = f + np.uint64(k)
                    y = window[line + np.uint64(k)]
                    w = inverse_variances[node_place * row + np.uint64(k)]
                    model = a * table[at + five * row] + p * table[at + six * row] + q * table[at + seven * row]
                    r = y - (b + g * np.float32(k - (taps // 2 - 1)) + model)
                    misfit += r * r * w
                # Between amplitude nodes the standard deviation follows a power law.
                sd, sd_a = sds[ia, ip, iw], sds_amplitude[ia, ip, iw]
                if amplitudes > 1:
                    place = np.log2(max(a, one) / np.float32(lowest_amplitude)) - np.float32(ia - 1)
                    other = min(max(ia + (1 if place > 0 else -1), 1), amplitudes - 1)
                    if other != ia:
                        share = abs(place)
                        sd *= (sds[other, ip, iw] / sd) ** share
                        sd_a *= (sds_amplitude[other, ip, iw] / sd_a) ** share
                out[MU, j] = rows[j] - (binning - 1) // 2 + centre_of_first + mu * np.float32(binning)
                out[AMPLITUDE, j] = a
                out[WIDTH, j] = s * np.float32(binning)
                out[BACKGROUND, j] = b
                out[SD, j] = sd / a * np.float32(binning)
                out[SD_AMPLITUDE, j] = sd_a
                out[MISFIT, j] = misfit / (used - np.float32(5.0))
                outcome[j] = DONE

    return fit


fit_32 = make_fit(32)
fit_64 = make_fit(64)
