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

_FEWEST_BLOCKS = 10
"""In a shorter band the stripe itself is in every second sample of the rise, and would pass for a gradient."""


@njit(cache=True, error_model="numpy")
def tile_bands(bands: IntArray) -> IntArray:
    """Bands per tile of columns, (lasers, tiles, 2): the hull of the columns' bands, split where two lasers overlap."""
    lasers, columns = bands.shape[0], bands.shape[1]
    tiles = np.empty((lasers, (columns + TILE_COLUMNS - 1) // TILE_COLUMNS, 2), np.int32)
    tops = np.zeros(lasers, np.int64)
    for laser in range(lasers):
        for tile in range(tiles.shape[1]):
            low, high = bands[laser, tile * TILE_COLUMNS, 0], bands[laser, tile * TILE_COLUMNS, 1]
            for c in range(tile * TILE_COLUMNS, min((tile + 1) * TILE_COLUMNS, columns)):
                low, high = min(low, bands[laser, c, 0]), max(high, bands[laser, c, 1])
                tops[laser] += bands[laser, c, 0]
            tiles[laser, tile, 0], tiles[laser, tile, 1] = low, high
    if lasers == 2:
        upper, lower = (0, 1) if tops[0] < tops[1] else (1, 0)
        for tile in range(tiles.shape[1]):
            if tiles[upper, tile, 1] > tiles[lower, tile, 0]:
                middle = (tiles[upper, tile, 1] + tiles[lower, tile, 0]) // 2
                tiles[upper, tile, 1] = middle
                tiles[lower, tile, 0] = middle
    return tiles


@njit(cache=True, error_model="numpy")
def _usual_rise(maxima: ByteArray, blocks: int, n: int, step: int) -> int:
    """Median rise of the grey level over some blocks down the picture, in a sample of a tile's columns."""
    d = _REACH_BLOCKS
    if blocks < _FEWEST_BLOCKS:
        return 0
    rises = np.empty(((blocks - d) // 2 + 1) * (n // 32 + 1), np.int16)
    count = 0
    for b in range(0, blocks - d, 2):
        for i in range(0, n, 32 * step):
            rises[count] = np.int16(maxima[(b + d) * n + i]) - np.int16(maxima[b * n + i])
            count += 1
    upper = _ranked(rises, count, count // 2)
    lower = _ranked(rises, count, count // 2 - 1) if count % 2 == 0 else upper
    return int(0.5 * (lower + upper))


@njit(cache=True, error_model="numpy")
def _ranked(values: IntArray, count: int, rank: int) -> int:
    """The one of ``count`` differences of grey levels that has ``rank`` others before it in ascending order."""
    low, high = -255, 255
    while low < high:
        middle = (low + high) >> 1
        upto = np.int16(0)
        for i in range(count):
            upto += np.int16(values[i] <= np.int16(middle))
        if upto > rank:
            high = middle
        else:
            low = middle + 1
    return low


@njit(cache=True, error_model="numpy")
def _prominence(maxima: ByteArray, blocks: int, n: int, rise: int, heights: IntArray) -> None:
    """Twice the height of each block's maxima over the line through its neighbours'.

    The brightest pixel of a column may belong to a bright surface or to the bright end of an ambient gradient; a
    stripe is what stands out from both sides. Blocks with a neighbour on one side only take the other's level from
    the usual rise.
    """
    d = min(_REACH_BLOCKS, blocks // 2)
    away = np.uint64(d * n)
    for b in range(blocks):
        start = np.uint64(b * n)
        if blocks <= _REACH_BLOCKS:
            for i in range(n):
                at = start + np.uint64(i)
                heights[at] = np.int16(2) * np.int16(maxima[at])
        elif d <= b < blocks - d:
            for i in range(n):
                at = start + np.uint64(i)
                double = np.int16(np.int16(2) * np.int16(maxima[at]))
                heights[at] = np.int16(double - np.int16(maxima[at - away])) - np.int16(maxima[at + away])
        else:
            near, level = (start + away, np.int16(-rise)) if b + d < blocks else (start - away, np.int16(rise))
            for i in range(n):
                at = start + np.uint64(i)
                above = np.int16(np.int16(maxima[at]) - np.int16(maxima[near + np.uint64(i)]))
                heights[at] = np.int16(2) * np.int16(above - level)


@njit(cache=True, error_model="numpy")
def _block_maxima(
    pixels: ByteArray, pitch: int, first: int, n: int, low: int, high: int, shift: int, maxima: ByteArray,
    rows: ByteArray,
) -> int:  # fmt: skip
    """Fill maxima and their rows within each block for n bytes from place ``first`` of the image rows low..high."""
    blocks = 0
    down, ahead = np.uint64(pitch), np.uint64(shift)
    for r0 in range(low, high, BLOCK_ROWS):
        source, target = np.uint64(r0 * pitch + first), np.uint64(blocks * n)
        blocks += 1
        if r0 + BLOCK_ROWS > high:
            _short_block(pixels, source, down, ahead, high - r0, n, target, maxima, rows)
        elif shift == 0:
            for i in range(n):
                place = source + np.uint64(i)
                highest, row = pixels[place], np.uint8(0)
                for k in range(1, BLOCK_ROWS):
                    place += down
                    v = pixels[place]
                    higher = v > highest
                    highest = v if higher else highest
                    row = np.uint8(k) if higher else row
                maxima[target + np.uint64(i)] = highest
                rows[target + np.uint64(i)] = row
        else:
            for i in range(n):
                place = source + np.uint64(i)
                highest, row = _excess(pixels[place + ahead], pixels[place]), np.uint8(0)
                for k in range(1, BLOCK_ROWS):
                    place += down
                    v = _excess(pixels[place + ahead], pixels[place])
                    higher = v > highest
                    highest = v if higher else highest
                    row = np.uint8(k) if higher else row
                maxima[target + np.uint64(i)] = highest
                rows[target + np.uint64(i)] = row
    return blocks


@njit(cache=True, error_model="numpy", inline="always")
def _excess(a: np.uint8, b: np.uint8) -> np.uint8:
    """What of a goes beyond b, at least 0."""
    return np.uint8(a - b) if a > b else np.uint8(0)


@njit(cache=True, error_model="numpy")
def _short_block(
    pixels: ByteArray, source: np.uint64, down: np.uint64, ahead: np.uint64, count: int, n: int, target: np.uint64,
    maxima: ByteArray, rows: ByteArray,
) -> None:  # fmt: skip
    """The last block of a band, of fewer rows."""
    for i in range(n):
        place = source + np.uint64(i)
        highest, row = np.uint8(0), np.uint8(0)
        for k in range(count):
            v = _excess(pixels[place + ahead], pixels[place]) if ahead > 0 else pixels[place]
            if v > highest:
                highest, row = v, np.uint8(k)
            place += down
        maxima[target + np.uint64(i)] = highest
        rows[target + np.uint64(i)] = row


@njit(cache=True, error_model="numpy")
def _choose(heights: IntArray, blocks: int, n: int, best: IntArray, best_block: IntArray) -> None:
    """Block of greatest height for each of n bytes."""
    for i in range(n):
        best[i] = np.int16(-32768)
        best_block[i] = np.int16(0)
    for b in range(blocks):
        k, start = np.int16(b), np.uint64(b * n)
        for i in range(n):
            height = heights[start + np.uint64(i)]
            higher = height > best[i]
            best[i] = height if higher else best[i]
            best_block[i] = k if higher else best_block[i]


@njit(cache=True, error_model="numpy")
def _choose_outside(
    heights: IntArray, blocks: int, n: int, low_block: IntArray, high_block: IntArray, best: IntArray,
    best_block: IntArray,
) -> None:  # fmt: skip
    """The same outside the blocks low..high of each byte; -1 where none is left."""
    for i in range(n):
        best[i] = np.int16(-32768)
        best_block[i] = np.int16(-1)
    for b in range(blocks):
        k, start = np.int16(b), np.uint64(b * n)
        for i in range(n):
            height = heights[start + np.uint64(i)]
            higher = (height > best[i]) & ((k < low_block[i]) | (k > high_block[i]))
            best[i] = height if higher else best[i]
            best_block[i] = k if higher else best_block[i]


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
    # Flat buffers, with unsigned places: every access by a signed one would first be tested for counting from the
    # end, and no loop could be vectorised.
    pixels = flat.reshape(flat.size)
    maxima, rows = np.empty(blocks_most * width, np.uint8), np.empty(blocks_most * width, np.uint8)
    heights = np.empty(blocks_most * width, np.int16)
    best, best_block = np.empty(width, np.int16), np.empty(width, np.int16)
    low_block, high_block = np.empty(width, np.int16), np.empty(width, np.int16)
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
            n = (c1 - c0 - 1) * step + 1
            blocks = _block_maxima(pixels, flat.shape[1], c0 * step + offset, n, low, high, shift, maxima, rows)
            _prominence(maxima, blocks, n, _usual_rise(maxima, blocks, n, step), heights)
            _choose(heights, blocks, n, best, best_block)
            for i in range(n):
                low_block[i], high_block[i] = np.int16(0), np.int16(blocks)
            for c in range(c0, c1):
                i = (c - c0) * step
                row = best_block[i] * BLOCK_ROWS + rows[best_block[i] * n + i]
                peak[laser, c] = low + row
                low_block[i] = np.int16(max(row - exclusion, 0) // BLOCK_ROWS)
                high_block[i] = np.int16((row + exclusion) // BLOCK_ROWS)
            _choose_outside(heights, blocks, n, low_block, high_block, best, best_block)
            for c in range(c0, c1):
                i = (c - c0) * step
                runner_up[laser, c] = -1
                runner_up_value[laser, c] = 0
                if best_block[i] >= 0:
                    runner_up[laser, c] = low + best_block[i] * BLOCK_ROWS + rows[best_block[i] * n + i]
                    runner_up_value[laser, c] = maxima[best_block[i] * n + i]
