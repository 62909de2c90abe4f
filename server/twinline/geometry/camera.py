"""The camera: a pinhole with the five-parameter radial and tangential lens distortion.

Pixels have their centre at the integer, ``u`` to the right and ``v`` down. The camera frame is x right, y down, z
forward, in millimetres. The lens model is D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering
37 (1971), in the form and order of coefficients ``(k1, k2, p1, p2, k3)`` that OpenCV uses.
"""

from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError

_UNDISTORT_STEPS = 20
_STEPS_TOGETHER = 5

Coefficients = FloatArray | tuple[float, ...]
"""Lens distortion k1, k2, p1, p2, k3; compiled code is faster with a tuple."""


@numba.njit(cache=True, inline="always")
def distort_point(x: float, y: float, k: Coefficients) -> tuple[float, float]:  # pragma: no cover - compiled
    """Distorted normalised coordinates of one undistorted point."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    xd = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x)
    yd = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
    return xd, yd


@numba.njit(cache=True, inline="always")
def lens_jacobian(x: float, y: float, k: Coefficients) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Derivatives dxd/dx, dxd/dy = dyd/dx, and dyd/dy of the distorted by the undistorted coordinates."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]))
    a = radial + x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
    b = x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
    d = radial + y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
    return a, b, d


@numba.njit(cache=True, error_model="numpy", inline="always")
def undistort_point(
    xd: float, yd: float, k: Coefficients, radius2_limit: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Undistorted normalised coordinates of one distorted point, by Newton's method; NaN where no ray belongs to it.

    The fixed-point iteration in common use needs 5 to 20 steps at the image corners; Newton needs 2 to 4.
    ``radius2_limit`` is `Camera.radius2_limit`.
    """
    # The first terms of the inverse series save two Newton steps; where they are no use, start at the point itself.
    r2 = xd * xd + yd * yd
    start = 1.0 - r2 * (k[0] - r2 * (3.0 * k[0] * k[0] - k[1]))
    if not 0.8 < start < 1.25:
        start = 1.0
    if r2 * start * start >= radius2_limit:
        start = 0.9 * np.sqrt(radius2_limit / r2)
    x, y = xd * start, yd * start
    for _ in range(_UNDISTORT_STEPS):
        fx, fy = distort_point(x, y, k)
        a, b, d = lens_jacobian(x, y, k)
        ex, ey = fx - xd, fy - yd
        determinant = a * d - b * b
        if not determinant > 1e-9:
            return np.nan, np.nan
        scale = 1.0 / determinant
        dx = (d * ex - b * ey) * scale
        dy = (a * ey - b * ex) * scale
        x -= dx
        y -= dy
        # Convergence is quadratic: after a step of 1e-8 the error is that of rounding.
        if dx * dx + dy * dy < 1e-16:
            if x * x + y * y < radius2_limit:
                return x, y
            return np.nan, np.nan
    return np.nan, np.nan


