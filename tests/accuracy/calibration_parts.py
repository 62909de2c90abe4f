"""Board views and a ToF raster for a simulated capture, so that it holds everything a calibration may use.

Drawn by casting a ray through every sub-pixel of the simulator's own lens; nothing of the package's geometry or
calibration is used.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from twinline.arrays import FloatArray as Floats
from twinline.devices.simulator.capture import RenderedCapture, render_capture
from twinline.devices.simulator.machine import SimulatedLaser, SimulatedRig, turn_deg
from twinline.devices.simulator.raycast import first_hits
from twinline.devices.simulator.renderer import Renderer
from twinline.devices.simulator.scenes import Scene, box, named_scene
from twinline.devices.simulator.workspace import swept_travel_mm
from twinline.devices.simulator.world import Material, build_world

SUBPIXELS = 3
COLUMNS, ROWS, SQUARE_MM = 9, 6, 12.0
MARGIN_SQUARES = 1.6
GROUND_DN = 85.0


@dataclass(frozen=True)
class TrueTof:
    """The ToF sensor as it really is: place against the camera's foot point at cart 0, tilts, slide, lag."""

    place_mm: tuple[float, float, float] = (-104.0, 6.5, 136.6)
    known_mm: tuple[float, float, float] = (-105.0, 5.0, 136.0)
    tilt_deg: tuple[float, float] = (-0.4, 0.5)
    slide_yaw_deg: float = -0.6
    slide_scale: float = 1.0
    lag_s: float = 0.018
    noise_mm: float = 0.008
    sweep_mm_s: float = 20.0
    sample_s: float = 0.01
    advance_mm: float = 1.5


def slopes(rig: SimulatedRig) -> Floats:
    """Rays x/z, y/z of all sub-pixels, (height * 3, width * 3, 2)."""
    width, height = rig.image_size
    at = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    u = (np.arange(width)[:, None] + at).ravel()
    v = (np.arange(height)[:, None] + at).ravel()
    return np.asarray(rig.lens.slopes(u, v), dtype=np.float64)


def board_picture(
    rig: SimulatedRig, rays: Floats, turn: Floats, origin: Floats, rng: np.random.Generator, *, lasers: bool = False
) -> NDArray[np.uint8]:
    """Picture of the board whose frame has the rotation ``turn`` and the ``origin`` (mm) in the camera frame."""
    width, height = rig.image_size
    # Off the board there is nothing to draw but the stripes, so the rest is left out of the many rays.
    part = (slice(0, height), slice(0, width)) if lasers else _around(rays, turn, origin)
    fine = rays[tuple(slice(s.start * SUBPIXELS, s.stop * SUBPIXELS) for s in part)]
    depth, i, j = _on_board(fine, turn, origin)
    dark = (i > -1) & (i < COLUMNS) & (j > -1) & (j < ROWS) & ((np.floor(i) + np.floor(j)) % 2 == 0)
    light = np.where(dark, 25.0, np.where(_on_paper(i, j), 190.0, GROUND_DN))
    if lasers:
        points = np.concatenate([fine, np.ones((*fine.shape[:2], 1))], axis=-1) * depth[..., None]
        for laser in rig.lasers:
            off = points @ (rig.bed_from_camera.T @ laser.normal) - laser.normal @ laser.source_mm
            light = light + 0.28 * (light + 60.0) * np.exp(-0.5 * (off / laser.width_mm) ** 2)
    rows, columns = (s.stop - s.start for s in part)
    mean = np.full((height, width), GROUND_DN)
    mean[part] = light.reshape(rows, SUBPIXELS, columns, SUBPIXELS).mean(axis=(1, 3))
    mean = cv2.GaussianBlur(mean, (0, 0), rig.sensor.blur_px)
    noisy = mean + rng.normal(0.0, np.sqrt(rig.sensor.read_dn**2 + mean / rig.sensor.electrons_per_dn))
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def _on_board(rays: Floats, turn: Floats, origin: Floats) -> tuple[Floats, Floats, Floats]:
    """Depth at which rays meet the board's plane, and where on it, in squares."""
    normal = turn[:, 2]
    depth = (normal @ origin) / (rays[..., 0] * normal[0] + rays[..., 1] * normal[1] + normal[2])
    x, y = (
        (rays[..., 0] * turn[0, k] + rays[..., 1] * turn[1, k] + turn[2, k]) * depth - turn[:, k] @ origin
        for k in (0, 1)
    )
    return depth, x / SQUARE_MM, y / SQUARE_MM


def _on_paper(i: Floats, j: Floats) -> NDArray[np.bool_]:
    return np.asarray(
        (i > -MARGIN_SQUARES)
        & (i < COLUMNS - 1 + MARGIN_SQUARES)
        & (j > -MARGIN_SQUARES)
        & (j < ROWS - 1 + MARGIN_SQUARES)
    )


