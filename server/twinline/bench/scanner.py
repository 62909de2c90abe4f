"""A scanner out of true and what it would observe, computed without pictures: a problem to time adjustments on."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.bench.captures import bench_rig
from twinline.calibration.joint_model import Scanner, TofPoints, laser_samples
from twinline.calibration.joint_priors import free_parameters, nominal_covariance, sheet_priors, tof_priors
from twinline.calibration.joint_types import Observations, Prior
from twinline.calibration.observations import StripePoints
from twinline.calibration.scanner import PARTS, scanner_of_rig
from twinline.calibration.sheets import sheet_from_bed_line
from twinline.geometry.nominal import nominal_tof

SIZE = (1280, 720)
CELL_MM = 1.5
_SEED = 20240605
_CENTRE_SD_PX = 0.05
_READING_SD_MM = 0.01
_HALF_X_MM, _HALF_Y_MM = 45.0, 80.0
_BED_LANES, _BED_CARTS = 24, 3
_TOF_SHARE = 0.25
_LAG_S, _SAMPLE_S = 0.018, 0.05
_SWEEP_STEP_MM = 1.0
_CAMERA_SD = (0.4, 0.4, 0.4, 0.4, 1e-3, 4e-3, 1e-4, 1e-4, 1e-9)
_LENS_OPEN = (1.0,) * 8 + (0.0,)
_MOTION_SHARE, _MOTION_RAD = 2e-4, 4e-4
_FIXED_POINT_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Problem:
    """An adjustment to be made.

    Attributes
    ----------
    true, start
        The scanner that observed, and where an adjustment begins.
    priors
        What is known beforehand; camera and travel as their own calibrations would leave them.
    free : (p,) bool array
    prior_sd : (p,) array
        Standard deviation of each parameter before any observation.
    count
        Stripe centres and ToF readings.
    """

    true: Scanner
    start: Scanner
    observations: Observations
    priors: tuple[Prior, ...]
    free: BoolArray
    prior_sd: FloatArray
    cell_mm: float
    count: int

    def shape_error_mm(self, scanner: Scanner) -> float:
        """Root mean square distance of the stripes' points under two scanners after the best rigid motion."""
        here, there = (
            np.concatenate([laser_samples(s, k, part).points for k, part in enumerate(self.observations.objects)])
            for s in (scanner, self.true)
        )
        known = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
        a, b = here[known] - here[known].mean(axis=0), there[known] - there[known].mean(axis=0)
        # B. K. P. Horn, "Closed-form solution of absolute orientation", by a singular value decomposition.
        u, _, v = np.linalg.svd(a.T @ b)
        turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
        return float(np.sqrt(((a @ turn.T - b) ** 2).sum(axis=1).mean()))


def simulated_problem(observations: int) -> Problem:
    """A whole scanner over blocks and a dome, with about as many observations as are asked for.

    Three quarters are stripe centres of two lasers with noise of 0.05 px, the rest ToF readings with a first-order lag.
    """
    rng = np.random.default_rng(_SEED)
    nominal = scanner_of_rig(
        replace(bench_rig(SIZE), tof=nominal_tof(np.array([-105.0, 5.0, 136.0]), (60.0, 140.0), "distance_mm"))
    )
    assert nominal.tof is not None
    nominal = replace(nominal, tof=replace(nominal.tof, lag_s=_LAG_S))
    true = _out_of_true(nominal, rng)
    each = int(observations * (1.0 - _TOF_SHARE)) // 2
    objects = tuple(_stripes(true, k, *_scattered(rng, each), rng) for k in range(2))
    bed = tuple(_stripes(true, k, *_bed_places(), rng, averaged=20) for k in range(2))
    tof = _readings(true, observations - 2 * each, rng)
    # Camera and travel have calibrations of their own; the rest is as built.
    known = replace(nominal, camera=true.camera, travel=true.travel, bed=true.bed)
    start = replace(known, camera=true.camera + np.array(_LENS_OPEN) * rng.normal(0.0, _CAMERA_SD))
    start = replace(start, sheets=np.array([_first_sheet(start, k, part) for k, part in enumerate(bed)]))
    priors = (*_instruments(start, true), *sheet_priors(start, nominal.sheets), *tof_priors(start, start))
    return Problem(
        true,
        start,
        Observations(bed, objects, None, tof),
        priors,
        free_parameters(start, frozenset(PARTS)),
        np.sqrt(np.diagonal(nominal_covariance(start, nominal))),
        CELL_MM,
        sum(map(len, objects)) + sum(map(len, bed)) + len(tof),
    )


def _out_of_true(nominal: Scanner, rng: np.random.Generator) -> Scanner:
    """Errors of some millimetres and up to a degree everywhere."""
    assert nominal.tof is not None
    tof = replace(
        nominal.tof,
        position=nominal.tof.position + np.array([2.0, -1.5, 0.6]),
        tilt=np.array([-0.006, 0.005]),
        slide=nominal.tof.slide + np.array([0.0, 0.008, 0.002]),
    )
    slant = np.array([[2.0e-5, 4.0e-5, -6.0e-5], [-3.0e-5, 5.0e-5, -4.0e-5]])
    lens = np.array([4.0, 3.5, 6.0, -5.0, -0.11, 0.06, 6e-4, -4e-4, 0.0])
    return replace(
        nominal,
        camera=nominal.camera + lens,
        travel=nominal.travel + np.array([0.004, 0.005, -0.003]),
        bed=nominal.bed * 1.003 + 1e-5 * rng.normal(size=3),
        sheets=nominal.sheets + slant,
        tof=tof,
    )