@numba.njit(cache=True, error_model="numpy")
def undistort_together(
    xd: FloatArray, yd: FloatArray, k: Coefficients, radius2_limit: float
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """`undistort_point` of many points, each Newton step for all of them: such loops are vectorised.

    Parameters
    ----------
    xd, yd : (n,) arrays
        Distorted normalised coordinates.

    Returns
    -------
    x, y : (n,) arrays
        Undistorted; NaN where no ray belongs to a point.
    """
    n = xd.size
    x, y, step2 = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        r2 = xd[i] * xd[i] + yd[i] * yd[i]
        start = 1.0 - r2 * (k[0] - r2 * (3.0 * k[0] * k[0] - k[1]))
        x[i], y[i] = xd[i] * start, yd[i] * start
    for _ in range(_STEPS_TOGETHER):
        left = 0
        for i in range(n):
            fx, fy = distort_point(x[i], y[i], k)
            a, b, d = lens_jacobian(x[i], y[i], k)
            ex, ey = fx - xd[i], fy - yd[i]
            scale = 1.0 / (a * d - b * b)
            dx, dy = (d * ex - b * ey) * scale, (a * ey - b * ex) * scale
            x[i] -= dx
            y[i] -= dy
            step2[i] = dx * dx + dy * dy
            left += int(step2[i] >= 1e-16)
        if left == 0:
            break
    for i in range(n):
        # What is far out, or did not settle, goes the careful way.
        if not (step2[i] < 1e-16 and x[i] * x[i] + y[i] * y[i] < radius2_limit):
            x[i], y[i] = undistort_point(xd[i], yd[i], k, radius2_limit)
    return x, y


@numba.njit(cache=True, error_model="numpy")
def _undistort(
    normalised: FloatArray, k: FloatArray, radius2_limit: float
) -> FloatArray:  # pragma: no cover - compiled
    out = np.empty((normalised.shape[0], 2))
    for i in range(normalised.shape[0]):
        out[i, 0], out[i, 1] = undistort_point(normalised[i, 0], normalised[i, 1], k, radius2_limit)
    return out


def _radius2_limit(k: FloatArray) -> float:
    """Squared radius where r (1 + k1 r^2 + k2 r^4 + k3 r^6) first stops growing; infinite if it never does."""
    # In 1 / r^2 the leading coefficient is 1 however small the lens coefficients are.
    roots = np.roots([1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[4]])
    turning = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 1e-12)]
    return float(1.0 / turning.max()) if len(turning) else float("inf")


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsic parameters of a camera.

    Attributes
    ----------
    matrix : (3, 3) array
        Camera matrix, pixels.
    distortion : (5,) array
        Lens distortion k1, k2, p1, p2, k3.
    size : (int, int)
        Width and height of the image in pixels.
    radius2_limit
        Squared undistorted radius (of x/z, y/z) up to which the lens model is one-to-one. Beyond it the polynomial
        folds back into the image, so there neither rays nor image points are given.
    """

    matrix: FloatArray
    size: tuple[int, int]
    distortion: FloatArray = field(default_factory=lambda: np.zeros(5))
    radius2_limit: float = field(init=False)

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=np.float64)
        distortion = np.array(self.distortion, dtype=np.float64).ravel()
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or min(matrix[0, 0], matrix[1, 1]) <= 0:
            raise RigError("The camera matrix must be 3 x 3 finite numbers with positive focal lengths.")
        if np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]] != 0.0) or matrix[2, 2] != 1.0:
            raise RigError("The camera matrix must have the form [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], without skew.")
        if distortion.shape != (5,) or not np.isfinite(distortion).all():
            raise RigError("The lens distortion must be the five finite numbers k1, k2, p1, p2, k3.")
        if len(self.size) != 2 or min(self.size) < 1:
            raise RigError("The image size must be two positive whole numbers, width and height.")
        for name, value in (("matrix", matrix), ("distortion", distortion)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        object.__setattr__(self, "radius2_limit", _radius2_limit(distortion))

    @property
    def fx(self) -> float:
        """Focal length along u, pixels."""
        return float(self.matrix[0, 0])

    @property
    def fy(self) -> float:
        """Focal length along v, pixels."""
        return float(self.matrix[1, 1])

    @property
    def cx(self) -> float:
        """Principal point along u, pixels."""
        return float(self.matrix[0, 2])

    @property
    def cy(self) -> float:
        """Principal point along v, pixels."""
        return float(self.matrix[1, 2])

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Directions, scaled to z = 1, in which the camera sees the given pixels.

        Parameters
        ----------
        pixels : (n, 2) array
            Image points u, v; NaN gives NaN.

        Returns
        -------
        (n, 3) array
            Rays in the camera frame; NaN where the lens model gives a pixel no ray.
        """
        pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        normalised = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        return np.column_stack([_undistort(normalised, self.distortion, self.radius2_limit), np.ones(len(pixels))])

    def project(self, points_in_camera: FloatArray) -> FloatArray:
        """Image points of points in the camera frame.

        Parameters
        ----------
        points_in_camera : (n, 3) array
            Millimetres.

        Returns
        -------
        (n, 2) array
            Pixels u, v; NaN for points that are not in front of the camera or where the lens model folds back.
        """
        points = np.asarray(points_in_camera, dtype=np.float64).reshape(-1, 3)
        z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        x, y = points[:, 0] / z, points[:, 1] / z
        x = np.where(x * x + y * y < self.radius2_limit, x, np.nan)
        xd, yd = distort(x, y, self.distortion)
        return np.column_stack([self.fx * xd + self.cx, self.fy * yd + self.cy])


def distort(x: FloatArray, y: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`distort_point` on whole arrays of equal shape."""
    formula: Any = distort_point.py_func
    xd, yd = formula(x, y, k)
    return xd, yd


def distort_jacobian(x: FloatArray, y: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`lens_jacobian` on whole arrays of equal shape."""
    formula: Any = lens_jacobian.py_func
    a, b, d = formula(x, y, k)
    return a, b, d
