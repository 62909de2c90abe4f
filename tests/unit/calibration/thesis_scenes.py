"""A prism and a dome on the bed as two lasers and a ToF sensor see them, by ray-plane algebra of its own."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.observations import StripePoints, TofReadings
from twinline.geometry.camera import Camera
from twinline.geometry.nominal import nominal_rig, nominal_tof
from twinline.geometry.rig import Rig

FOCAL = (1028.84412, 1028.59061)
CENTRE = (648.47410, 363.64953)
HEIGHT_MM = 430.0
PRISM_MM = (25.4, 24.2, 19.35)
Height = Callable[[FloatArray, FloatArray], FloatArray]
"""Height of the surface over places x, y of the bed."""

THESIS = ((251.6284, 65.7536), (251.4805, 62.4899))
"""Baselines in millimetres and angles in degrees to which the thesis calibrated lasers 1 and 2."""


def rotation(axis: int, degrees: float) -> FloatArray:
    angle = np.radians(degrees)
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
    return turn


@dataclass
class Machine:
    """A machine with the mechanical errors that the two-parameter model does not know."""

    lasers: tuple[tuple[float, float], ...] = THESIS
    camera_turn: FloatArray = field(default_factory=lambda: np.eye(3))
    sheet_turns: tuple[FloatArray, ...] = field(default_factory=lambda: (np.eye(3), np.eye(3)))
    travel: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    tof_error_mm: FloatArray = field(default_factory=lambda: np.zeros(3))

    def bed_from_camera(self) -> FloatArray:
        down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        return np.asarray(self.camera_turn @ down)

    def sheet(self, laser: int) -> tuple[FloatArray, float]:
        """Plane n . p = c in the camera frame, turned about the laser's own place."""
        baseline, degrees = self.lasers[laser]
        sign = 1.0 if laser == 0 else -1.0
        angle = np.radians(degrees)
        normal = self.sheet_turns[laser] @ np.array([0.0, sign * np.sin(angle), np.cos(angle)])
        return normal, float(normal @ [0.0, sign * baseline, 0.0])


def prism(x: FloatArray, y: FloatArray) -> FloatArray:
    inside = (np.abs(x + 22.0) < PRISM_MM[0] / 2) & (np.abs(y) < PRISM_MM[1] / 2)
    return np.where(inside, PRISM_MM[2], 0.0)


def dome(x: FloatArray, y: FloatArray) -> FloatArray:
    """Cap of a sphere, 12 mm high and 36 mm wide."""
    radius = (18.0**2 + 12.0**2) / 24.0
    inside = np.maximum(radius**2 - (x - 20.0) ** 2 - y**2, 0.0)
    return np.maximum(np.sqrt(inside) - (radius - 12.0), 0.0)


def scene(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.maximum(prism(x, y), dome(x, y))


def points_at(machine: Machine, laser: int, tangent: FloatArray, lane: FloatArray) -> FloatArray:
    """Points of the sheet, in the frame of the bed under the cart, on the rays (lane, tangent, 1)."""
    normal, offset = machine.sheet(laser)
    rays = np.stack([lane, tangent, np.ones_like(lane)], axis=-1)
    points = rays * (offset / (rays @ normal))[..., None]
    return np.asarray(points @ machine.bed_from_camera().T + [0.0, 0.0, HEIGHT_MM])


def stripes(
    machine: Machine,
    laser: int,
    *,
    height: Height = scene,
    cart_mm: FloatArray | None = None,
    noise_px: float = 0.0,
    seed: int = 20240607,
) -> StripePoints:
    """Where the laser's light, coming down its sheet, first meets the surface, if the camera sees that place."""
    sign = 1.0 if laser == 0 else -1.0
    u = np.arange(580.0, 718.0, 2.0)
    cart_mm = np.arange(-112.0, 112.0, 0.83) if cart_mm is None else cart_mm
    cart, lane = np.meshgrid(cart_mm, (u - CENTRE[0]) / FOCAL[0], indexing="ij")

    def above(tangent: FloatArray) -> FloatArray:
        points = points_at(machine, laser, tangent, lane) + cart[..., None] * machine.travel
        return np.asarray(points[..., 2] - height(points[..., 0], points[..., 1]))

    grid = np.linspace(0.22, 0.06, 90)
    over, under = np.full(cart.shape, sign * grid[0]), np.full(cart.shape, np.nan)
    for value in sign * grid[1:]:
        below = np.isnan(under) & (above(np.full(cart.shape, value)) <= 0)
        under[below] = value
        over = np.where(np.isnan(under), value, over)
    for _ in range(34):
        middle = 0.5 * (over + under)
        high = above(middle) > 0
        over, under = np.where(high, middle, over), np.where(high, under, middle)
    lit = points_at(machine, laser, over, lane) + cart[..., None] * machine.travel
    camera = np.array([0.0, 0.0, HEIGHT_MM]) + cart[..., None] * machine.travel
    for share in np.linspace(0.002, 0.06, 30):
        on_ray = lit + share * (camera - lit)
        lit[on_ray[..., 2] < height(on_ray[..., 0], on_ray[..., 1])] = np.nan
    rng = np.random.default_rng(seed + laser)
    v = FOCAL[1] * over + CENTRE[1] + rng.normal(0.0, 1.0, cart.shape) * noise_px
    seen = np.isfinite(lit[..., 0])
    pixels = np.column_stack([np.broadcast_to(u, cart.shape)[seen], v[seen]])
    return StripePoints(pixels, np.full(len(pixels), max(noise_px, 0.01)), cart[seen])


def raster(machine: Machine, *, height: Height = scene, noise_mm: float = 0.0, seed: int = 7) -> TofReadings:
    """Distances in millimetres by a sensor 139 mm above the bed, displaced by the machine's ``tof_error_mm``."""
    cart, slide = np.meshgrid(np.arange(-45.0, 45.0, 1.0), np.arange(-26.0, 26.0, 0.5), indexing="ij")
    cart, slide = cart.ravel(), slide.ravel()
    there = np.array([0.0, 0.0, 139.0]) + machine.tof_error_mm
    x = there[0] + cart * machine.travel[0]
    y = there[1] + slide + cart * machine.travel[1]
    distance = there[2] + cart * machine.travel[2] - height(x, y)
    distance = distance + np.random.default_rng(seed).normal(0.0, 1.0, len(distance)) * noise_mm
    return TofReadings(np.arange(len(cart)) * 0.01, cart, slide, distance)


def camera() -> Camera:
    matrix = np.array([[FOCAL[0], 0.0, CENTRE[0]], [0.0, FOCAL[1], CENTRE[1]], [0.0, 0.0, 1.0]])
    return Camera(matrix, (1280, 720))


def rig(lasers: tuple[tuple[float, float], ...] = ((246.0, 60.0), (246.0, 60.0))) -> Rig:
    """The nominal rig that knows nothing of the machine's errors."""
    tof = nominal_tof(np.array([0.0, 0.0, 139.0]), (60.0, 140.0), "distance_mm")
    sheets = [(d, float(np.radians(a)), side) for (d, a), side in zip(lasers, ("+v", "-v"), strict=True)]
    return nominal_rig("test", camera(), "along-u", sheets, HEIGHT_MM, tof)  # type: ignore[arg-type]
