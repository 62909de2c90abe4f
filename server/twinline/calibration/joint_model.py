"""The parameters of the whole scanner as one vector, and where they put a measured point.

All vectors are in the camera's frame at cart position 0: the bed is a plane in it, the cart a direction, the ToF sensor
a place. Only when the adjustment is done are they expressed in the bed frame of a rig. A surface point seen by a laser
is ``r / (m . r) + travel * cart``; one measured by the ToF sensor is
``position + travel * cart + slide * slide_mm + beam * (offset + gain * reading)``, its reading freed from the sensor's
first-order lag: ``z_k = (m_k - q m_(k-1)) / (1 - q)`` with ``q = exp(-dt / lag)``.
"""

from dataclasses import dataclass, replace

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.calibration.bundle import PARAMETERS as CAMERA
from twinline.calibration.bundle import camera_jacobian
from twinline.calibration.observations import StripePoints
from twinline.errors import RigError
from twinline.geometry.camera import Camera, distort_jacobian
from twinline.geometry.rig import StripeRuns, TofMount
from twinline.geometry.sheet import LaserSheet, Side

TOF_NAMES = ("x", "y", "z", "beam_x", "beam_y", "slide_x", "slide_y", "slide_z", "gain", "lag")


@dataclass(frozen=True, eq=False)
class TofState:
    """The ToF sensor in the camera's frame.

    Attributes
    ----------
    position, slide : (3,) arrays
    beam_axes : (3, 3) array
        Rows: two directions across the beam, and the direction about which it tilts.
    tilt : (2,) array
        Tangents of the beam's tilt towards the first two.
    """

    position: FloatArray
    slide: FloatArray
    beam_axes: FloatArray
    tilt: FloatArray
    gain: float
    offset: float
    lag_s: float

    @property
    def beam(self) -> FloatArray:
        """(3,) unit direction."""
        direction = self.beam_axes[2] + self.tilt @ self.beam_axes[:2]
        return np.asarray(direction / np.linalg.norm(direction))


@dataclass(frozen=True, eq=False)
class Scanner:
    """A whole scanner in the camera's frame at cart position 0.

    Attributes
    ----------
    camera : (9,) array
        Values of `bundle.PARAMETERS`.
    travel, bed : (3,) arrays
        Millimetres per commanded millimetre; and the bed plane, ``bed . p = 1``.
    sheets : (lasers, 3) array
        Inverse-depth parameters.
    """

    camera: FloatArray
    size: tuple[int, int]
    stripe_runs: StripeRuns
    sides: tuple[Side, ...]
    travel: FloatArray
    bed: FloatArray
    sheets: FloatArray
    tof: TofState | None = None

    def as_camera(self) -> Camera:
        """The camera; raises `RigError` where the parameters make none."""
        fx, fy, cx, cy = self.camera[:4]
        return Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), self.size, self.camera[4:])

    def names(self) -> tuple[str, ...]:
        """Name of each element of `vector`."""
        names = [f"camera.{n}" for n in CAMERA]
        names += [f"travel.{n}" for n in "xyz"] + [f"bed.{n}" for n in "abc"]
        names += [f"sheet{k + 1}.{n}" for k in range(len(self.sheets)) for n in "abc"]
        if self.tof is not None:
            names += [f"tof.{n}" for n in TOF_NAMES]
        return tuple(names)

    def vector(self) -> FloatArray:
        """All parameters in one row."""
        parts = [self.camera, self.travel, self.bed, self.sheets.ravel()]
        if self.tof is not None:
            t = self.tof
            parts += [t.position, t.tilt, t.slide, np.array([t.gain, t.lag_s])]
        return np.concatenate(parts)

    def with_vector(self, values: FloatArray) -> "Scanner":
        """The same scanner with other parameters."""
        lasers = len(self.sheets)
        end = 15 + 3 * lasers
        tof = self.tof
        if tof is not None:
            v = values[end:]
            tof = replace(tof, position=v[:3], tilt=v[3:5], slide=v[5:8], gain=float(v[8]), lag_s=float(v[9]))
        return replace(
            self,
            camera=values[:9],
            travel=values[9:12],
            bed=values[12:15],
            sheets=values[15:end].reshape(lasers, 3),
            tof=tof,
        )

    def axes(self) -> FloatArray:
        """(3, 3) rotation from the camera to the bed: x along the travel in the plane, y across, z up."""
        up = -self.bed / np.linalg.norm(self.bed)
        x = self.travel - up * (up @ self.travel)
        x = x / np.linalg.norm(x)
        return np.stack([x, np.cross(up, x), up])

    def height_mm(self) -> float:
        """Height of the camera above the bed at cart position 0."""
        return 1.0 / float(np.linalg.norm(self.bed))

    def as_sheets(self) -> tuple[LaserSheet, ...]:
        """The laser sheets."""
        return tuple(
            LaserSheet(m / np.linalg.norm(m), 1.0 / float(np.linalg.norm(m)), side)
            for m, side in zip(self.sheets, self.sides, strict=True)
        )

    def as_tof(self, range_mm: tuple[float, float]) -> TofMount | None:
        """The ToF mount in the bed frame."""
        if self.tof is None:
            return None
        axes, t = self.axes(), self.tof
        position = axes @ t.position + np.array([0.0, 0.0, self.height_mm()])
        beam = axes @ t.beam
        lag = max(t.lag_s, 0.0)
        return TofMount(position, beam / np.linalg.norm(beam), axes @ t.slide, t.gain, t.offset, range_mm, lag)


