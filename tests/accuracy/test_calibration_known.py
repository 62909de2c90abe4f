"""Sheets from surfaces of known place: boards in ``sheets/``, blocks in ``heights/``; the bed as a flat pass."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.accuracy.calibration_cases import IMAGE_SIZE
from tests.accuracy.calibration_parts import misaligned_rig, write_boards, write_heights, write_sheets
from tests.accuracy.calibration_shape import volume_error_mm
from twinline.arrays import FloatArray
from twinline.bench.growth import InlineExecutor
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.renderer import Renderer
from twinline.devices.simulator.truth import owner_knowledge, true_rig, write_json
from twinline.devices.simulator.world import Material, build_world
from twinline.operations.calibrate import adjust_collected, calibrate_capture, collect, finish
from twinline.reconstruction.offline import reconstruct
from twinline.recording.capture import open_capture

SHEET_DEG, SHEET_MM = 0.05, 0.2
"""0.05 degrees about the stripe on the bed are 0.03 mm of height 25 mm above it."""
VOLUME_MM = 0.10
BOARD_VIEWS = 12
BOARD_VOLUME_MM = 0.15
"""Each pose of a board is known to some hundredths of a millimetre, and there are few of them."""

pytestmark = pytest.mark.slow


def described(folder: Path, rig: SimulatedRig) -> None:
    description = owner_knowledge("known surfaces", rig)
    description["board"] = {"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 12.0}
    write_json(folder / "capture.json", description)


def test_blocks_of_known_height_give_both_sheets(tmp_path: Path) -> None:
    machine = misaligned_rig(7).cropped(IMAGE_SIZE)
    write_boards(tmp_path, machine, seed=7)
    write_heights(tmp_path, machine, (0.0, 15.0, 30.0, 50.0), seed=7)
    described(tmp_path, machine)
    calibration = calibrate_capture(open_capture(tmp_path))
    true = true_rig("true", machine)
    assert calibration.evidence.verdict == "good", calibration.evidence.reasons
    for found, sheet in zip(calibration.rig.sheets, true.sheets, strict=True):
        assert np.degrees(np.arccos(min(float(found.normal @ sheet.normal), 1.0))) < SHEET_DEG
        assert abs(found.offset_mm - sheet.offset_mm) < SHEET_MM
    assert volume_error_mm(calibration.rig, true) < VOLUME_MM
    assert {g.kind for g in calibration.evidence.groups} == {"laser 1 on a block", "laser 2 on a block"}


def test_boards_with_the_stripes_on_and_off_give_both_sheets(tmp_path: Path) -> None:
    machine = misaligned_rig(8).cropped(IMAGE_SIZE)
    write_boards(tmp_path, machine, seed=8)
    write_sheets(tmp_path, machine, seed=8, views=BOARD_VIEWS)
    described(tmp_path, machine)
    calibration = calibrate_capture(open_capture(tmp_path))
    evidence = calibration.evidence
    error = volume_error_mm(calibration.rig, true_rig("true", machine))
    assert error < BOARD_VOLUME_MM
    assert error < 2.5 * evidence.shape_sd_mm
    # Honest about it: so few poses leave more than a pass over objects would.
    assert evidence.verdict in ("good", "usable"), evidence.reasons
    assert {g.kind for g in evidence.groups} == {"laser 1 on a board", "laser 2 on a board"}


def test_a_pass_over_the_bare_bed_tells_the_noise_and_extraction_uses_it(tmp_path: Path) -> None:
    machine = misaligned_rig(9).cropped(IMAGE_SIZE)
    write_boards(tmp_path, machine, seed=9)
    # Blur would make neighbouring pixels share their speckle, which no model of single pixels tells.
    sharp = replace(machine, sensor=replace(machine.sensor, blur_px=0.05))
    plain = Material((0.46, 0.50, 0.52), 0.0)
    renderer = Renderer(build_world((), plain, seed=9), sharp, seed=9)
    (tmp_path / "laser").mkdir()
    lines = ["frame,time_s,cart_mm"]
    for number in range(24):
        # Without compression, which would smooth the noise away.
        cv2.imwrite(str(tmp_path / "laser" / f"{number:02d}.png"), renderer.render(number, 2.0 * number))
        lines.append(f"{number:02d}.png,{number / 25:.3f},{2.0 * number}")
    (tmp_path / "laser" / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    described(tmp_path, machine)
    capture = open_capture(tmp_path)
    collected = collect(capture)
    rig = finish(capture, collected, *adjust_collected(collected)).rig
    assert rig.noise is not None
    # Rounding to whole grey levels is noise as well.
    assert rig.noise.read_dn == pytest.approx(np.hypot(sharp.sensor.read_dn, np.sqrt(1 / 12)), rel=0.15)
    assert rig.noise.speckle == pytest.approx(sharp.sensor.speckle, rel=0.15)
    assert collected.stripes is not None
    stripes = collected.stripes
    assert scatter_px(stripes.centre_px[0]) == pytest.approx(float(np.nanmedian(stripes.sd_px[0])), rel=0.2)
    assert reconstruct(capture, rig, executor=InlineExecutor()).noise == rig.noise


def scatter_px(centre_px: FloatArray) -> float:
    """Standard deviation of a flat bed's stripe about a smooth curve, robust."""
    lanes = np.arange(centre_px.shape[1])
    off = []
    for centre in centre_px:
        seen = np.isfinite(centre)
        curve = np.polyfit(lanes[seen] - lanes.mean(), centre[seen].astype(np.float64), 4)
        off.append(centre[seen] - np.polyval(curve, lanes[seen] - lanes.mean()))
    return 1.4826 * float(np.median(np.abs(np.concatenate(off))))
