"""What a capture needs for calibration beside the laser pass: views of a board, a board under way, a ToF pass."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.board import Board
from twinline.devices.simulator.board_print import board_axes, default_board
from twinline.devices.simulator.board_views import BoardViews
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.tof import TofReader, TofSensor, full_scale_front_end
from twinline.devices.simulator.tof_beam import SimulatedTofMount
from twinline.devices.simulator.turns import turn_deg
from twinline.devices.simulator.workspace import Workspace
from twinline.errors import OutputError, SettingsError

Part = Literal["camera", "motion", "tof"]
PARTS: tuple[Part, ...] = get_args(Part)

_VIEWS = 16
_MOTION_FRAMES = 6
_MOTION_STEP_MM = 22.0
_VIEW_LEVEL = (150.0, 168.0, 172.0)
_SWEEP_MM_S = 20.0
_ADVANCE_MM = 1.5
_TURN_S = 0.3
_CONVERSIONS = 10
_CONVERSION_S = 0.001
_BORDER_MM = 12.0


def checked_parts(parts: frozenset[str], rig: SimulatedRig) -> frozenset[str]:
    """The same parts, known to be possible.

    Raises
    ------
    SettingsError
        There is no such part, or the machine has no ToF sensor.
    """
    unknown = sorted(parts - set(PARTS))
    if unknown:
        raise SettingsError(
            f"A simulated capture has no part {unknown[0]!r}; choose from {', '.join(PARTS)} (laser is always there)."
        )
    if "tof" in parts and rig.tof is None:
        raise SettingsError("The simulated machine has no ToF sensor, so it cannot make a tof part; leave that out.")
    return parts


def described_parts(parts: frozenset[str], rig: SimulatedRig) -> dict[str, Any]:
    """What the owner of the parts writes into ``capture.json``."""
    description: dict[str, Any] = {}
    if parts & {"camera", "motion"}:
        board = default_board()
        description["board"] = {
            "kind": board.kind, "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm,
            "thickness_mm": board.thickness_mm, "dictionary": board.dictionary, "marker_mm": board.marker_mm,
        }  # fmt: skip
    if "tof" in parts and rig.tof is not None:
        sensor = TofSensor()
        description["tof"] = {
            "range_mm": list(sensor.range_mm), "volts": list(sensor.volts), "adc_counts": 4096,
            "mount_mm": list(rig.tof.known_mm),
        }  # fmt: skip
    return description


def write_parts(
    folder: Path, parts: frozenset[str], workspace: Workspace, *, seed: int, checkpoint: Callable[[], None]
) -> None:
    """Write ``camera/``, ``motion/`` and ``tof/``, as far as asked.

    Raises
    ------
    OutputError
        A picture cannot be encoded.
    OSError
        The folder cannot be written.
    """
    board = default_board()
    if parts & {"camera", "motion"}:
        # Light to see a board by: longer exposures than those of a laser pass.
        views = BoardViews(board, workspace.rig, workspace.scene.bed, _VIEW_LEVEL, seed=seed)
        if "camera" in parts:
            _write_views(folder / "camera", views, seed, checkpoint)
        if "motion" in parts:
            _write_motion(folder / "motion", views, board, workspace.rig, checkpoint)
    if "tof" in parts and workspace.rig.tof is not None:
        checkpoint()
        _write_tof(folder / "tof", workspace, workspace.rig.tof)


def _write_views(folder: Path, views: BoardViews, seed: int, checkpoint: Callable[[], None]) -> None:
    """Hold the board at different distances, tilts and places, as a careful operator would."""
    folder.mkdir()
    rng = np.random.default_rng([seed, 4])
    x, y, z = np.eye(3)
    middle = views.middle_mm()
    for number in range(_VIEWS):
        checkpoint()
        angle = 2 * np.pi * number / 7 + rng.uniform(-0.2, 0.2)
        tilt = 0.0 if number == 0 else (20.0 if number <= 7 else 33.0)
        turn = turn_deg(np.cos(angle) * x + np.sin(angle) * y, tilt) @ turn_deg(z, rng.uniform(-15.0, 15.0))
        depth = rng.uniform(300.0, 420.0)
        spread = depth / 400.0
        place = np.array([75.0 * np.cos(2.1 * number) * spread, 30.0 * np.sin(1.3 * number) * spread, depth])
        _write_png(folder / f"{number:02d}.png", views, number, turn, place - turn @ middle)


def _write_motion(
    folder: Path, views: BoardViews, board: Board, rig: SimulatedRig, checkpoint: Callable[[], None]
) -> None:
    """Let the cart travel over a board that lies still."""
    folder.mkdir()
    rotation, axes = rig.bed_from_camera, board_axes(6.0)
    lines = ["frame,cart_mm"]
    first = 100.0
    place = rig.travel * (first + 0.5 * (_MOTION_FRAMES - 1) * _MOTION_STEP_MM)
    origin = place + np.array([1.0, -4.0, board.thickness_mm]) - axes @ views.middle_mm()
    for number in range(_MOTION_FRAMES):
        checkpoint()
        cart_mm = first + number * _MOTION_STEP_MM
        name = f"{number:02d}.png"
        # Noise of its own: views have the numbers below 100.
        _write_png(folder / name, views, 100 + number, rotation.T @ axes, rotation.T @ (origin - rig.eye_mm(cart_mm)))
        lines.append(f"{name},{cart_mm:.3f}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_png(path: Path, views: BoardViews, number: int, turn: FloatArray, origin: FloatArray) -> None:
    encoded, data = cv2.imencode(".png", views.photograph(number, turn, origin))
    if not encoded:
        raise OutputError(f"The simulated picture {path} could not be encoded as PNG; try another image size.")
    path.write_bytes(data.tobytes())


def _write_tof(folder: Path, workspace: Workspace, mount: SimulatedTofMount) -> None:
    """Sweep the scene row by row, to and fro, and write the mean of each ten conversions."""
    folder.mkdir()
    sensor = TofSensor()
    reader = TofReader(sensor, full_scale_front_end(sensor), workspace.seed)
    lines = ["time_s,cart_mm,slide_mm,adc"]
    start_s = 0.0
    low, high, carts = _raster(workspace, mount)
    conversions = int((high - low) / _SWEEP_MM_S / _CONVERSION_S) // _CONVERSIONS * _CONVERSIONS
    swept = low + _SWEEP_MM_S * _CONVERSION_S * np.arange(conversions)
    for number, cart_mm in enumerate(carts):
        slide = swept if number % 2 == 0 else swept[::-1]
        time = start_s + _CONVERSION_S * np.arange(conversions)
        counts = reader.sample(time, workspace.tof_distances_mm(np.full(conversions, cart_mm), slide))
        start_s = float(time[-1]) + _TURN_S
        at_end = (counts == 0) | (counts == reader.front_end.counts - 1)
        rows = zip(
            *(values.reshape(-1, _CONVERSIONS).mean(axis=1) for values in (time, slide, counts, at_end)), strict=True
        )
        for t, s, count, invalid in rows:
            lines.append(f"{t:.5f},{cart_mm:.4f},{s:.4f}," + ("" if invalid else f"{count:.1f}"))
    (folder / "samples.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _raster(workspace: Workspace, mount: SimulatedTofMount) -> tuple[float, float, FloatArray]:
    """Ends of the sweeps and positions of the cart that cover the scene, by what the owner knows of the machine."""
    scene = workspace.scene
    sides = [(float(t.mesh.bounds[0][1]), float(t.mesh.bounds[1][1])) for t in scene.things] or [(-20.0, 20.0)]
    low = max(min(side[0] for side in sides) - _BORDER_MM - mount.known_mm[1], mount.slide_range_mm[0])
    high = min(max(side[1] for side in sides) + _BORDER_MM - mount.known_mm[1], mount.slide_range_mm[1])
    first, last = (x - mount.known_mm[0] for x in scene.span_mm)
    return low, high, np.arange(first, last, _ADVANCE_MM)
