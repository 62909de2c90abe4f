import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.calibration.joint_cells import find_cells


def surface(x: FloatArray, y: FloatArray) -> FloatArray:
    """A ramp, and a step up at x = 20."""
    return np.asarray(5.0 + 0.3 * x - 0.2 * y + np.where(x > 20, 8.0, 0.0))


def cloud(seed: int, count: int = 6000, offset_mm: float = 0.0) -> FloatArray:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 40, count), rng.uniform(0, 30, count)
    return np.column_stack([x, y, surface(x, y) + offset_mm + rng.normal(0, 0.02, count)])


def heights(clouds: tuple[FloatArray, ...], size_mm: float = 1.5) -> tuple[FloatArray, FloatArray]:
    """Mean difference of the first two sensors per cell along the normal, and the cells' places."""
    cells = find_cells(clouds, size_mm)
    sums, counts = np.zeros((2, cells.cells)), np.zeros((2, cells.cells))
    for sensor in (0, 1):
        at = cells.cell[cells.entry[sensor]]
        along = np.einsum("ij,ij->i", cells.normal[at], clouds[sensor][cells.points[sensor]])
        np.add.at(sums[sensor], at, along)
        np.add.at(counts[sensor], at, 1.0)
    both = (counts[0] > 0) & (counts[1] > 0)
    return (sums[0] / np.maximum(counts[0], 1) - sums[1] / np.maximum(counts[1], 1))[both], cells.place[both]


def test_an_offset_along_the_normal_is_seen_whatever_the_slope() -> None:
    difference, _ = heights((cloud(1, offset_mm=0.1), cloud(2), np.empty((0, 3))))
    assert len(difference) > 200
    assert np.median(difference) == pytest.approx(0.1 / np.sqrt(1 + 0.3**2 + 0.2**2), abs=0.002)


def test_normals_are_those_of_the_surface() -> None:
    cells = find_cells((cloud(3), cloud(4), np.empty((0, 3))), 1.5)
    expected = np.array([-0.3, 0.2, 1.0]) / np.sqrt(1.13)
    np.testing.assert_allclose(np.median(cells.normal, axis=0), expected, atol=0.01)


def test_cells_on_a_step_are_left_out() -> None:
    _, place = heights((cloud(5), cloud(6), np.empty((0, 3))))
    assert (np.abs(place[:, 0] - 20.0) > 1.4).all()


def test_a_curved_surface_says_so() -> None:
    def ball(seed: int) -> FloatArray:
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-9, 9, 9000), rng.uniform(-9, 9, 9000)
        return np.column_stack([x, y, np.sqrt(17.0**2 - x * x - y * y)])

    cells = find_cells((ball(7), ball(8), np.empty((0, 3))), 1.2)
    middle = np.hypot(*cells.place.T) < 5
    assert np.median(cells.curvature[middle]) == pytest.approx(1 / 17.0, rel=0.25)
    flat = find_cells((cloud(9), cloud(10), np.empty((0, 3))), 1.5)
    assert np.median(flat.curvature) < 0.01


def test_sensors_that_saw_nothing_in_common_have_no_cells() -> None:
    assert find_cells((cloud(11), cloud(12) + np.array([100.0, 0.0, 0.0]), np.empty((0, 3))), 1.5).cells == 0
    assert find_cells((np.empty((0, 3)),) * 3, 1.5).cells == 0
