"""Points on surfaces of known shape, with noise of known size."""

import numpy as np

from twinline.arrays import FloatArray


def flat_points(count: int, *, size_mm: float = 40.0, noise_mm: float = 0.0, seed: int = 1) -> FloatArray:
    """Points of the bed around the origin, noise along z."""
    rng = np.random.default_rng(seed)
    points = np.zeros((count, 3))
    points[:, :2] = rng.uniform(-size_mm / 2, size_mm / 2, (count, 2))
    points[:, 2] = rng.normal(0.0, noise_mm, count) if noise_mm else 0.0
    return points


def sphere_points(
    count: int, *, radius_mm: float = 12.7, lowest: float = 0.3, noise_mm: float = 0.0, seed: int = 1
) -> FloatArray:
    """Points on the upper cap of a sphere about the origin, down to `lowest` radii above its centre."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(lowest, 1.0, count)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    across = np.sqrt(1.0 - z**2)
    direction = np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
    return direction * (radius_mm + (rng.normal(0.0, noise_mm, (count, 1)) if noise_mm else 0.0))


def cylinder_points(
    count: int,
    *,
    radius_mm: float = 8.0,
    length_mm: float = 30.0,
    arc_deg: float = 140.0,
    noise_mm: float = 0.0,
    seed: int = 1,
) -> FloatArray:
    """Points on the upper part of a cylinder that lies along x, its axis through the origin."""
    rng = np.random.default_rng(seed)
    angle = np.radians(rng.uniform(-arc_deg / 2, arc_deg / 2, count))
    radius = radius_mm + (rng.normal(0.0, noise_mm, count) if noise_mm else 0.0)
    x = rng.uniform(-length_mm / 2, length_mm / 2, count)
    return np.column_stack([x, radius * np.sin(angle), radius * np.cos(angle)])


def turned(points_mm: FloatArray, angles_deg: tuple[float, float, float]) -> FloatArray:
    """The points turned about x, then y, then z."""
    a, b, c = np.radians(angles_deg)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(points_mm @ (about_z @ about_y @ about_x).T)


def block_points(
    size_mm: tuple[float, float, float],
    *,
    angle_deg: float = 0.0,
    pitch_mm: tuple[float, float] = (0.25, 0.3),
    noise_mm: float = 0.0,
    bed_mm: float = 15.0,
    seed: int = 1,
) -> FloatArray:
    """A block on the bed as rows of points see it from above: its top, and the bed around it.

    The rows have an even spacing and a random phase, as those of a scan.
    """
    rng = np.random.default_rng(seed)
    reach = max(size_mm[:2]) / 2 + bed_mm
    x = np.arange(-reach, reach, pitch_mm[0]) + rng.uniform(0, pitch_mm[0])
    y = np.arange(-reach, reach, pitch_mm[1])
    # Each row begins elsewhere, as stripes do whose columns see different heights.
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    grid_y = grid_y + rng.uniform(0, pitch_mm[1], (len(x), 1))
    flat = np.column_stack([grid_x.ravel(), grid_y.ravel()])
    angle = np.radians(angle_deg)
    u = flat @ [np.cos(angle), np.sin(angle)]
    v = flat @ [-np.sin(angle), np.cos(angle)]
    inside = (np.abs(u) < size_mm[0] / 2) & (np.abs(v) < size_mm[1] / 2)
    z = np.where(inside, size_mm[2], 0.0) + rng.normal(0.0, noise_mm, len(flat))
    return np.column_stack([flat, z])
