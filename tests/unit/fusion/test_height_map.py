"""Heights on a grid."""

import numpy as np
import pytest

from tests.unit.fusion.scenes import cloud_of, laser_cloud, step
from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.height_map import grown, height_map


def test_cells_hold_the_mean_by_inverse_variance_and_its_deviation() -> None:
    cloud = PointCloud.concatenate(
        [cloud_of(np.array([[0.2, 0.2, 1.0]]), 1, 0.1), cloud_of(np.array([[0.7, 0.4, 1.3]]), 2, 0.2)]
    )
    made = height_map(cloud, 1.0, low_mm=(0.0, 0.0), high_mm=(1.5, 0.5))
    assert made.shape == (2, 1)
    assert made.height_mm[0, 0] == pytest.approx((100 * 1.0 + 25 * 1.3) / 125, abs=1e-6)
    assert made.sigma_mm[0, 0] == pytest.approx(125**-0.5, abs=1e-6)
    assert made.count.tolist() == [[2], [0]]
    assert np.isnan(made.height_mm[1, 0])
    np.testing.assert_allclose(made.places()[1, 0], [1.5, 0.5])


def test_over_a_wall_the_upper_surface_counts() -> None:
    wall = np.column_stack([np.full(50, 0.5), np.full(50, 0.5), np.linspace(0.0, 20.0, 50)])
    made = height_map(cloud_of(wall, 1), 1.0)
    assert 19.0 < made.height_mm[0, 0] <= 20.0


def test_a_scale_comes_with_it() -> None:
    made = height_map(laser_cloud(step, Source.LASER_1), 1.5)
    places = made.places()
    inside = np.abs(places[..., 1]) < 6.5
    assert float(np.nanmedian(made.height_mm[inside])) == pytest.approx(10.0, abs=0.05)
    assert float(np.nanmedian(made.height_mm[np.abs(places[..., 1]) > 9.5])) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(
    ("points", "cell", "message"),
    [
        (np.empty((0, 3)), 1.0, "without points"),
        (np.full((4, 3), np.nan), 1.0, "without points"),
        (np.zeros((4, 3)), 0.0, "larger than 0"),
        (np.zeros((4, 3)), np.nan, "larger than 0"),
        (np.array([[0, 0, 0], [1e6, 1e6, 0.0]]), 0.1, "too large"),
    ],
)
def test_what_cannot_be_mapped_is_said(points: FloatArray, cell: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        height_map(cloud_of(points, 1), cell)


def test_gaps_beside_an_object_are_taken_for_ground_and_others_for_what_is_nearest() -> None:
    shadow = np.array([[0.0, np.nan, np.nan, np.nan, 9.0]])
    np.testing.assert_array_equal(grown(shadow), [[0.0, 0.0, 0.0, 0.0, 9.0]])
    slope = np.array([[4.0, np.nan, np.nan, 5.0]])
    np.testing.assert_array_equal(grown(slope), [[4.0, 4.0, 5.0, 5.0]])
    assert np.isnan(grown(np.full((2, 2), np.nan))).all()
