"""A scanner out of true in every way."""

import numpy as np

from twinline.arrays import FloatArray
from twinline.geometry.camera import Camera
from twinline.geometry.rig import Rig, TofMount, Transform
from twinline.geometry.sheet import LaserSheet


def turn(x: float, y: float, z: float) -> FloatArray:
    """Rotation about x, then y, then z, by radians."""
    cx, sx, cy, sy, cz, sz = np.cos(x), np.sin(x), np.cos(y), np.sin(y), np.cos(z), np.sin(z)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def crooked_rig() -> Rig:
    """Two lasers, a ToF sensor, and nothing straight."""
    upright = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    beam = np.array([0.008, -0.006, -1.0])
    return Rig(
        name="crooked",
        camera=Camera(
            np.array([[1041.0, 0.0, 634.0], [0.0, 1040.0, 371.0], [0.0, 0.0, 1.0]]),
            (1280, 720),
            np.array([-0.128, 0.07, -0.0007, 0.0005, 0.0]),
        ),
        stripe_runs="along-u",
        sheets=(
            LaserSheet(np.array([-0.0008, 0.8957, 0.4447]), 215.2, "+v"),
            LaserSheet(np.array([-0.0054, -0.8980, 0.4400]), 225.2, "-v"),
        ),
        bed_from_camera=Transform(upright @ turn(0.01, -0.008, 0.006), np.array([0.0, 0.0, 421.5])),
        travel=np.array([0.9961, 0.0, 0.003]),
        tof=TofMount(
            np.array([-104.0, 6.0, 136.0]),
            beam / np.linalg.norm(beam),
            np.array([0.010, 0.9998, -0.001]),
            80.0 / 4095,
            60.0,
            (60.0, 140.0),
            0.016,
        ),
    )
