"""What a rig sees: where its stripes can lie in the image, from which depths, and whether two stripes stay apart.

A plane in the bed frame and a laser sheet meet in a line; its image without lens distortion is the straight line
``l . (x, y, 1) = 0`` in normalised coordinates. Everything here follows that line through the lens to one position per
image column (stripes along u) or row (stripes along v), here called a lane. The closed two-parameter forms of the
same quantities are in `twinline.geometry.two_parameter`.
"""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import RigError
from twinline.geometry.camera import Camera, distort, distort_jacobian
from twinline.geometry.rig import Rig
from twinline.geometry.sheet import LaserSheet

_NEWTON_STEPS = 30


def stripe_positions(rig: Rig, laser: int, z_bed_mm: float) -> FloatArray:
    """Where one laser's stripe crosses each lane on the plane z = ``z_bed_mm`` of the bed frame.

    The camera and the lasers ride on the cart, so the cart's position does not matter as long as the travel is
    parallel to the bed.

    Parameters
    ----------
    laser
        Index of the laser in ``rig.sheets``, from 0.

    Returns
    -------
    (lanes,) array
        v for each image column (stripes along u) or u for each row (stripes along v), pixels, also outside the
        image. Where the plane is too far outside for the lens model, plus or minus infinity.

    Raises
    ------
    RigError
        There is no such laser, or the camera stands below the plane.
    """
    if not 0 <= laser < len(rig.sheets):
        raise RigError(f"Laser {laser + 1} was asked for, but the rig {rig.name!r} has {len(rig.sheets)}.")
    height_mm = float(rig.bed_from_camera.translation_mm[2])
    if not z_bed_mm < height_mm:
        raise RigError(
            f"The height {z_bed_mm:g} mm is not below the camera at {height_mm:g} mm above the bed: "
            "give a lower height, or correct bed_from_camera."
        )
    # up . r Z = z - height and 1/Z = m . r
    up = rig.bed_from_camera.rotation[2]
    return _trace(rig, up - (z_bed_mm - height_mm) * rig.sheets[laser].inverse_depth)


def stripe_rows(rig: Rig, laser: int, z_bed_min_mm: float, z_bed_max_mm: float) -> tuple[IntArray, IntArray]:
    """Band of the image in which one laser's stripe lies on surfaces between two heights above the bed.

    Returns
    -------
    low, high : (lanes,) int arrays
        For each image column the rows ``low <= v < high`` (stripes along u), or for each row the columns
        ``low <= u < high`` (stripes along v), clipped to the image. ``low == high`` where the image holds none of it.

    Raises
    ------
    RigError
        As `stripe_positions`, or the heights do not ascend.
    """
    if not z_bed_min_mm <= z_bed_max_mm:
        raise RigError(f"The heights {z_bed_min_mm:g} to {z_bed_max_mm:g} mm must ascend.")
    ends = [stripe_positions(rig, laser, z) for z in (z_bed_min_mm, z_bed_max_mm)]
    across = rig.camera.size[1 if rig.stripe_runs == "along-u" else 0]
    low = np.clip(np.floor(np.minimum(*ends)), 0, across)
    high = np.clip(np.ceil(np.maximum(*ends)) + 1, 0, across)
    return low.astype(np.int64), np.maximum(low, high).astype(np.int64)


