"""Rigs from drawings and rulers: what a scanner is taken to be before it is calibrated.

The nominal camera looks exactly down from ``camera_height_mm`` above the bed's origin, the cart travels along bed x
true to scale, and each sheet holds the image axis along which its stripe runs. Frames: for stripes along u, bed x is
image +v and bed y is image +u; for stripes along v (the camera turned by 90 degrees), bed x is image +u and bed y is
image -v. Bed z is up, against the camera's z.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError
from twinline.geometry.camera import Camera
from twinline.geometry.rig import Rig, StripeRuns, TofMount, Transform
from twinline.geometry.sheet import LaserSheet, Side

TofUnit = Literal["adc", "volts", "distance_mm"]
"""Unit of a ToF recording's readings: ADC counts, volts, or millimetres of distance."""


def nominal_pose(stripe_runs: StripeRuns, camera_height_mm: float) -> Transform:
    """The bed_from_camera of a camera that looks exactly down from above the bed's origin."""
    if not (np.isfinite(camera_height_mm) and camera_height_mm > 0):
        raise RigError(f"The camera's height must be a positive number of millimetres, not {camera_height_mm}.")
    if stripe_runs == "along-u":
        rotation = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    else:
        rotation = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    return Transform(np.array(rotation), np.array([0.0, 0.0, camera_height_mm]))


def nominal_rig(
    name: str,
    camera: Camera,
    stripe_runs: StripeRuns,
    lasers: Sequence[tuple[float, float, Side]],
    camera_height_mm: float,
    tof: TofMount | None = None,
) -> Rig:
    """Rig from nominal measures.

    Parameters
    ----------
    lasers
        For each laser its baseline in millimetres, its angle to the baseline in radians, and its side of the image.
    camera_height_mm
        Camera centre above the bed.

    Raises
    ------
    RigError
        A measure is impossible, or the lasers do not fit ``stripe_runs``.
    """
    return Rig(
        name=name,
        camera=camera,
        stripe_runs=stripe_runs,
        sheets=tuple(LaserSheet.from_baseline_angle(*laser) for laser in lasers),
        bed_from_camera=nominal_pose(stripe_runs, camera_height_mm),
        travel=np.array([1.0, 0.0, 0.0]),
        tof=tof,
        sources=dict.fromkeys(("camera", "sheets", "bed_from_camera", "travel"), "nominal")
        | ({"tof": "nominal"} if tof else {}),
    )


def nominal_tof(
    mount_mm: FloatArray,
    range_mm: tuple[float, float],
    unit: TofUnit,
    *,
    volts: tuple[float, float] = (-4.0, 4.0),
    adc_counts: int = 4096,
    lag_s: float = 0.0,
) -> TofMount:
    """ToF sensor that looks straight down from a slide exactly across the travel.

    Parameters
    ----------
    mount_mm : (3,) array
        Sensor at slide position 0 against the camera centre's foot point on the bed: x along the travel, y across,
        z above the bed.
    range_mm
        Distance at the lowest and at the highest reading.
    unit
        What the recording holds: counts from 0 to ``adc_counts - 1``, volts over the ``volts`` range, or millimetres.
    """
    shortest, longest = range_mm
    if unit == "distance_mm":
        gain, offset = 1.0, 0.0
    else:
        low, high = volts if unit == "volts" else (0.0, adc_counts - 1.0)
        if not (high > low and longest > shortest):
            raise RigError(
                f"The ToF sensor's range {shortest} to {longest} mm over readings {low} to {high} must ascend: "
                "check range_mm, volts and adc_counts."
            )
        gain = (longest - shortest) / (high - low)
        offset = shortest - gain * low
    return TofMount(
        position_mm=np.asarray(mount_mm, dtype=np.float64),
        beam=np.array([0.0, 0.0, -1.0]),
        slide=np.array([0.0, 1.0, 0.0]),
        gain_mm_per_unit=gain,
        offset_mm=offset,
        range_mm=(shortest, longest),
        lag_s=lag_s,
    )


def default_rig() -> Rig:
    """The default machine: 1280 x 720 camera at 430 mm, two lasers at 246 mm and 60 degrees, a 60 to 140 mm ToF sensor.

    The intrinsics are the machine's measured ones, without distortion; the rest is nominal. With these nominal angles
    the stripes cross 4 mm above the bed. The ToF sensor's response of 40 ms is taken as its rise from 10 to 90 %,
    which is ln 9 time constants.
    """
    camera = Camera(
        np.array([[1028.84412, 0.0, 648.47410], [0.0, 1028.59061, 363.64953], [0.0, 0.0, 1.0]]), (1280, 720)
    )
    angle = float(np.radians(60.0))
    tof = nominal_tof(np.array([-118.0, 0.0, 139.0]), (60.0, 140.0), "adc", lag_s=0.040 / float(np.log(9.0)))
    return nominal_rig("default machine", camera, "along-u", [(246.0, angle, "+v"), (246.0, angle, "-v")], 430.0, tof)