def _instruments(start: Scanner, true: Scanner) -> tuple[Prior, Prior]:
    """Camera and motion as known by their own calibrations."""
    size = float(np.linalg.norm(true.bed))
    motion = np.concatenate([np.full(3, _MOTION_SHARE), np.full(3, _MOTION_RAD * size)])
    return (
        Prior(np.arange(9), start.camera.copy(), np.diag(1.0 / np.array(_CAMERA_SD) ** 2)),
        Prior(np.arange(9, 15), np.concatenate([true.travel, true.bed]), np.diag(1.0 / motion**2)),
    )


def _first_sheet(start: Scanner, laser: int, bed: StripePoints) -> FloatArray:
    """In closed form, through the stripe on the bed and the laser as built."""
    rays = start.as_camera().rays(bed.pixels)
    baseline = float(1.0 / abs(start.sheets[laser][1]))
    return sheet_from_bed_line(rays, start.bed, baseline, start.sides[laser]).inverse_depth


def _height_mm(x: FloatArray, y: FloatArray) -> FloatArray:
    """Two blocks, a ramp and a dome."""
    dome = 22.0 * np.sqrt(np.maximum(1.0 - (x / 36.0) ** 2 - ((y - 45.0) / 32.0) ** 2, 0.0))
    ramp = np.where(np.abs(y + 5.0) < 14.0, 16.0 + 0.25 * x, 0.0)
    block = np.where(np.abs(y + 37.0) < 14.0, 28.0, 0.0) + np.where(np.abs(y + 67.0) < 12.0, 12.0, 0.0)
    return np.asarray(dome + ramp + block)


def _scattered(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    x = rng.uniform(-_HALF_X_MM, _HALF_X_MM, count)
    y = rng.uniform(-_HALF_Y_MM, _HALF_Y_MM, count)
    return x, y, _height_mm(x, y)


def _bed_places() -> tuple[FloatArray, FloatArray, FloatArray]:
    y, x = np.meshgrid(
        np.linspace(-2 * _HALF_Y_MM, 2 * _HALF_Y_MM, _BED_LANES), np.linspace(-_HALF_X_MM, _HALF_X_MM, _BED_CARTS)
    )
    return x.ravel(), y.ravel(), np.zeros(x.size)


def _stripes(
    scanner: Scanner, laser: int, x: FloatArray, y: FloatArray, z: FloatArray, rng: np.random.Generator,
    *, averaged: int = 1,
) -> StripePoints:  # fmt: skip
    """Stripe centres of places on the bed: the cart stands where the sheet meets them."""
    places = (np.column_stack([x, y, z]) - np.array([0.0, 0.0, scanner.height_mm()])) @ scanner.axes()
    sheet = scanner.sheets[laser]
    cart = (places @ sheet - 1.0) / float(sheet @ scanner.travel)
    pixels = scanner.as_camera().project(places - scanner.travel * cart[:, None])
    sd = _CENTRE_SD_PX / np.sqrt(averaged)
    pixels[:, 1] += rng.normal(0.0, sd, len(pixels))
    return StripePoints(pixels, np.full(len(pixels), sd), cart)


def _readings(scanner: Scanner, count: int, rng: np.random.Generator) -> TofPoints:
    """A raster to and fro over the middle of the scene, in millimetres."""
    assert scanner.tof is not None
    axes, up = scanner.axes(), np.array([0.0, 0.0, scanner.height_mm()])
    beam = axes @ scanner.tof.beam
    sweep = np.arange(-_HALF_Y_MM, _HALF_Y_MM, _SWEEP_STEP_MM)
    sweeps = max(count // (len(sweep) - 1), 2)
    ahead = float((axes @ scanner.tof.position)[0])
    parts: list[TofPoints] = []
    for number, place in enumerate(np.linspace(-_HALF_X_MM, _HALF_X_MM, sweeps)):
        slide = sweep if number % 2 == 0 else sweep[::-1]
        cart = np.full(len(slide), place - ahead)
        origin = (
            scanner.tof.position + scanner.travel * cart[:, None] + scanner.tof.slide * slide[:, None]
        ) @ axes.T + up
        seen = _lagging(_distance(origin, beam, _height_mm)) + rng.normal(0.0, _READING_SD_MM, len(slide))
        reading = (seen - scanner.tof.offset) / scanner.tof.gain
        parts.append(TofPoints(cart[1:], slide[1:], reading[1:], np.diff(reading), np.full(len(slide) - 1, _SAMPLE_S)))
    return TofPoints(
        *(
            np.concatenate([getattr(p, n) for p in parts])
            for n in ("cart_mm", "slide_mm", "reading", "change", "step_s")
        )
    )


def _distance(
    origin: FloatArray, beam: FloatArray, height_mm: Callable[[FloatArray, FloatArray], FloatArray]
) -> FloatArray:
    """How far a beam goes that is nearly upright: the place below it settles within a few rounds."""
    distance = origin[:, 2].copy()
    for _ in range(_FIXED_POINT_ROUNDS):
        x, y = (origin[:, :2] + beam[:2] * distance[:, None]).T
        distance = (height_mm(x, y) - origin[:, 2]) / beam[2]
    return distance


def _lagging(distance: FloatArray) -> FloatArray:
    keep = float(np.exp(-_SAMPLE_S / _LAG_S))
    seen = distance.copy()
    for i in range(1, len(seen)):
        seen[i] = keep * seen[i - 1] + (1.0 - keep) * distance[i]
    return seen
