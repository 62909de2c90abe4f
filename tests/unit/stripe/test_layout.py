"""What a picture tells of its stripes without a rig: direction, number, and where to look for each."""

import numpy as np
import pytest
from numpy.typing import NDArray

from twinline.geometry.rig import StripeRuns
from twinline.stripe import ExtractionSettings, extract
from twinline.stripe.layout import find_layout

Bytes = NDArray[np.uint8]

ROWS, COLUMNS = 120, 160
SETTINGS = ExtractionSettings()


def picture(*lines: tuple[float, float, float], runs: StripeRuns = "along-u", seed: int = 4) -> Bytes:
    """Grey stripes (row at the first column, slope, amplitude) on 30 DN with noise of 1.5 DN."""
    v, u = np.indices((ROWS, COLUMNS)).astype(float)
    image = np.full((ROWS, COLUMNS), 30.0)
    for row, slope, amplitude in lines:
        image += amplitude * np.exp(-0.5 * ((v - row - slope * u) / 1.4) ** 2)
    image += np.random.default_rng(seed).normal(0.0, 1.5, image.shape)
    noisy = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return noisy if runs == "along-u" else np.ascontiguousarray(noisy.T)


TWO = ((85.0, 0.1, 120.0), (25.0, 0.12, 100.0))


@pytest.mark.parametrize("runs", ["along-u", "along-v"])
@pytest.mark.parametrize("lines", [TWO[:1], TWO], ids=["one", "two"])
def test_direction_and_number_are_found(runs: StripeRuns, lines: tuple[tuple[float, float, float], ...]) -> None:
    layout = find_layout(picture(*lines, runs=runs), SETTINGS)
    assert layout.runs == runs
    assert layout.bands.shape == (len(lines), COLUMNS, 2)


@pytest.mark.parametrize("runs", ["along-u", "along-v"])
def test_laser_one_is_the_stripe_at_larger_rows_or_columns(runs: StripeRuns) -> None:
    image = picture(*TWO, runs=runs)
    layout = find_layout(image, SETTINGS)
    centre = extract(image, SETTINGS, runs=layout.runs, bands=layout.bands).centre_px
    for found, (row, slope, _) in zip(centre, TWO, strict=True):
        np.testing.assert_allclose(found, row + slope * np.arange(COLUMNS), atol=0.3)


@pytest.mark.parametrize("share", [1.0, 0.5, 0.3])
def test_a_weaker_second_stripe_is_still_a_second_stripe(share: float) -> None:
    image = picture((85.0, 0.1, 120.0), (25.0, 0.12, 120.0 * share))
    assert len(find_layout(image, SETTINGS).bands) == 2


def test_bands_divide_the_picture_between_slanted_stripes_without_a_gap() -> None:
    bands = find_layout(picture((60.0, 0.3, 120.0), (10.0, 0.3, 120.0)), SETTINGS).bands
    np.testing.assert_array_equal(bands[0, :, 0], bands[1, :, 1])
    assert (bands[0, :, 1] == ROWS).all()
    assert (bands[1, :, 0] == 0).all()
    np.testing.assert_allclose(bands[0, :, 0], 35.0 + 0.3 * np.arange(COLUMNS), atol=3.0)


def test_bright_spots_are_no_second_stripe() -> None:
    image = picture(TWO[0])
    rng = np.random.default_rng(9)
    for u in range(0, COLUMNS, 2):
        v = int(rng.integers(3, 70))
        image[v - 1 : v + 2, u] = 130
    assert len(find_layout(image, SETTINGS).bands) == 1


@pytest.mark.parametrize("lasers", [1, 2])
def test_what_is_given_is_kept(lasers: int) -> None:
    layout = find_layout(picture(*TWO), SETTINGS, runs="along-v", lasers=lasers)
    assert layout.runs == "along-v"
    assert layout.bands.shape == (lasers, ROWS, 2)


def test_two_lasers_asked_of_an_empty_picture_share_it_by_halves() -> None:
    bands = find_layout(picture(), SETTINGS, runs="along-u", lasers=2).bands
    np.testing.assert_array_equal(bands[:, 0], [[ROWS // 2, ROWS], [0, ROWS // 2]])


def test_a_laser_off_picture_leaves_only_the_stripe_to_count() -> None:
    lamp = picture((85.0, 0.1, 120.0), seed=5)
    both = np.maximum(lamp, picture((25.0, 0.12, 100.0)))
    assert len(find_layout(both, SETTINGS).bands) == 2
    assert len(find_layout(both, SETTINGS, off=lamp).bands) == 1
