"""Calibration from pixels and ToF readings alone, against the true machine of another program's capture."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twinline.operations.calibrate import CalibrationOptions, calibrate_capture
from twinline.recording.capture import open_capture

pytestmark = pytest.mark.slow

TILT_DEG = 0.05
"""Of a sheet: 0.05 degrees are 0.9 mm at the bed, but most of it is shared with the camera's tilt; a tenth is left."""
TRAVEL_SHARE = 1e-3
"""Of the scale of travel: 0.1 mm over a scan of 100 mm."""


def test_sheets_and_travel_come_out_of_the_pixels(shared_data: Callable[[str], Path]) -> None:
    folder = shared_data("rendered_sample")
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    rig = calibrate_capture(open_capture(folder), CalibrationOptions()).rig
    for sheet, true in zip(rig.sheets, truth["sheets"], strict=True):
        normal = np.array(true["normal_in_camera"]) * np.sign(true["offset_mm"])
        tilt_deg = np.degrees(np.arccos(np.clip(sheet.normal @ normal / np.linalg.norm(normal), -1, 1)))
        assert tilt_deg <= TILT_DEG
        assert sheet.offset_mm == pytest.approx(abs(true["offset_mm"]), abs=0.5)
    assert np.linalg.norm(rig.travel) == pytest.approx(
        np.linalg.norm(truth["travel_in_world_per_commanded_mm"]), rel=TRAVEL_SHARE
    )
