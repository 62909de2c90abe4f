"""Coarse peaks against the same definition written with plain numpy."""

import numpy as np
import pytest

from twinline.arrays import ByteArray, IntArray
from twinline.stripe.peaks import BLOCK_ROWS, TILE_COLUMNS, find_peaks

REACH = 3


def peaks(
    flat: ByteArray, bands: IntArray, *, step: int = 1, channel: int = 0, minus: int = -1, exclusion: int = 12
) -> tuple[IntArray, IntArray, ByteArray]:
    lasers, columns = len(bands), flat.shape[1] // step
    peak, runner_up = np.empty((lasers, columns), np.int32), np.empty((lasers, columns), np.int32)
    value = np.empty((lasers, columns), np.uint8)
    find_peaks(flat, step, channel, minus, bands, exclusion, peak, runner_up, value)
    return peak, runner_up, value


def whole(flat: ByteArray, step: int = 1) -> IntArray:
    tiles = -(-flat.shape[1] // step // TILE_COLUMNS)
    return np.tile(np.array([0, flat.shape[0]], np.int32), (1, tiles, 1))


def brute_force(column: ByteArray, rise: int, exclusion: int) -> tuple[int, int]:
    """Most and next most prominent block maximum of one column of an image whose height is any number of rows."""
    blocks = [column[r : r + BLOCK_ROWS].astype(int) for r in range(0, len(column), BLOCK_ROWS)]
    tops = [int(b.max()) for b in blocks]
    heights = []
    for b, top in enumerate(tops):
        above = tops[b - REACH] if b >= REACH else tops[b + REACH] - 2 * rise
        below = tops[b + REACH] if b + REACH < len(tops) else tops[b - REACH] + 2 * rise
        if b < REACH:
            above = 2 * (tops[b + REACH] - rise) - tops[b + REACH]
        if b + REACH >= len(tops):
            below = 2 * (tops[b - REACH] + rise) - tops[b - REACH]
        heights.append(2 * top - above - below)
    rows = [b * BLOCK_ROWS + int(np.argmax(block)) for b, block in enumerate(blocks)]
    best = int(np.argmax(heights))
    low, high = max(rows[best] - exclusion, 0) // BLOCK_ROWS, (rows[best] + exclusion) // BLOCK_ROWS
    others = [b for b in range(len(blocks)) if b < low or b > high]
    second = max(others, key=lambda b: (heights[b], -b)) if others else -1
    return rows[best], rows[second] if second >= 0 else -1


def usual_rise(image: ByteArray) -> int:
    tops = np.array([image[r : r + BLOCK_ROWS].max(axis=0) for r in range(0, len(image), BLOCK_ROWS)]).astype(int)
    return int(np.median(tops[REACH:][::2, ::32] - tops[:-REACH][::2, ::32]))


@pytest.mark.parametrize("rows", [100, 128])
@pytest.mark.parametrize("slope", [0.0, 0.8])
def test_the_peak_is_the_most_prominent_pixel_and_the_runner_up_the_next(rows: int, slope: float) -> None:
    rng = np.random.default_rng(3)
    ramp = slope * np.arange(rows)[:, None]
    image = np.clip(rng.normal(60, 20, (rows, TILE_COLUMNS)) + ramp, 0, 255).astype(np.uint8)
    peak, runner_up, value = peaks(image, whole(image))
    expected = [brute_force(image[:, c], usual_rise(image), 12) for c in range(TILE_COLUMNS)]
    assert peak[0].tolist() == [p for p, _ in expected]
    assert runner_up[0].tolist() == [r for _, r in expected]
    assert value[0].tolist() == [image[r, c] for c, (_, r) in enumerate(expected)]


def test_a_dim_stripe_beats_the_bright_end_of_a_gradient() -> None:
    image = np.repeat(np.clip(1.6 * np.arange(128) + 20, 0, 255)[:, None], 300, axis=1).astype(np.uint8)
    image[50:53] += np.array([20, 40, 20], np.uint8)[:, None]
    assert (peaks(image, whole(image))[0] == 51).all()


def test_the_runner_up_keeps_away_from_the_peak() -> None:
    image = np.full((160, 10), 10, np.uint8)
    image[80], image[88], image[120] = 200, 150, 100
    peak, runner_up, value = peaks(image, whole(image), exclusion=12)
    assert (peak == 80).all()
    assert (runner_up == 120).all()
    assert (value == 100).all()


def test_each_tile_is_searched_in_its_own_band() -> None:
    image = np.full((64, 2 * TILE_COLUMNS + 5), 10, np.uint8)
    image[8], image[40] = 120, 200
    bands = np.array([[[0, 20], [20, 64], [30, 30]]], np.int32)
    peak, runner_up, value = peaks(image, bands)
    assert (peak[0, :TILE_COLUMNS] == 8).all()
    assert (peak[0, TILE_COLUMNS : 2 * TILE_COLUMNS] == 40).all()
    assert (peak[0, 2 * TILE_COLUMNS :] == -1).all()
    assert (runner_up[0, 2 * TILE_COLUMNS :] == -1).all()
    assert (value[0, 2 * TILE_COLUMNS :] == 0).all()


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_a_channel_is_searched_in_place(channel: int) -> None:
    rng = np.random.default_rng(5)
    image = np.full((96, 200, 3), 10, np.uint8)
    rows = rng.integers(20, 76, (3, 200))
    for c in range(3):
        image[rows[c], np.arange(200), c] = 220
    flat = image.reshape(96, -1)
    assert (peaks(flat, whole(flat, 3), step=3, channel=channel)[0][0] == rows[channel]).all()


def test_other_channels_have_no_say_in_what_stands_out_at_the_top_and_bottom() -> None:
    rng = np.random.default_rng(6)
    image = rng.integers(0, 60, (96, 256, 3)).astype(np.uint8)
    image[..., :2] = np.arange(96)[:, None, None] * 2
    plane = np.ascontiguousarray(image[..., 2])
    flat = image.reshape(96, -1)
    colour, gray = peaks(flat, whole(flat, 3), step=3, channel=2), peaks(plane, whole(plane))
    for a, b in zip(colour, gray, strict=True):
        assert np.array_equal(a, b)


def test_a_difference_of_channels_ignores_what_is_gray() -> None:
    image = np.full((96, 40, 3), 20, np.uint8)
    image[70] = 250
    image[30, :, 2] = 90
    flat = image.reshape(96, -1)
    assert (peaks(flat, whole(flat, 3), step=3, channel=2, minus=0)[0] == 30).all()
