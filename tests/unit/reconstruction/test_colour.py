"""Colours taken from frames in which the stripes are elsewhere."""

import numpy as np
import pytest

from twinline.geometry.nominal import default_rig
from twinline.reconstruction.colour import CLEARANCE_PX, sample_colours, shift_per_mm

SIZE = (90, 120)


def picture() -> np.ndarray[tuple[int, int, int], np.dtype[np.uint8]]:
    """Blue tells the row, green the column, red is 200."""
    image = np.zeros((*SIZE, 3), np.uint8)
    image[..., 0], image[..., 1] = np.indices(SIZE)
    image[..., 2] = 200
    return image


def sample(
    pixel: tuple[float, float], shift: tuple[float, float], stripe: float, *, along_u: bool = True
) -> tuple[bool, list[int]]:
    stripes = np.full((1, SIZE[1] if along_u else SIZE[0]), stripe)
    colours = np.full((3, 3), 128, np.uint8)
    missing = np.array([False, True, False])
    depth = 2.0
    left = sample_colours(
        np.full((3, 2), pixel), np.full(3, depth), 2.0 * depth * np.array(shift), picture(), stripes, along_u, missing,
        colours,
    )  # fmt: skip
    assert (colours[[0, 2]] == 128).all()
    assert left == int(missing.sum())
    return not missing[1], colours[1].tolist()


def test_the_colour_is_taken_where_the_point_has_moved_to_as_red_green_blue() -> None:
    assert sample((40.0, 10.0), (1.5, 20.2), np.nan) == (True, [200, 43, 50])


def test_the_nearest_pixel_is_taken() -> None:
    assert sample((40.0, 10.0), (0.2, 20.3), np.nan) == (True, [200, 40, 51])


@pytest.mark.parametrize("beside", [-1.0, 1.0])
@pytest.mark.parametrize("along_u", [True, False])
def test_nothing_is_taken_from_the_halo_of_a_stripe(beside: float, along_u: bool) -> None:
    place = 50.0 if along_u else 40.0
    near, clear = (place + beside * (CLEARANCE_PX + d) for d in (-0.5, 0.5))
    assert not sample((40.0, 10.0), (0.0, 20.0), near, along_u=along_u)[0]
    assert sample((40.0, 10.0), (0.0, 20.0), clear, along_u=along_u)[0]


@pytest.mark.parametrize("shift", [(-21.0, 0.0), (40.0, 0.0), (0.0, -6.0), (0.0, 40.0)])
def test_nothing_is_taken_from_outside_the_picture(shift: tuple[float, float]) -> None:
    assert sample((40.0, 10.0), shift, np.nan) == (False, [128, 128, 128])


def test_a_still_point_moves_against_the_travel_by_its_focal_length_over_its_depth() -> None:
    # The cart travels along image +v, so what lies still moves towards -v.
    rig = default_rig()
    np.testing.assert_allclose(shift_per_mm(rig), [0.0, -rig.camera.fy], atol=1e-9)
