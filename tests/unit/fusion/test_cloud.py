"""The point cloud as a container: rows stay together."""

import numpy as np
import pytest

from twinline.fusion.cloud import PointCloud


def cloud(count: int, start: int = 0, *, normals: bool = False) -> PointCloud:
    rows = np.arange(start, start + count)
    return PointCloud(
        np.column_stack([rows, rows, rows]).astype(np.float32),
        rows.astype(np.float32),
        rows.astype(np.float32),
        np.column_stack([rows, rows, rows]).astype(np.uint8),
        rows.astype(np.uint8),
        np.tile(np.array([0, 0, 1], np.float32), (count, 1)) if normals else None,
    )


def test_a_selection_takes_whole_rows() -> None:
    part = cloud(6, normals=True).select(np.array([4, 1]))
    np.testing.assert_array_equal(part.points_mm[:, 0], [4, 1])
    for values in (part.sigma_mm, part.intensity, part.source, part.colour[:, 2]):
        np.testing.assert_array_equal(values, [4, 1])
    assert part.normals is not None
    assert part.normals.shape == (2, 3)


def test_clouds_are_joined_in_order() -> None:
    whole = PointCloud.concatenate([cloud(2), PointCloud.empty(), cloud(3, 2)])
    np.testing.assert_array_equal(whole.sigma_mm, np.arange(5))
    assert whole.points_mm.dtype == np.float32
    assert len(PointCloud.concatenate([])) == 0


def test_normals_survive_only_if_every_cloud_has_them() -> None:
    assert PointCloud.concatenate([cloud(2, normals=True), cloud(1, normals=True)]).normals is not None
    assert PointCloud.concatenate([cloud(2, normals=True), cloud(1)]).normals is None


def test_arrays_of_different_length_are_refused() -> None:
    good = cloud(3)
    with pytest.raises(ValueError, match="sigma_mm"):
        PointCloud(good.points_mm, good.sigma_mm[:2], good.intensity, good.colour, good.source)
    with pytest.raises(ValueError, match="normals"):
        PointCloud(good.points_mm, good.sigma_mm, good.intensity, good.colour, good.source, np.zeros((2, 3)))
