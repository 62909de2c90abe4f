"""Triangulation: from stripe centres in the image to points in the bed frame, with their uncertainty.

A pixel's undistorted ray ``r = (x, y, 1)`` meets the sheet ``n . p = offset`` at ``p = r Z`` with ``1/Z = m . r`` and
``m = n / offset`` (the inverse-depth parameters a, b, c). In the bed frame that is
``bed_from_camera p + travel * cart_mm``.

Only the coordinate across the stripe is measured (v for stripes that run along u): the other one is an exact column
or row number. All derivatives are analytic:

    dp/dx = Z e_x - Z^2 a r        dp/dy = Z e_y - Z^2 b r        d(x, y)/d(xd, yd) = inverse lens Jacobian

A rotation changes no length, so ``sigma = |dp/dpixel| * sd_px`` holds in either frame.
"""

from typing import NamedTuple

import numba
import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError
from twinline.geometry.camera import Camera, distort_jacobian, lens_jacobian, undistort_point, undistort_together
from twinline.geometry.rig import Rig
from twinline.geometry.sheet import LaserSheet

_PARALLEL = 1e-12


class PackedLaser(NamedTuple):
    """What triangulation with one laser needs of a rig, as tuples of numbers that compiled code takes at no cost.

    Attributes
    ----------
    focal_centre
        fx, fy, cx, cy in pixels.
    distortion
        k1, k2, p1, p2, k3.
    radius2_limit
        See `twinline.geometry.camera.Camera`.
    inverse_depth
        a, b, c of the sheet, per millimetre.
    rotation, translation
        Of bed_from_camera: nine numbers row by row, and three in millimetres.
    travel
        Bed millimetres per commanded millimetre.
    along_u
        Whether the stripes run along u, so that v is measured.
    """

    focal_centre: tuple[float, ...]
    distortion: tuple[float, ...]
    radius2_limit: float
    inverse_depth: tuple[float, ...]
    rotation: tuple[float, ...]
    translation: tuple[float, ...]
    travel: tuple[float, ...]
    along_u: bool


def pack_laser(rig: Rig, laser: int) -> PackedLaser:
    """Plain numbers of a rig and one of its lasers (counted from 0) for `stripe_point` and `stripe_points_packed`.

    Raises
    ------
    RigError
        The rig has no such laser.
    """
    _check_laser(rig, laser)
    camera, pose = rig.camera, rig.bed_from_camera
    return PackedLaser(
        (camera.fx, camera.fy, camera.cx, camera.cy),
        tuple(camera.distortion.tolist()),
        camera.radius2_limit,
        tuple(rig.sheets[laser].inverse_depth.tolist()),
        tuple(pose.rotation.ravel().tolist()),
        tuple(pose.translation_mm.tolist()),
        tuple(rig.travel.tolist()),
        rig.stripe_runs == "along-u",
    )


def intersect(sheet: LaserSheet, rays: FloatArray) -> FloatArray:
    """Points where rays from the camera centre meet a sheet.

    Parameters
    ----------
    rays : (n, 3) array
        Directions in the camera frame, of any length.

    Returns
    -------
    (n, 3) array
        Points in the camera frame, millimetres; NaN where a ray is parallel to the sheet or meets it behind the
        camera.
    """
    rays = np.asarray(rays, dtype=np.float64).reshape(-1, 3)
    towards = rays @ sheet.normal
    ahead = (towards > _PARALLEL * np.linalg.norm(rays, axis=1)) & (rays[:, 2] > 0)
    scale = sheet.offset_mm / np.where(ahead, towards, np.nan)
    return np.asarray(rays * scale[:, None])