@dataclass(frozen=True, eq=False)
class LaserSamples:
    """Points of one laser under a scanner, with all that their derivatives need.

    Attributes
    ----------
    rays : (n, 3) array
        Scaled to z = 1; NaN where the lens gives none.
    points : (n, 3) array
        In the camera's frame at cart position 0; NaN where the ray does not meet the sheet.
    """

    laser: int
    cart_mm: FloatArray
    rays: FloatArray
    points: FloatArray
    depth: FloatArray

    def take(self, rows: IntArray | BoolArray) -> "LaserSamples":
        """Some of the points."""
        return LaserSamples(self.laser, self.cart_mm[rows], self.rays[rows], self.points[rows], self.depth[rows])


def laser_samples(scanner: Scanner, laser: int, stripes: StripePoints, camera: Camera | None = None) -> LaserSamples:
    """Where one laser's stripes lie."""
    rays = (camera or scanner.as_camera()).rays(stripes.pixels)
    inverse = rays @ scanner.sheets[laser]
    depth = 1.0 / np.where(inverse > 1e-9, inverse, np.nan)
    return LaserSamples(
        laser, stripes.cart_mm, rays, rays * depth[:, None] + scanner.travel * stripes.cart_mm[:, None], depth
    )


def laser_jacobian(scanner: Scanner, samples: LaserSamples, normals: FloatArray) -> FloatArray:
    """Derivative of ``normal . point`` by every parameter, (n, parameters).

    Parameters
    ----------
    normals : (n, 3) array
        Fixed directions in the camera's frame.
    """
    out = np.zeros((len(samples.depth), len(scanner.vector())))
    by_x, by_y = _by_ray(scanner, samples, normals)
    x_by, y_by = _ray_by_camera(scanner, samples.rays)
    out[:, :9] = by_x[:, None] * x_by + by_y[:, None] * y_by
    out[:, 9:12] = normals * samples.cart_mm[:, None]
    along = np.einsum("ij,ij->i", normals, samples.rays)
    start = 15 + 3 * samples.laser
    out[:, start : start + 3] = -(samples.depth**2 * along)[:, None] * samples.rays
    return out


def laser_gain(scanner: Scanner, samples: LaserSamples, normals: FloatArray) -> FloatArray:
    """How far ``normal . point`` moves per pixel of the stripe's centre, (n,) in mm/px."""
    by_x, by_y = _by_ray(scanner, samples, normals)
    a, b, d = distort_jacobian(samples.rays[:, 0], samples.rays[:, 1], scanner.camera[4:])
    determinant = a * d - b * b
    fx, fy = scanner.camera[:2]
    if scanner.stripe_runs == "along-u":
        return np.asarray(np.abs(-b * by_x + a * by_y) / (determinant * fy))
    return np.asarray(np.abs(d * by_x - b * by_y) / (determinant * fx))


