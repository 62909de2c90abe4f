"""Capture folders to measure on, written from drawn pictures."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from twinline.bench.pictures import NOISE_DN, Brush, relief_of
from twinline.errors import OutputError
from twinline.geometry.camera import Camera
from twinline.geometry.noise import NoiseModel
from twinline.geometry.nominal import nominal_rig
from twinline.geometry.optics import stripe_positions
from twinline.geometry.rig import Rig
from twinline.geometry.sheet import Side
from twinline.recording.capture import Capture, open_capture

PITCH_MM = 0.5
_FOCAL_WIDTHS = 0.8
_HEIGHT_MM = 420.0
_BASELINE_MM = 246.0
_ANGLE_DEG = 63.0
_TALLEST_MM = 30.0
_JPEG_QUALITY = 90
_FRAMES_PER_SECOND = 25.0
_PHASE_STEP = 0.0025
_SEED = 20240602


def bench_rig(size: tuple[int, int]) -> Rig:
    """A rig for pictures of that size whose noise is known, so that it need not be estimated."""
    width, height = size
    focal = _FOCAL_WIDTHS * width
    camera = Camera(np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]), size)
    angle = float(np.radians(_ANGLE_DEG))
    lasers: list[tuple[float, float, Side]] = [(_BASELINE_MM, angle, "+v"), (_BASELINE_MM, angle, "-v")]
    rig = nominal_rig("bench", camera, "along-u", lasers, _HEIGHT_MM)
    return replace(rig, noise=NoiseModel(read_dn=NOISE_DN))


def write_capture(folder: Path, size: tuple[int, int], frames: int, *, drawn: int, colour: bool) -> Capture:
    """Write a laser pass of JPEG frames, of which ``drawn`` differ, and open it.

    Raises
    ------
    OutputError
        A frame cannot be encoded.
    """
    rig = bench_rig(size)
    brush = Brush(*size, np.random.default_rng(_SEED))
    low, high = (np.stack([stripe_positions(rig, k, z) for k in range(2)]) for z in (0.0, _TALLEST_MM))
    pictures = []
    for number in range(drawn):
        # From frame to frame a scene changes as little as the cart moves.
        centres = low + relief_of(size[0], number * _PHASE_STEP) * (high - low)
        picture = brush.colour(centres) if colour else brush.gray(centres)
        encoded, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not encoded:
            raise OutputError(f"A frame of {size[0]} x {size[1]} px could not be encoded as JPEG.")
        pictures.append(data.tobytes())
    laser = folder / "laser"
    laser.mkdir(parents=True)
    lines = ["frame,time_s,cart_mm"]
    for number in range(frames):
        name = f"{number:06d}.jpg"
        (laser / name).write_bytes(pictures[_to_and_fro(number, drawn)])
        lines.append(f"{name},{number / _FRAMES_PER_SECOND:.4f},{number * PITCH_MM:.4f}")
    (laser / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "capture.json").write_text(json.dumps(_description(rig)), encoding="utf-8")
    return open_capture(folder)


def _to_and_fro(number: int, count: int) -> int:
    """0, 1, ... count - 1, count - 2, ... 0, 1, ...: without a leap."""
    place = number % max(2 * count - 2, 1)
    return min(place, 2 * count - 2 - place)


def _description(rig: Rig) -> dict[str, object]:
    sides = ("+v", "-v")
    return {
        "name": rig.name,
        "image_size": list(rig.camera.size),
        "stripe_runs": rig.stripe_runs,
        "camera_matrix_guess": rig.camera.matrix.tolist(),
        "camera_height_mm": _HEIGHT_MM,
        "lasers": [{"baseline_mm": _BASELINE_MM, "angle_deg": _ANGLE_DEG, "side": side} for side in sides],
    }