@numba.njit(cache=True, error_model="numpy", inline="always")
def stripe_point(
    packed: PackedLaser, u: float, v: float, sd_px: float, cart_mm: float
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Bed coordinates and sigma of one stripe centre, all in millimetres; see `stripe_points`."""
    fx, fy, cx, cy = packed.focal_centre
    ma, mb, mc = packed.inverse_depth
    x, y = undistort_point((u - cx) * (1.0 / fx), (v - cy) * (1.0 / fy), packed.distortion, packed.radius2_limit)
    inverse_depth = ma * x + mb * y + mc
    # The rule of `intersect`, squared; NaN fails it too.
    parallel = _PARALLEL**2 * (ma * ma + mb * mb + mc * mc) * (x * x + y * y + 1.0)
    if not (inverse_depth > 0.0 and inverse_depth * inverse_depth > parallel):
        return np.nan, np.nan, np.nan, np.nan
    z = 1.0 / inverse_depth
    a, b, d = lens_jacobian(x, y, packed.distortion)
    determinant = a * d - b * b
    if packed.along_u:
        per_px = 1.0 / (determinant * fy)
        dx, dy = -b * per_px, a * per_px
    else:
        per_px = 1.0 / (determinant * fx)
        dx, dy = d * per_px, -b * per_px
    dz = -z * z * (ma * dx + mb * dy)
    px, py = dx * z + x * dz, dy * z + y * dz
    sigma = np.sqrt(px * px + py * py + dz * dz) * sd_px
    r, t, travel = packed.rotation, packed.translation, packed.travel
    xz, yz = x * z, y * z
    return (
        r[0] * xz + r[1] * yz + r[2] * z + t[0] + travel[0] * cart_mm,
        r[3] * xz + r[4] * yz + r[5] * z + t[1] + travel[1] * cart_mm,
        r[6] * xz + r[7] * yz + r[8] * z + t[2] + travel[2] * cart_mm,
        sigma,
    )


@numba.njit(cache=True, error_model="numpy")
def stripe_points_packed(
    packed: PackedLaser, pixels: FloatArray, sd_px: FloatArray, cart_mm: float
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """`stripe_points` on a packed laser, without checks, for hot loops and other compiled code."""
    n = pixels.shape[0]
    points = np.empty((n, 3))
    sigma = np.empty(n)
    for i in range(n):
        points[i, 0], points[i, 1], points[i, 2], sigma[i] = stripe_point(
            packed, pixels[i, 0], pixels[i, 1], sd_px[i], cart_mm
        )
    return points, sigma


@numba.njit(cache=True, error_model="numpy")
def stripe_points_together(
    packed: PackedLaser, u: FloatArray, v: FloatArray, sd_px: FloatArray, cart_mm: float
) -> FloatArray:  # pragma: no cover - compiled
    """`stripe_points` of a whole stripe: the same formulas with the loops inside out, so that they are vectorised.

    Parameters
    ----------
    u, v, sd_px : (n,) arrays

    Returns
    -------
    (5, n) array
        Bed coordinates x, y, z and sigma as `stripe_points` gives them, and the depth in the camera frame.
    """
    n = u.size
    fx, fy, cx, cy = packed.focal_centre
    ma, mb, mc = packed.inverse_depth
    per_fx, per_fy = 1.0 / fx, 1.0 / fy
    xd, yd = np.empty(n), np.empty(n)
    for i in range(n):
        xd[i], yd[i] = (u[i] - cx) * per_fx, (v[i] - cy) * per_fy
    x, y = undistort_together(xd, yd, packed.distortion, packed.radius2_limit)
    out = np.empty((5, n))
    bed_x, bed_y, bed_z, sigma, depth = out[0], out[1], out[2], out[3], out[4]
    r, t, travel = packed.rotation, packed.translation, packed.travel
    shift_x, shift_y, shift_z = t[0] + travel[0] * cart_mm, t[1] + travel[1] * cart_mm, t[2] + travel[2] * cart_mm
    parallel = _PARALLEL**2 * (ma * ma + mb * mb + mc * mc)
    for i in range(n):
        a, b, d = lens_jacobian(x[i], y[i], packed.distortion)
        inverse_depth = ma * x[i] + mb * y[i] + mc
        z = 1.0 / inverse_depth
        ahead = (inverse_depth > 0.0) & (inverse_depth * inverse_depth > parallel * (x[i] * x[i] + y[i] * y[i] + 1.0))
        z = z if ahead else np.nan
        per_px = 1.0 / ((a * d - b * b) * (fy if packed.along_u else fx))
        dx, dy = (-b * per_px, a * per_px) if packed.along_u else (d * per_px, -b * per_px)
        dz = -z * z * (ma * dx + mb * dy)
        px, py = dx * z + x[i] * dz, dy * z + y[i] * dz
        xz, yz = x[i] * z, y[i] * z
        bed_x[i] = r[0] * xz + r[1] * yz + r[2] * z + shift_x
        bed_y[i] = r[3] * xz + r[4] * yz + r[5] * z + shift_y
        bed_z[i] = r[6] * xz + r[7] * yz + r[8] * z + shift_z
        sigma[i] = np.sqrt(px * px + py * py + dz * dz) * sd_px[i]
        depth[i] = z
    return out


def stripe_points(
    rig: Rig, laser: int, pixels: FloatArray, sd_px: FloatArray, cart_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Points in the bed frame of one laser's stripe centres in one frame.

    Parameters
    ----------
    laser
        Index of the laser in ``rig.sheets``, from 0.
    pixels : (n, 2) array
        Stripe centres u, v; NaN where there is none.
    sd_px : (n,) array
        Standard deviation of each centre across the stripe (in v for stripes along u, in u for stripes along v).
    cart_mm
        Commanded position of the cart at the frame's mid-exposure.

    Returns
    -------
    points_in_bed : (n, 3) array
        Millimetres; NaN where there is no centre, or its ray does not meet the sheet in front of the camera.
    sigma_mm : (n,) array
        Standard deviation of each point along the direction in which it moves with the stripe's centre.

    Raises
    ------
    RigError
        The rig has no such laser.
    """
    packed = pack_laser(rig, laser)
    pixels = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    sd_px = np.ascontiguousarray(np.broadcast_to(np.asarray(sd_px, dtype=np.float64), len(pixels)))
    points, sigma = stripe_points_packed(packed, pixels, sd_px, float(cart_mm))
    return points, sigma


def point_covariance(rig: Rig, laser: int, pixels: FloatArray, cart_mm: float) -> FloatArray:
    """Covariance that the rig's own uncertainty gives to points: what no averaging over pixels removes.

    The pixels are taken as exact; the stripe's own variance is `stripe_points`' ``sigma_mm``. Pixel coordinates enter
    as in `stripe_points`.

    Returns
    -------
    (n, 3, 3) array
        mm^2 in the bed frame; NaN where there is no point, zero if the rig has no covariance.

    Raises
    ------
    RigError
        There is no such laser, or the covariance names a parameter that does not exist.
    """
    _check_laser(rig, laser)
    rays = rig.camera.rays(pixels)
    if rig.covariance is None:
        empty = np.zeros((len(rays), 3, 3))
        empty[np.isnan(intersect(rig.sheets[laser], rays)).any(axis=1)] = np.nan
        return empty
    columns = _parameter_derivatives(rig, laser, rays, cart_mm)
    nothing = np.zeros((len(rays), 3))
    jacobian = np.stack([columns.get(name, nothing) for name in _checked_names(rig, columns)], axis=2)
    return np.asarray(jacobian @ rig.covariance.matrix @ jacobian.transpose(0, 2, 1))


def _checked_names(rig: Rig, columns: dict[str, FloatArray]) -> tuple[str, ...]:
    names = rig.covariance.names if rig.covariance else ()
    others = tuple(f"sheet{number}." for number in range(1, len(rig.sheets) + 1))
    for name in names:
        group, _, part = name.partition(".")
        known = name in columns or group == "tof" or (f"{group}." in others and part in ("a", "b", "c"))
        if not known:
            raise RigError(f"The rig's covariance names {name!r}, which is no parameter of this rig.")
    return names


def _parameter_derivatives(rig: Rig, laser: int, rays: FloatArray, cart_mm: float) -> dict[str, FloatArray]:
    """Derivative of each bed point by each parameter, (n, 3) per name of `twinline.geometry.rig.Covariance`."""
    m = rig.sheets[laser].inverse_depth
    rotation = rig.bed_from_camera.rotation
    points = intersect(rig.sheets[laser], rays)
    z = points[:, 2:]
    unit = np.eye(3)
    # Columns of dp/dx, dp/dy in the bed frame.
    by_x, by_y = ((z * unit[i] - z**2 * m[i] * rays) @ rotation.T for i in (0, 1))
    derivatives = {
        name: dx[:, None] * by_x + dy[:, None] * by_y for name, (dx, dy) in _ray_derivatives(rig.camera, rays).items()
    }
    for i, name in enumerate("abc"):
        derivatives[f"sheet{laser + 1}.{name}"] = (-(z**2) * rays[:, i : i + 1] * rays) @ rotation.T
    turned = points @ rotation.T
    ones = np.where(np.isnan(z), np.nan, 1.0)
    for i, name in enumerate("xyz"):
        derivatives[f"bed.r{name}"] = np.cross(unit[i], turned)
        derivatives[f"bed.{name}"] = ones * unit[i]
        derivatives[f"travel.{name}"] = ones * unit[i] * cart_mm
    return derivatives


def _ray_derivatives(camera: Camera, rays: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Derivatives of a fixed pixel's undistorted x, y by the intrinsic parameters (implicit function theorem)."""
    x, y = rays[:, 0], rays[:, 1]
    r2 = x * x + y * y
    a, b, d = distort_jacobian(x, y, camera.distortion)
    determinant = a * d - b * b
    pixels = camera.project(rays)
    nothing = np.zeros_like(x)
    # How each parameter moves the distorted point away from the observed one.
    residuals = {
        "fx": ((pixels[:, 0] - camera.cx) / camera.fx**2, nothing),
        "fy": (nothing, (pixels[:, 1] - camera.cy) / camera.fy**2),
        "cx": (nothing + 1.0 / camera.fx, nothing),
        "cy": (nothing, nothing + 1.0 / camera.fy),
        "k1": (x * r2, y * r2),
        "k2": (x * r2**2, y * r2**2),
        "p1": (2.0 * x * y, r2 + 2.0 * y * y),
        "p2": (r2 + 2.0 * x * x, 2.0 * x * y),
        "k3": (x * r2**3, y * r2**3),
    }
    return {
        f"camera.{name}": (-(d * ex - b * ey) / determinant, -(a * ey - b * ex) / determinant)
        for name, (ex, ey) in residuals.items()
    }


def _check_laser(rig: Rig, laser: int) -> None:
    if not 0 <= laser < len(rig.sheets):
        raise RigError(f"Laser {laser + 1} was asked for, but the rig {rig.name!r} has {len(rig.sheets)}.")
