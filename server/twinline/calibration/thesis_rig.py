"""The results of the thesis's methods as rigs, to be used and compared like any other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.thesis_align import LaserShift, TofAlignment
from twinline.calibration.thesis_fit import SheetFit
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera
from twinline.geometry.nominal import nominal_pose
from twinline.geometry.rig import Rig, Transform

_LARGEST_SCALE_CHANGE = 0.03
_SMALLEST_SEPARATION_MM = 10.0


def apply_sheets(rig: Rig, fits: Sequence[SheetFit]) -> Rig:
    """Rig with the fitted sheets and everything that the two-parameter model takes for granted.

    The camera looks exactly down from its height in ``rig``, and the lens has no distortion where the fits ignored it:
    with any other pose or rays the fitted sheets would not give the depths that were fitted. The covariance of another
    calibration no longer holds and is left out.

    Raises
    ------
    CalibrationError
        ``bad-fits`` if there is not one fit per laser, of its side and with the same treatment of the lens.
    """
    sides, lenses = [f.sheet.side for f in fits], {f.lens for f in fits}
    if sides != [s.side for s in rig.sheets] or len(lenses) != 1:
        raise CalibrationError(
            f"The fits are of lasers on the sides {', '.join(sides) or 'none'} (lens {', '.join(sorted(lenses))}), and "
            f"the rig's are on {', '.join(s.side for s in rig.sheets)}: fit every laser, with the same lens setting.",
            code="bad-fits",
        )
    camera = rig.camera if lenses == {"undistorted"} else Camera(rig.camera.matrix, rig.camera.size)
    old = rig.bed_from_camera.translation_mm
    pose = nominal_pose(rig.stripe_runs, float(old[2]))
    points = ", ".join(str(len(f.points)) for f in fits)
    sources = {
        "sheets": f"thesis: Nelder-Mead on baseline and angle against ToF at {points} points",
        "bed_from_camera": "thesis: taken to look exactly down",
    }
    if camera is not rig.camera:
        sources["camera"] = f"{rig.sources.get('camera', 'given')}; thesis: without lens distortion"
    return replace(
        rig,
        camera=camera,
        sheets=tuple(f.sheet for f in fits),
        bed_from_camera=Transform(pose.rotation, np.array([old[0], old[1], old[2]])),
        covariance=None,
        sources={**rig.sources, **sources},
    )


def stripe_separation_mm(rig: Rig, depth_mm: float) -> float:
    """Distance X1 - X2 of the stripes along the travel, at a depth below the camera.

    ``d1 + d2 - Z (cot(theta1) + cot(theta2))`` by (3.3-3.13), positive where laser 1's stripe is ahead.
    """
    first, second = rig.sheets
    value = sum(s.baseline_mm - depth_mm / float(np.tan(s.angle_rad)) for s in (first, second))
    # Laser 1 is ahead if a point moved towards its side moves along +travel.
    axis = "uv".index(first.side[1])
    ahead = rig.bed_from_camera.rotation[:, axis] @ rig.travel * (1.0 if first.side[0] == "+" else -1.0)
    return value if ahead > 0 else -value


def apply_laser_shift(rig: Rig, shift: LaserShift) -> Rig:
    """Rig whose laser 1 lies where the shift put it, expressed as a scale of the travel.

    **Why not as a sheet.** A shift by s moves every point of laser 1 along the travel and keeps its height. A stripe's
    point cannot leave its pixel's ray, on which height and place go together (``along = Z tan(alpha)``): moving sheet 1
    along the travel by s changes depths by ``s Z / d``, 1.7 s at the bed, and would undo the fit against the ToF
    sensor. No sheet shifts a cloud sideways.

    **What does.** The lasers see the same place of the bed at two positions of the cart, apart by their stripes'
    separation ``S = d1 + d2 - Z (cot(theta1) + cot(theta2))``. A travel per commanded millimetre that is wrong by the
    factor ``1 + e`` tears their clouds apart by ``e S``: rounding 0.10053 mm per step to 0.1 mm does so by half a
    millimetre. So the travel is scaled by ``S / (S + s)``, which leaves every height as it is and removes the shift
    exactly at the height whose slopes told it, ``shift.height_mm``.

    It is an approximation at other heights, since S is not the same there: at h above that one about
    ``s h (cot(theta1) + cot(theta2)) / S`` of the shift is left over, to the other side. And it stretches the whole
    cloud by s / S, rightly if the travel's scale was the cause, wrongly if it was something else, as a focal length or
    a tilted sheet.

    Raises
    ------
    CalibrationError
        ``shift-undetermined``, or ``shift-too-large`` if the travel would change by more than 3 %.
    """
    if len(rig.sheets) != 2:
        raise CalibrationError("The rig has one laser, and a shift needs two: leave this step out.", code="one-laser")
    if not shift.determined:
        low, high = shift.indifferent_mm
        raise CalibrationError(
            f"Any shift of laser 1 from {low:.2f} to {high:.2f} mm fits laser 2 equally well: scan an object with "
            "slopes along the travel, such as a sphere or a wedge, instead of flat tops alone.",
            code="shift-undetermined",
        )
    separation = stripe_separation_mm(rig, float(rig.bed_from_camera.translation_mm[2]) - shift.height_mm)
    moved = separation + shift.shift_mm
    change = separation / moved - 1.0 if abs(moved) >= _SMALLEST_SEPARATION_MM else float("inf")
    if abs(change) > _LARGEST_SCALE_CHANGE:
        raise CalibrationError(
            f"A shift of {shift.shift_mm:.2f} mm between stripes {separation:.0f} mm apart would change the travel by "
            f"more than {100 * _LARGEST_SCALE_CHANGE:.0f} %: calibrate the sheets again, or the travel with a board.",
            code="shift-too-large",
        )
    source = f"thesis: Nelder-Mead shift of laser 1 by {shift.shift_mm:.3f} mm, as a scale of {1.0 + change:.5f}"
    return replace(rig, travel=rig.travel * (1.0 + change), covariance=None, sources={**rig.sources, "travel": source})


def apply_tof(rig: Rig, alignment: TofAlignment) -> Rig:
    """Rig whose ToF sensor stands where the alignment put it.

    The shift goes into the sensor's position and is exact. A turn goes into position, slide and beam; the travel is
    the lasers' too and stays, so points at the distance c along the travel from the raster's middle keep an error of
    ``c yaw`` across it.

    Raises
    ------
    CalibrationError
        ``no-tof`` if the rig has no ToF sensor.
    """
    mount = rig.tof
    if mount is None:
        raise CalibrationError(
            "The rig has no ToF sensor to align: describe it under tof in capture.json, or leave this step out.",
            code="no-tof",
        )
    cos, sin = float(np.cos(alignment.yaw_rad)), float(np.sin(alignment.yaw_rad))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    # The cart position at which the sensor passes the pivot, where the unturned travel does no harm.
    cart = _cart_at(mount.position_mm, rig.travel, alignment.pivot_mm)
    pivot = np.append(alignment.pivot_mm, 0.0)
    there = mount.position_mm + cart * rig.travel
    position = turn @ (there - pivot) + pivot + alignment.shift_mm - cart * rig.travel
    x, y, z = alignment.shift_mm
    turned = f" and turned by {np.degrees(alignment.yaw_rad):.3f} degrees" if alignment.yaw_rad else ""
    return replace(
        rig,
        tof=replace(mount, position_mm=position, slide=turn @ mount.slide, beam=turn @ mount.beam),
        covariance=None,
        sources={
            **rig.sources,
            "tof": f"thesis: Nelder-Mead alignment to the lasers, moved by {x:.3f}, {y:.3f}, {z:.3f} mm{turned}",
        },
    )


def _cart_at(position_mm: FloatArray, travel: FloatArray, pivot_mm: FloatArray) -> float:
    along = travel[:2]
    return float((pivot_mm - position_mm[:2]) @ along / (along @ along))