def _around(rays: Floats, turn: Floats, origin: Floats) -> tuple[slice, slice]:
    """Rows and columns of pixels around the board's paper."""
    paper = _on_paper(*_on_board(rays[1::SUBPIXELS, 1::SUBPIXELS], turn, origin)[1:])
    rows, columns = np.flatnonzero(paper.any(axis=1)), np.flatnonzero(paper.any(axis=0))
    height, width = paper.shape
    return (
        slice(max(int(rows[0]) - 2, 0), min(int(rows[-1]) + 3, height)),
        slice(max(int(columns[0]) - 2, 0), min(int(columns[-1]) + 3, width)),
    )


def write_boards(folder: Path, rig: SimulatedRig, *, seed: int, views: int = 14, motion: int = 6) -> None:
    """Write camera/ and motion/."""
    rng = np.random.default_rng(seed)
    rays = slopes(rig)
    middle = 0.5 * SQUARE_MM * np.array([COLUMNS - 1, ROWS - 1, 0.0])
    (folder / "camera").mkdir()
    (folder / "motion").mkdir()
    x, y, z = np.eye(3)
    for number in range(views):
        angle = 2 * np.pi * number / 7
        tilt = 0.0 if number == 0 else (22.0 if number < 8 else 36.0)
        turn = turn_deg(np.cos(angle) * x + np.sin(angle) * y, tilt) @ turn_deg(z, rng.uniform(-12, 12))
        depth = rng.uniform(240, 380)
        spread = depth / 400.0
        place = np.array([90.0 * np.cos(2.1 * number) * spread, 45.0 * np.sin(1.3 * number) * spread, depth])
        image = board_picture(rig, rays, turn, place - turn @ middle, rng)
        cv2.imwrite(str(folder / "camera" / f"{number:02d}.png"), image)
    rotation = rig.bed_from_camera
    lines = ["frame,cart_mm"]
    for number in range(motion):
        cart = 100.0 + 22.0 * number
        # The board lies on the bed, its z axis down into it.
        face = turn_deg(z, 7.0) @ np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        turn = rotation.T @ face
        centre = rig.travel * 155.0 + np.array([2.0, -5.0, 0.0])
        origin = rotation.T @ (centre - face @ middle - rig.eye_mm(cart))
        image = board_picture(rig, rays, turn, origin, rng)
        cv2.imwrite(str(folder / "motion" / f"{number:02d}.png"), image)
        lines.append(f"{number:02d}.png,{cart:.3f}")
    (folder / "motion" / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_sheets(folder: Path, rig: SimulatedRig, *, seed: int, views: int = 8) -> None:
    """Write sheets/on and sheets/off: the board in several poses across both stripes."""
    rng = np.random.default_rng(seed)
    rays = slopes(rig)
    middle = 0.5 * SQUARE_MM * np.array([COLUMNS - 1, ROWS - 1, 0.0])
    for name in ("on", "off"):
        (folder / "sheets" / name).mkdir(parents=True)
    x, y, _ = np.eye(3)
    for number in range(views):
        turn = turn_deg(x if number % 4 < 2 else y, 14.0 * (-1.0) ** (number // 4))
        # The board is narrower than the stripes lie apart: it stands under one of them at a time.
        along = 44.0 if number % 2 else -44.0
        place = np.array([20.0 * (number % 3 - 1), along, 425.0 - 10.0 * number])
        for name in ("on", "off"):
            image = board_picture(rig, rays, turn, place - turn @ middle, rng, lasers=name == "on")
            cv2.imwrite(str(folder / "sheets" / name / f"{number:02d}.png"), image)


def write_heights(folder: Path, rig: SimulatedRig, heights: tuple[float, ...], *, seed: int) -> None:
    """Write heights/: one long block under both stripes in each picture, the bare bed at 0."""
    (folder / "heights").mkdir()
    lines = ["frame,height_mm"]
    for number, height in enumerate(heights):
        things = [box("block", (170.0, 60.0, height), 0.0, 4.0, 1.0, Material())] if height > 0 else []
        renderer = Renderer(build_world(things, Material((0.46, 0.50, 0.52), 0.08), seed=seed), rig, seed=seed)
        cv2.imwrite(str(folder / "heights" / f"{number:02d}.png"), renderer.render(number, 0.0))
        lines.append(f"{number:02d}.png,{height:g}")
    (folder / "heights" / "heights.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_tof(folder: Path, rendered: RenderedCapture, tof: TrueTof, *, seed: int, spoiled: float = 0.0) -> None:
    """Write tof/samples.csv: a raster over the whole scene, in ADC counts."""
    rng = np.random.default_rng(seed)
    rig, scene = rendered.rig, rendered.scene
    world = build_world(scene.things, scene.bed, seed=1)
    beam = turn_deg(np.eye(3)[0], tof.tilt_deg[0]) @ turn_deg(np.eye(3)[1], tof.tilt_deg[1]) @ [0.0, 0.0, -1.0]
    yaw = np.radians(tof.slide_yaw_deg)
    slide = tof.slide_scale * np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    low = min(float(t.mesh.bounds[0][1]) for t in scene.things) - 15.0
    high = max(float(t.mesh.bounds[1][1]) for t in scene.things) + 15.0
    first = (scene.span_mm[0] - tof.place_mm[0] - 8.0) / rig.travel[0]
    last = (scene.span_mm[1] - tof.place_mm[0] + 8.0) / rig.travel[0]
    sweep = np.arange(low, high, tof.sweep_mm_s * tof.sample_s)
    carts, slides = [], []
    for number, cart in enumerate(np.arange(first, last, tof.advance_mm)):
        carts.append(np.full(len(sweep), cart))
        slides.append(sweep if number % 2 == 0 else sweep[::-1])
    cart_mm, slide_mm = np.concatenate(carts), np.concatenate(slides)
    origins = np.array(tof.place_mm) + rig.travel * cart_mm[:, None] + slide * slide_mm[:, None]
    places, _ = first_hits(world.bvh, origins, np.broadcast_to(beam, origins.shape))
    distance = np.minimum(places, origins[:, 2] / -beam[2])
    keep = np.exp(-tof.sample_s / tof.lag_s) if tof.lag_s > 0 else 0.0
    seen = np.empty_like(distance)
    seen[0] = distance[0]
    for i in range(1, len(distance)):
        seen[i] = keep * seen[i - 1] + (1 - keep) * distance[i]
    seen += rng.normal(0.0, tof.noise_mm, len(seen))
    if spoiled:
        bad = rng.random(len(seen)) < spoiled
        seen[bad] = rng.uniform(62, 138, int(bad.sum()))
    counts = np.rint((seen - 60.0) / 80.0 * 4095)
    time = np.arange(len(seen)) * tof.sample_s
    (folder / "tof").mkdir()
    rows = [f"{t:.4f},{c:.4f},{s:.4f},{r:.0f}" for t, c, s, r in zip(time, cart_mm, slide_mm, counts, strict=True)]
    (folder / "tof" / "samples.csv").write_text(
        "time_s,cart_mm,slide_mm,adc\n" + "\n".join(rows) + "\n", encoding="utf-8"
    )


def whole_capture(
    folder: Path,
    scene: str | Scene,
    rig: SimulatedRig,
    *,
    seed: int,
    pitch_mm: float = 1.0,
    tof: TrueTof | None = None,
    boards: bool = True,
) -> RenderedCapture:
    """A capture with laser/, camera/, motion/ and tof/."""
    chosen = named_scene(scene) if isinstance(scene, str) else scene
    rendered = render_capture(
        folder, chosen, rig=rig, pitch_mm=pitch_mm, seed=seed, travel_mm=_really_swept_mm(rig, chosen)
    )
    description = json.loads((folder / "capture.json").read_text(encoding="utf-8"))
    if boards:
        write_boards(folder, rig, seed=seed)
        description["board"] = {"kind": "chessboard", "columns": COLUMNS, "rows": ROWS, "square_mm": SQUARE_MM}
    if tof is not None:
        write_tof(folder, rendered, tof, seed=seed)
        description["tof"] = {
            "range_mm": [60, 140], "volts": [-4, 4], "adc_counts": 4096, "mount_mm": list(tof.known_mm),
        }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(description), encoding="utf-8")
    return rendered


def _really_swept_mm(rig: SimulatedRig, scene: Scene) -> tuple[float, float]:
    """Positions of the cart between which the lasers as they are, not only as their owner believes, sweep a scene."""
    known = swept_travel_mm(rig, scene)
    lasers = tuple(
        replace(
            laser,
            known_baseline_mm=laser.known_baseline_mm + laser.baseline_error_mm,
            known_angle_deg=laser.known_angle_deg + laser.angle_error_deg,
            baseline_error_mm=0.0,
            angle_error_deg=0.0,
        )
        for laser in rig.lasers
    )
    real = swept_travel_mm(replace(rig, lasers=lasers, known_camera_height_mm=rig.camera_height_mm), scene)
    return min(known[0], real[0]) - known[0], max(known[1], real[1]) - known[0]


def misaligned_rig(seed: int) -> SimulatedRig:
    """A machine with errors of 0.3 to 1 degree and 1 to 6 mm that its owner does not know of."""
    rng = np.random.default_rng(seed)

    def sign(low: float, high: float) -> float:
        return float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))

    return SimulatedRig(
        camera_height_mm=430.0 + sign(1.0, 4.0),
        tilt_deg=(sign(0.3, 1.0), sign(0.3, 1.0), sign(0.3, 1.0)),
        lasers=tuple(
            SimulatedLaser(
                side, 250.0, 64.0, sign(1.0, 6.0), sign(0.3, 1.0), yaw_deg=sign(0.3, 1.0), roll_deg=sign(0.3, 1.0)
            )
            for side in ("+v", "-v")
        ),
        travel_yaw_deg=sign(0.3, 1.0),
        travel_scale=1.0 + sign(0.003, 0.006),
    )
