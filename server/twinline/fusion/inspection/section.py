"""Cross-sections of clouds and of meshes."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.plane import axes_across
from twinline.fusion.mesh import TriangleMesh


@dataclass(frozen=True, eq=False)
class CrossSection:
    """Points near a plane, as seen in it.

    Attributes
    ----------
    profile_mm : (m, 2) array
        Distance along the section and height across it, in the order of the distance.
    sigma_mm : (m,) array
        Standard deviation of the height; NaN where the cloud did not give it.
    axes : (2, 3) array
        Directions of the two coordinates.
    used : (m,) int array
        Rows of the points, in the profile's order.
    """

    profile_mm: FloatArray
    sigma_mm: FloatArray
    axes: FloatArray
    used: IntArray


def section_axes(normal: FloatArray) -> FloatArray:
    """The two directions in which a section is drawn: along it, and upwards as far as the plane allows.

    Raises
    ------
    InputError
        If the normal has no direction.
    """
    length = float(np.linalg.norm(normal))
    if not np.isfinite(length) or length == 0.0:
        raise InputError("The section's normal has no direction; give three numbers that are not all zero.")
    unit = np.asarray(normal, dtype=np.float64) / length
    up = np.array([0.0, 0.0, 1.0]) - unit[2] * unit
    if np.linalg.norm(up) < 1e-9:
        return axes_across(unit)
    up = up / np.linalg.norm(up)
    return np.stack([np.cross(up, unit), up])


def cross_section(
    points_mm: FloatArray,
    point_mm: FloatArray,
    normal: FloatArray,
    *,
    thickness_mm: float = 0.5,
    sigma_mm: FloatArray | None = None,
) -> CrossSection:
    """The points within half a thickness of a plane, seen in it.

    Parameters
    ----------
    points_mm : (n, 3) array
        NaN means "no measurement".
    point_mm : (3,) array
        Point of the plane, the origin of the profile.
    normal : (3,) array
        Of the plane, of any length.
    thickness_mm
        Of the slice.
    sigma_mm : (n,) array, optional
        Standard deviation of each point.

    Raises
    ------
    InputError
        ``too-few-points`` if no point lies in the slice.
    """
    axes = section_axes(normal)
    unit = np.cross(axes[0], axes[1])
    offset = np.asarray(points_mm, dtype=np.float64) - point_mm
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero(np.abs(offset @ unit) <= thickness_mm / 2)
    if not len(near):
        raise InputError(
            f"No point lies within {thickness_mm / 2:g} mm of the section; move it or make it thicker.",
            code="too-few-points",
        )
    profile = offset[near] @ axes.T
    order = np.argsort(profile[:, 0], kind="stable")
    used = near[order]
    sigma = np.full(len(used), np.nan) if sigma_mm is None else np.asarray(sigma_mm, dtype=np.float64)[used]
    return CrossSection(profile[order], sigma, axes, used)


def mesh_section(mesh: TriangleMesh, point_mm: FloatArray, normal: FloatArray) -> FloatArray:
    """Where a plane cuts a mesh: (k, 2, 2) ends of segments in the coordinates of `section_axes`.

    Each triangle that the plane crosses gives one segment; one that only touches it gives none.
    """
    axes = section_axes(normal)
    unit = np.cross(axes[0], axes[1])
    corners = mesh.corners_mm() - point_mm
    height = corners @ unit
    # A corner in the plane counts as above it, so that neighbours agree and outlines close.
    above = height >= 0.0
    crossed = above.any(axis=1) & ~above.all(axis=1)
    corners, height, above = corners[crossed], height[crossed], above[crossed]
    # The corner that is alone on its side comes first.
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    order = (alone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, order[..., None], axis=1)
    height = np.take_along_axis(height, order, axis=1)
    share = height[:, :1] / (height[:, :1] - height[:, 1:])
    ends = corners[:, :1] + share[..., None] * (corners[:, 1:] - corners[:, :1])
    return np.asarray(ends @ axes.T)
