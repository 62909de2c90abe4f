"""Coarse peaks: the pixel of every column that stands out most in its search band, and the runner-up.

The image is read row by row, so that the inner loop runs over contiguous memory and the compiler can vectorise it;
going down the columns instead is some thirty times slower. Maxima are kept per block of rows, and the runner-up falls
out of them for free.
"""

import numpy as np
from numba import njit

from twinline.arrays import ByteArray, IntArray

BLOCK_ROWS = 8
TILE_COLUMNS = 128
_REACH_BLOCKS = 3
"""A block is judged against those so far above and below it: further than a stripe is wide."""


@njit(cache=True, error_model="numpy")
def _usual_rise(maxima: ByteArray, blocks: int, n: int) -> int:
    """Median rise of the grey level over `_REACH_BLOCKS` blocks down the picture, in a sample of a tile's columns."""
    d = _REACH_BLOCKS
    if blocks <= d:
        return 0
    rises = np.empty(((blocks - d) // 2 + 1) * (n // 32 + 1), np.int16)
    count = 0
    for b in range(0, blocks - d, 2):
        for i in range(0, n, 32):
            rises[count] = np.int16(maxima[b + d, i]) - np.int16(maxima[b, i])
            count += 1
    return int(np.median(rises[:count]))


@njit(cache=True, error_model="numpy")
def _prominence(maxima: ByteArray, blocks: int, b: int, n: int, rise: int, out: IntArray) -> None:
    """Twice the height of block b's maxima over the line through their neighbours'.

    The brightest pixel of a column may belong to a bright surface or to the bright end of an ambient gradient; a
    stripe is what stands out from both sides. Blocks with a neighbour on one side only take the other's level from
    the usual rise.
    """
    d = _REACH_BLOCKS
    top = maxima[b]
    if d <= b < blocks - d:
        above, below = maxima[b - d], maxima[b + d]
        for i in range(n):
            out[i] = np.int16(2) * np.int16(top[i]) - np.int16(above[i]) - np.int16(below[i])
    elif blocks <= d:
        for i in range(n):
            out[i] = np.int16(2) * np.int16(top[i])
    else:
        near, level = (maxima[b + d], np.int16(-rise)) if b + d < blocks else (maxima[b - d], np.int16(rise))
        for i in range(n):
            out[i] = np.int16(2) * (np.int16(top[i]) - np.int16(near[i]) - level)


@njit(cache=True, error_model="numpy")
def _block_maxima(
    flat: ByteArray, first: int, last: int, low: int, high: int, shift: int, maxima: ByteArray, rows: ByteArray
) -> int:
    """Fill maxima and their rows within each block for flat columns first..last, image rows low..high."""
    n = last - first
    blocks = 0
    for r0 in range(low, high, BLOCK_ROWS):
        r1 = min(r0 + BLOCK_ROWS, high)
        top, at = maxima[blocks], rows[blocks]
        for i in range(n):
            top[i] = np.uint8(0)
            at[i] = np.uint8(0)
        for r in range(r0, r1):
            line = flat[r]
            k = np.uint8(r - r0)
            if shift == 0:
                for i in range(n):
                    v = line[first + i]
                    higher = v > top[i]
                    top[i] = v if higher else top[i]
                    at[i] = k if higher else at[i]
            else:
                for i in range(n):
                    a, b = line[first + i + shift], line[first + i]
                    v = np.uint8(a - b) if a > b else np.uint8(0)
                    higher = v > top[i]
                    top[i] = v if higher else top[i]
                    at[i] = k if higher else at[i]
        blocks += 1
    return blocks


@njit(cache=True, error_model="numpy")
def find_peaks(
    flat: ByteArray,
    step: int,
    channel: int,
    minus: int,
    bands: IntArray,
    exclusion: int,
    peak: IntArray,
    runner_up: IntArray,
    runner_up_value: ByteArray,
) -> None:
    """Most and next most prominent pixel of each column, per laser.

    Parameters
    ----------
    flat : (rows, columns * step) uint8 array
        The picture with its channels side by side.
    step, channel, minus
        Channels per pixel, the channel to search, and the channel to subtract (-1: none).
    bands : (lasers, tiles, 2) int32 array
        Rows [low, high) to search, for every tile of `TILE_COLUMNS` columns.
    exclusion
        Blocks within so many rows of the peak cannot hold the runner-up.
    peak, runner_up : (lasers, columns) int32 arrays
        Results; -1 where the band is empty.
    runner_up_value : (lasers, columns) uint8 array
        Grey level of the runner-up.
    """
    columns = peak.shape[1]
    width = TILE_COLUMNS * step
    blocks_most = flat.shape[0] // BLOCK_ROWS + 1
    maxima = np.empty((blocks_most, width), np.uint8)
    rows = np.empty((blocks_most, width), np.uint8)
    best = np.empty(width, np.int16)
    height = np.empty(width, np.int16)
    best_block = np.empty(width, np.int16)
    low_block = np.empty(width, np.int16)
    high_block = np.empty(width, np.int16)
    # A difference of channels is formed between neighbouring bytes of one line.
    shift = channel - minus if minus >= 0 else 0
    offset = minus if minus >= 0 else channel
    for laser in range(bands.shape[0]):
        for tile in range(bands.shape[1]):
            c0 = tile * TILE_COLUMNS
            c1 = min(c0 + TILE_COLUMNS, columns)
            low, high = bands[laser, tile, 0], bands[laser, tile, 1]
            if high <= low:
                for c in range(c0, c1):
                    peak[laser, c] = -1
                    runner_up[laser, c] = -1
                    runner_up_value[laser, c] = 0
                continue
            first = c0 * step + offset
            n = (c1 - c0 - 1) * step + 1
            blocks = _block_maxima(flat, first, first + n, low, high, shift, maxima, rows)
            rise = _usual_rise(maxima, blocks, n)
            for i in range(n):
                best[i] = np.int16(-32768)
                best_block[i] = np.int16(0)
            for b in range(blocks):
                k = np.int16(b)
                _prominence(maxima, blocks, b, n, rise, height)
                for i in range(n):
                    higher = height[i] > best[i]
                    best[i] = height[i] if higher else best[i]
                    best_block[i] = k if higher else best_block[i]
            for c in range(c0, c1):
                i = (c - c0) * step
                row = best_block[i] * BLOCK_ROWS + rows[best_block[i], i]
                peak[laser, c] = low + row
                low_block[i] = np.int16(max(row - exclusion, 0) // BLOCK_ROWS)
                high_block[i] = np.int16((row + exclusion) // BLOCK_ROWS)
            for i in range(n):
                best[i] = np.int16(-32768)
                best_block[i] = np.int16(-1)
            for b in range(blocks):
                k = np.int16(b)
                _prominence(maxima, blocks, b, n, rise, height)
                for i in range(n):
                    higher = (height[i] > best[i]) & ((k < low_block[i]) | (k > high_block[i]))
                    best[i] = height[i] if higher else best[i]
                    best_block[i] = k if higher else best_block[i]
            for c in range(c0, c1):
                i = (c - c0) * step
                runner_up[laser, c] = -1
                runner_up_value[laser, c] = 0
                if best_block[i] >= 0:
                    runner_up[laser, c] = low + best_block[i] * BLOCK_ROWS + rows[best_block[i], i]
                    runner_up_value[laser, c] = maxima[best_block[i], i]