def depth_limits(rig: Rig, laser: int) -> tuple[FloatArray, FloatArray]:
    """Nearest and farthest depth from the camera at which one laser's stripe is in the image (3.14-3.19 in full).

    Returns
    -------
    near_mm, far_mm : (lanes,) arrays
        Camera-frame depths at the first and last pixel of each column (stripes along u) or row (stripes along v);
        ``far_mm`` is infinite where the sheet stays in view for ever; both are NaN where it is never in view. The bed
        may end the range before.
    """
    if not 0 <= laser < len(rig.sheets):
        raise RigError(f"Laser {laser + 1} was asked for, but the rig {rig.name!r} has {len(rig.sheets)}.")
    along_u = rig.stripe_runs == "along-u"
    width, height = rig.camera.size
    lanes, last = (width, height - 1) if along_u else (height, width - 1)
    inverse = []
    for edge in (0, last):
        pixels = np.column_stack([np.arange(lanes), np.full(lanes, edge)])
        inverse.append(rig.camera.rays(pixels if along_u else pixels[:, ::-1]) @ rig.sheets[laser].inverse_depth)
    largest, smallest = np.maximum(*inverse), np.minimum(*inverse)
    near = 1.0 / np.where(largest > 0, largest, np.nan)
    far = 1.0 / np.where(smallest > 0, smallest, np.nan)
    # The sheet runs out of sight towards the horizon, not over the edge.
    return near, np.where((largest > 0) & (smallest <= 0), np.inf, far)


def axis_depth_mm(sheet: LaserSheet) -> float:
    """Depth at which a sheet crosses the optical axis, ``d tan(theta)``; infinite if it never does."""
    along_axis = float(sheet.normal[2])
    return sheet.offset_mm / along_axis if along_axis > 0 else float("inf")


def meeting_depths(rig: Rig) -> FloatArray:
    """Depths from the camera at which the two sheets meet within the field of view.

    Returns
    -------
    (lanes,) array
        Per image column or row; NaN where the stripes do not cross inside the image in front of the camera.

    Raises
    ------
    RigError
        The rig has one laser.
    """
    if len(rig.sheets) != 2:
        raise RigError(f"The rig {rig.name!r} has one laser: no stripes can cross.")
    first, second = (sheet.inverse_depth for sheet in rig.sheets)
    positions = _trace(rig, first - second)
    along_u = rig.stripe_runs == "along-u"
    inside = (positions >= 0) & (positions <= rig.camera.size[1 if along_u else 0] - 1)
    pixels = np.column_stack([np.arange(len(positions)), np.where(inside, positions, np.nan)])
    inverse = rig.camera.rays(pixels if along_u else pixels[:, ::-1]) @ first
    return np.asarray(1.0 / np.where(inverse > 0, inverse, np.nan))


@dataclass(frozen=True)
class StripeSeparation:
    """Whether the stripes of two lasers can be told apart by their place in the image.

    Attributes
    ----------
    separable
        The stripes keep their order in every lane, down to the margin below the lowest surface.
    axis_depths_mm
        For each laser the depth ``d tan(theta)`` at which its sheet crosses the optical axis.
    meeting_depth_mm
        Smallest depth at which the sheets meet within the field of view; infinite if they do not.
    lowest_depth_mm
        Depth of the lowest surface on the optical axis.
    gap_px
        Smallest distance of the two stripes on the lowest surface; negative where they have changed places.
    sentence
        The verdict for people.
    """

    separable: bool
    axis_depths_mm: tuple[float, ...]
    meeting_depth_mm: float
    lowest_depth_mm: float
    gap_px: float
    sentence: str

    def require(self) -> None:
        """Raise RigError with the verdict if the stripes cannot be told apart."""
        if not self.separable:
            raise RigError(self.sentence)


