"""The tree of boxes against trying every triangle, and rays with an answer known by hand."""

import numpy as np
import pytest

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.bvh import build_bvh
from twinline.devices.simulator.raycast import first_hits


def every_triangle(triangles: FloatArray, origin: FloatArray, direction: FloatArray) -> tuple[float, int]:
    """Nearest hit by solving origin + t direction = a + p (b - a) + q (c - a) for each triangle."""
    best, found = np.inf, -1
    for number, (a, b, c) in enumerate(triangles):
        system = np.column_stack([-direction, b - a, c - a])
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        t, p, q = np.linalg.solve(system, origin - a)
        if t > 0 and min(p, q) >= 0 and p + q <= 1 and t < best:
            best, found = float(t), number
    return best, found


@pytest.mark.parametrize(("count", "size"), [(1, 30.0), (7, 30.0), (150, 25.0), (150, 2.0)])
def test_the_tree_finds_what_trying_every_triangle_finds(count: int, size: float) -> None:
    rng = np.random.default_rng(20240607 + count)
    triangles = rng.uniform(-40, 40, (count, 1, 3)) + rng.normal(0, size, (count, 3, 3))
    origins = rng.uniform(-80, 80, (300, 3))
    directions = rng.uniform(-30, 30, (300, 3)) - origins
    places, found = first_hits(build_bvh(triangles), origins, directions)
    expected = [every_triangle(triangles, o, d) for o, d in zip(origins, directions, strict=True)]
    np.testing.assert_array_equal(found, [number for _, number in expected])
    np.testing.assert_allclose(places, [t for t, _ in expected], rtol=1e-9)
    assert count == 1 or (found >= 0).any()


def grid_of_squares(cells: int) -> FloatArray:
    x, y = np.meshgrid(np.arange(cells, dtype=float), np.arange(cells, dtype=float), indexing="ij")
    a = np.stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)], axis=1)
    b, c, d = (a + np.array(step) for step in ((1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def test_no_ray_slips_between_triangles_that_share_an_edge() -> None:
    along = np.linspace(0.01, 15.99, 3001)
    # On the diagonals, on the grid lines and on the corners.
    targets = np.concatenate(
        [
            np.stack([along, along], axis=1),
            np.stack([along, np.full(len(along), 8.0)], axis=1),
            [[3.0, 4.0], [8.0, 8.0]],
        ]
    )
    origins = np.column_stack([targets, np.full(len(targets), 435.0)])
    straight_down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
    places, found = first_hits(build_bvh(grid_of_squares(16)), origins, straight_down)
    assert (found >= 0).all()
    np.testing.assert_allclose(places, 430.0, atol=1e-9)


def test_many_triangles_with_the_same_middle_still_make_a_tree() -> None:
    triangles = np.broadcast_to([[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [0.0, 1.0, 2.0]], (100, 3, 3)).copy()
    places, _ = first_hits(build_bvh(triangles), np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    assert places[0] == pytest.approx(2.0)


def test_an_empty_scene_is_never_hit() -> None:
    places, found = first_hits(build_bvh(np.empty((0, 3, 3))), np.zeros((2, 3)), np.ones((2, 3)))
    assert np.isinf(places).all()
    assert (found == -1).all()


def test_every_triangle_is_in_exactly_one_leaf() -> None:
    triangles = np.random.default_rng(5).normal(0, 10, (333, 3, 3))
    bvh = build_bvh(triangles)
    leaves: list[IntArray] = [np.arange(first, first + count) for first, count in bvh.links if count]
    np.testing.assert_array_equal(np.sort(np.concatenate(leaves)), np.arange(333))
    np.testing.assert_array_equal(np.sort(bvh.order), np.arange(333))
