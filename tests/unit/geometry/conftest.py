"""Rigs that hide no mistake: nothing in them is zero, one, square or aligned."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinline.geometry.camera import Camera
from twinline.geometry.nominal import nominal_rig
from twinline.geometry.rig import Rig, StripeRuns, Transform
from twinline.geometry.sheet import LaserSheet, Side

MATRIX = np.array([[1041.3, 0.0, 633.9], [0.0, 1038.7, 371.2], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.28, 0.11, -0.0021, 0.0016, -0.018])


def _crooked(runs: StripeRuns) -> Rig:
    camera = Camera(MATRIX, (1280, 720), DISTORTION)
    sides: tuple[Side, Side] = ("+v", "-v") if runs == "along-u" else ("+u", "-u")
    plain = nominal_rig("crooked", camera, runs, [(251.0, 1.14, sides[0]), (247.0, 1.09, sides[1])], 430.0)
    turn = Rotation.from_euler("xyz", [0.021, -0.017, 0.034]).as_matrix()
    sheets = tuple(
        LaserSheet(
            Rotation.from_euler("xyz", [0.008, -0.011, 0.013]).as_matrix() @ sheet.normal, sheet.offset_mm, sheet.side
        )
        for sheet in plain.sheets
    )
    return dataclasses.replace(
        plain,
        sheets=sheets,
        bed_from_camera=Transform(turn @ plain.bed_from_camera.rotation, np.array([3.1, -2.3, 431.7])),
        travel=np.array([0.9962, -0.0087, 0.0011]),
    )


@pytest.fixture(scope="session", params=["along-u", "along-v"])
def crooked_rig(request: pytest.FixtureRequest) -> Rig:
    """A misaligned rig with a strongly distorting lens, once for each direction of the stripes."""
    return _crooked(request.param)


@pytest.fixture(scope="session")
def rendered_rig(shared_data: Callable[[str], Path]) -> Rig:
    """The true rig of the data set rendered_sample."""
    truth = json.loads((shared_data("rendered_sample") / "truth.json").read_text())
    sides: tuple[Side, Side] = ("+v", "-v")
    return Rig(
        name="rendered sample",
        camera=Camera(np.array(truth["camera_matrix"]), (1280, 720), np.array(truth["distortion_k1k2p1p2k3"])),
        stripe_runs="along-u",
        sheets=tuple(
            LaserSheet(np.array(sheet["normal_in_camera"]), sheet["offset_mm"], side)
            for sheet, side in zip(truth["sheets"], sides, strict=True)
        ),
        bed_from_camera=Transform(
            np.array(truth["world_from_camera_rotation"]),
            np.array(truth["camera_centre_in_world_mm_at_cart_0_of_the_world"]),
        ),
        travel=np.array(truth["travel_in_world_per_commanded_mm"]),
    )
