"""Clouds and ToF rasters of surfaces that are given by a formula; nothing of the package but its containers."""

from collections.abc import Callable

import numpy as np

from twinline.arrays import FloatArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.tof import TofRaster
from twinline.geometry.rig import TofMount

Surface = Callable[[FloatArray, FloatArray], FloatArray]


def flat(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.zeros_like(x + y)


def step(x: FloatArray, y: FloatArray) -> FloatArray:
    """A plate 10 mm high over y from -8 to 8 mm."""
    return np.asarray(np.where(np.abs(y) < 8.0, 10.0, 0.0) + 0.0 * x)


def ripples(x: FloatArray, y: FloatArray) -> FloatArray:
    """Waves of 3 mm along the travel, 0.4 mm from crest to trough."""
    return np.asarray(0.2 * np.sin(2.0 * np.pi * x / 3.0) + 0.0 * y)


def cloud_of(points: FloatArray, source: int, sigma_mm: float = 0.05, intensity: float = 120.0) -> PointCloud:
    n = len(points)
    return PointCloud(
        np.asarray(points, np.float32),
        np.full(n, sigma_mm, np.float32),
        np.full(n, intensity, np.float32),
        np.full((n, 3), 90, np.uint8),
        np.full(n, source, np.uint8),
    )


def laser_cloud(
    surface: Surface, source: Source, *, pitch_mm: float = 1.0, sigma_mm: float = 0.05, seed: int = 1,
    half_mm: float = 15.0, start_mm: float = 0.0,
) -> PointCloud:  # fmt: skip
    """A laser's points as a pass gives them: lines across the bed, frame by frame, with noise in height."""
    rng = np.random.default_rng([seed, int(source)])
    x = np.arange(-half_mm + start_mm, half_mm, pitch_mm)
    y = np.arange(-half_mm, half_mm, 0.42) + rng.uniform(0, 0.4)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    z = surface(grid[:, 0], grid[:, 1]) + rng.normal(0.0, sigma_mm, len(grid))
    return cloud_of(np.column_stack([grid, z]), source, sigma_mm)


MOUNT = TofMount(
    position_mm=np.array([0.0, 0.0, 136.0]),
    beam=np.array([0.0, 0.0, -1.0]),
    slide=np.array([0.0, 1.0, 0.0]),
    gain_mm_per_unit=1.0,
    offset_mm=0.0,
    range_mm=(60.0, 140.0),
    lag_s=0.018,
)


def raster(
    surface: Surface, *, lag_s: float = 0.018, noise_mm: float = 0.0, lines: int = 12, step_s: float = 0.01,
    speed_mm_s: float = 20.0, half_mm: float = 30.0, both_ways: bool = True, seed: int = 3,
) -> TofRaster:  # fmt: skip
    """Readings in mm of a sensor with a first-order lag, found by small steps of its differential equation."""
    rng = np.random.default_rng(seed)
    fine = 200
    times, carts, slides, readings = [], [], [], []
    lagged, now = None, 0.0
    for line in range(lines):
        cart = 1.5 * line
        count = int(2 * half_mm / (speed_mm_s * step_s))
        path = -half_mm + speed_mm_s * step_s * np.arange(count * fine) / fine
        if both_ways and line % 2:
            path = path[::-1]
        distance = 136.0 - surface(np.full(len(path), cart), path)
        for k, true in enumerate(distance):
            lagged = true if lagged is None or lag_s == 0 else lagged + (true - lagged) * (step_s / fine) / lag_s
            if k % fine == 0:
                times.append(now + k / fine * step_s)
                carts.append(cart)
                slides.append(path[k])
                readings.append(lagged)
        now = times[-1] + step_s
    reading = np.array(readings) + rng.normal(0.0, noise_mm, len(readings))
    return TofRaster(np.array(times), np.array(carts), np.array(slides), reading)