def check_stripes_separable(rig: Rig, *, lowest_mm: float = 0.0, margin_mm: float = 10.0) -> StripeSeparation:
    """Check that two stripes cannot change places on any surface.

    A higher surface moves the stripes apart, so only the lowest one decides, however high the objects are.

    Parameters
    ----------
    lowest_mm
        Height of the lowest surface in the bed frame; the bed itself is 0.
    margin_mm
        How far below it the stripes must still be in order.
    """
    axis_depths = tuple(axis_depth_mm(sheet) for sheet in rig.sheets)
    up, height = rig.bed_from_camera.rotation[2], float(rig.bed_from_camera.translation_mm[2])
    lowest_depth = float((lowest_mm - height) / up[2]) if up[2] < 0 else float("nan")
    if len(rig.sheets) < 2:
        return StripeSeparation(
            True, axis_depths, float("inf"), lowest_depth, float("inf"), "With one laser there is no second stripe."
        )
    meeting = meeting_depths(rig)
    nearest = float(np.nanmin(meeting)) if np.isfinite(meeting).any() else float("inf")
    gap, gap_below = (_smallest_gap_px(rig, z) for z in (lowest_mm, lowest_mm - margin_mm))
    separable = gap > 0 and gap_below > 0
    where = f"cross {nearest:.0f} mm from the camera" if np.isfinite(nearest) else "cross outside the image"
    surface = f"lowest surface at {lowest_depth:.0f} mm"
    if separable:
        sentence = f"The stripes {where}, beyond the {surface}, where they are at least {gap:.0f} px apart."
    else:
        side = "before" if gap <= 0 else f"less than {margin_mm:g} mm beyond"
        sentence = (
            f"The stripes {where}, {side} the {surface}, so they cannot be told apart near it: alternate the lasers "
            "frame by frame (1, 2, 1, 2), use one laser, or change a laser's angle or baseline."
        )
    return StripeSeparation(separable, axis_depths, nearest, lowest_depth, gap, sentence)


def _smallest_gap_px(rig: Rig, z_bed_mm: float) -> float:
    first, second = (stripe_positions(rig, laser, z_bed_mm) for laser in (0, 1))
    across = rig.camera.size[1 if rig.stripe_runs == "along-u" else 0]
    # A stripe that is far outside the image on its own side is as far apart as one at the edge.
    first, second = (np.clip(positions, -across, 2 * across) for positions in (first, second))
    sign = 1.0 if rig.sheets[0].side[0] == "+" else -1.0
    return float(np.min(sign * (first - second)))


def _trace(rig: Rig, line: FloatArray) -> FloatArray:
    """Pixel position in each lane of the undistorted image line ``line . (x, y, 1) = 0``."""
    camera = rig.camera
    along_u = rig.stripe_runs == "along-u"
    width, height = camera.size
    lanes = np.arange(width if along_u else height, dtype=np.float64)
    centre, focal = (camera.cx, camera.fx) if along_u else (camera.cy, camera.fy)
    target = (lanes - centre) / focal
    # Across the stripe: other = offset + slope * along.
    lane_part, across_part = (line[0], line[1]) if along_u else (line[1], line[0])
    if abs(across_part) <= 1e-9 * float(np.linalg.norm(line)):
        raise RigError(
            f"A stripe of the rig {rig.name!r} would run across the image lanes, not {rig.stripe_runs}: "
            "check stripe_runs and the sheets."
        )
    offset, slope = -line[2] / across_part, -lane_part / across_part
    return _follow(camera, along_u, target, float(offset), float(slope))


def _follow(camera: Camera, along_u: bool, target: FloatArray, offset: float, slope: float) -> FloatArray:
    k = camera.distortion
    along = target.copy()
    for _ in range(_NEWTON_STEPS):
        across = offset + slope * along
        x, y = (along, across) if along_u else (across, along)
        xd, yd = distort(x, y, k)
        a, b, d = distort_jacobian(x, y, k)
        derivative = a + b * slope if along_u else d + b * slope
        with np.errstate(divide="ignore", invalid="ignore"):
            step = ((xd if along_u else yd) - target) / np.where(derivative > 1e-6, derivative, np.nan)
        along = along - step
        if not np.nanmax(np.abs(step), initial=0.0) > 1e-12:
            break
    across = offset + slope * along
    x, y = (along, across) if along_u else (across, along)
    pixels = camera.project(np.column_stack([x, y, np.ones(len(x))]))[:, 1 if along_u else 0]
    outside = np.where(offset + slope * target > 0, np.inf, -np.inf)
    return np.where(np.isfinite(pixels), pixels, outside)