def _by_ray(scanner: Scanner, samples: LaserSamples, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of ``normal . point`` by the ray's x and y."""
    a, b, _ = scanner.sheets[samples.laser]
    along = np.einsum("ij,ij->i", normals, samples.rays)
    z = samples.depth
    return normals[:, 0] * z - z**2 * a * along, normals[:, 1] * z - z**2 * b * along


def _ray_by_camera(scanner: Scanner, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of a fixed pixel's undistorted x, y by the camera, each (n, 9) (implicit function theorem)."""
    x, y = rays[:, 0], rays[:, 1]
    fx, fy = scanner.camera[:2]
    a, b, d = distort_jacobian(x, y, scanner.camera[4:])
    determinant = a * d - b * b
    pixel = camera_jacobian(x, y, scanner.camera)
    u, v = pixel[:, 0] / fx, pixel[:, 1] / fy
    return (
        -(d[:, None] * u - b[:, None] * v) / determinant[:, None],
        -(a[:, None] * v - b[:, None] * u) / determinant[:, None],
    )


@dataclass(frozen=True, eq=False)
class TofPoints:
    """ToF readings that follow on another one.

    Attributes
    ----------
    reading, change : (n,) arrays
        In the recording's unit, and by how much it is more than the reading before.
    step_s : (n,) array
        Time since that one.
    """

    cart_mm: FloatArray
    slide_mm: FloatArray
    reading: FloatArray
    change: FloatArray
    step_s: FloatArray

    def __len__(self) -> int:
        return len(self.reading)

    def take(self, rows: IntArray | BoolArray) -> "TofPoints":
        """Some of the points."""
        return TofPoints(
            self.cart_mm[rows], self.slide_mm[rows], self.reading[rows], self.change[rows], self.step_s[rows]
        )

    def corrected(self, lag_s: float) -> tuple[FloatArray, FloatArray]:
        """Readings freed from the lag, and their derivative by it per second."""
        if lag_s <= 0:
            return self.reading, np.zeros(len(self))
        ratio = np.minimum(self.step_s / lag_s, 50.0)
        growth = np.expm1(ratio)
        factor = 1.0 / growth
        return self.reading + factor * self.change, self.change * np.exp(ratio) * factor**2 * ratio / lag_s


def tof_points(scanner: Scanner, tof: TofPoints) -> FloatArray:
    """Where the ToF sensor's points lie, (n, 3) in the camera's frame at cart position 0."""
    t = _tof(scanner)
    distance = t.offset + t.gain * tof.corrected(t.lag_s)[0]
    return np.asarray(
        t.position
        + scanner.travel * tof.cart_mm[:, None]
        + t.slide * tof.slide_mm[:, None]
        + t.beam * distance[:, None]
    )


def tof_jacobian(scanner: Scanner, tof: TofPoints, normals: FloatArray) -> FloatArray:
    """Derivative of ``normal . point`` by every parameter, (n, parameters)."""
    t = _tof(scanner)
    corrected, by_lag = tof.corrected(t.lag_s)
    distance = t.offset + t.gain * corrected
    direction = t.beam_axes[2] + t.tilt @ t.beam_axes[:2]
    length = float(np.linalg.norm(direction))
    beam = direction / length
    along = normals @ beam
    out = np.zeros((len(tof), len(scanner.vector())))
    out[:, 9:12] = normals * tof.cart_mm[:, None]
    start = 15 + 3 * len(scanner.sheets)
    out[:, start : start + 3] = normals
    for i in (0, 1):
        turn = (t.beam_axes[i] - beam * (beam @ t.beam_axes[i])) / length
        out[:, start + 3 + i] = (normals @ turn) * distance
    out[:, start + 5 : start + 8] = normals * tof.slide_mm[:, None]
    out[:, start + 8] = along * corrected
    out[:, start + 9] = along * t.gain * by_lag
    return out


def _tof(scanner: Scanner) -> TofState:
    if scanner.tof is None:
        raise RigError("The scanner has no ToF sensor.")
    return scanner.tof


def bed_height(scanner: Scanner, points: FloatArray) -> FloatArray:
    """Height of points (n, 3) above the bed plane, in mm."""
    return np.asarray((1.0 - points @ scanner.bed) / np.linalg.norm(scanner.bed))


def bed_jacobian(scanner: Scanner, points: FloatArray) -> FloatArray:
    """Derivative of `bed_height` by the bed's three parameters at fixed points, (n, 3)."""
    size = float(np.linalg.norm(scanner.bed))
    unit = scanner.bed / size
    return np.asarray(-points / size - bed_height(scanner, points)[:, None] * unit / size)
