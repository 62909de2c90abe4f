"""Small laser passes rendered for tests: rays cast from the camera into a bed with one block, lit by sheets of light.

Shares nothing with the package: every pixel's ray is met with the surfaces, and the light there follows from its
distance to the sheet and from whether the laser sees it. Frames: camera x along image u, y along v, z away from the
camera; bed x = camera y + cart, bed y = camera x, bed z = HEIGHT_MM - camera z.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

HEIGHT_MM = 200.0
BASELINE_MM = 150.0
ANGLE_RAD = float(np.radians(60.0))
FOCAL_SHARE = 0.8125
"""Focal length over the picture's width."""

BED_RGB = (70.0, 60.0, 50.0)
BLOCK_RGB = (66.0, 100.0, 48.0)


@dataclass(frozen=True)
class Pass:
    """What to render.

    Attributes
    ----------
    size
        Width and height of the pictures.
    block
        Low and high corner of the block on the bed, in bed millimetres.
    bed_mm
        Height of the bed; what the rig expects is 0.
    cart_mm
        Positions of the frames.
    lasers
        Number of lasers; the first stands on the side of +v, the second on that of -v.
    lit
        Which lasers are on in each frame; None for all in all.
    laser_dn
        Brightness of the stripe, 0 for none.
    colour
        Whether pictures are in colour.
    """

    size: tuple[int, int] = (160, 120)
    block: tuple[tuple[float, float, float], tuple[float, float, float]] = ((-20.0, -40.0, 0.0), (20.0, 30.0, 15.0))
    cart_mm: tuple[float, ...] = tuple(np.arange(-60.0, 61.0, 1.5).tolist())
    bed_mm: float = 0.0
    lasers: int = 2
    lit: tuple[frozenset[int], ...] | None = None
    laser_dn: float = 150.0
    spot_sd_mm: float = 1.8
    noise_dn: float = 1.5
    colour: bool = True
    seed: int = 5

    @property
    def focal_px(self) -> float:
        return FOCAL_SHARE * self.size[0]

    def with_frames(self, count: int, pitch_mm: float = 1.0) -> "Pass":
        """The same scene, in so many frames about its middle."""
        start = -0.5 * pitch_mm * (count - 1)
        return replace(self, cart_mm=tuple(start + pitch_mm * i for i in range(count)))


def _hits(origin: Floats, rays: Floats, given: Pass) -> tuple[Floats, NDArray[np.bool_]]:
    """Distance along rays (n, 3) to the first surface, and whether it is the block; bed frame."""
    to_bed = (given.bed_mm - origin[2]) / rays[:, 2]
    low, high = (np.array(corner) for corner in given.block)
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (low - origin) / rays, (high - origin) / rays
    enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    on_block = (enter < leave) & (enter > 0) & (enter < to_bed)
    return np.where(on_block, enter, to_bed), on_block


def render(given: Pass, place: int) -> Bytes:
    """One frame, blue green red or grey."""
    width, height = given.size
    cart = given.cart_mm[place]
    u, v = (g.ravel().astype(np.float64) for g in np.meshgrid(np.arange(width), np.arange(height)))
    f = given.focal_px
    # Camera x is bed y, camera y is bed x, camera z is down.
    rays = np.column_stack([(v - height / 2) / f, (u - width / 2) / f, -np.ones_like(u)])
    eye = np.array([cart, 0.0, HEIGHT_MM])
    reach, on_block = _hits(eye, rays, given)
    points = eye + reach[:, None] * rays
    colour = np.where(on_block[:, None], BLOCK_RGB, BED_RGB)
    light = np.zeros(len(u))
    lit = given.lit[place] if given.lit is not None else frozenset(range(1, given.lasers + 1))
    for laser in lit:
        sign = 1.0 if laser == 1 else -1.0
        depth = HEIGHT_MM - points[:, 2]
        beside = sign * (points[:, 0] - cart) - (BASELINE_MM - depth / np.tan(ANGLE_RAD))
        distance = beside * np.sin(ANGLE_RAD)
        source = np.array([cart + sign * BASELINE_MM, 0.0, HEIGHT_MM])
        towards = points - source
        first, _ = _hits(source, towards, given)
        light += np.where(first > 1.0 - 1e-6, np.exp(-0.5 * (distance / given.spot_sd_mm) ** 2), 0.0)
    rgb = colour + given.laser_dn * light[:, None] * np.array([1.0, 0.15, 0.1])
    rng = np.random.default_rng([given.seed, place])
    rgb = rgb.reshape(height, width, 3) + rng.normal(0.0, given.noise_dn, (height, width, 3))
    picture = np.clip(np.rint(rgb[..., ::-1]), 0, 255).astype(np.uint8)
    return picture if given.colour else np.ascontiguousarray(picture[..., 2])


def description(given: Pass) -> dict[str, Any]:
    """Its ``capture.json``: the nominal rig is the true one."""
    width, height = given.size
    sides = ("+v", "-v")[: given.lasers]
    return {
        "name": "small pass",
        "image_size": [width, height],
        "stripe_runs": "along-u",
        "camera_matrix_guess": [[given.focal_px, 0, width / 2], [0, given.focal_px, height / 2], [0, 0, 1]],
        "camera_height_mm": HEIGHT_MM,
        "lasers": [{"baseline_mm": BASELINE_MM, "angle_deg": 60.0, "side": side} for side in sides],
    }


def frame_names(count: int, suffix: str = ".png") -> list[str]:
    return [f"{place:04d}{suffix}" for place in range(count)]


def write_list(folder: Path, names: Sequence[str], given: Pass) -> None:
    """``frames.csv``: 40 ms from frame to frame."""
    head = "frame,time_s,cart_mm" + (",lasers" if given.lit is not None else "")
    lines = [head]
    for place, name in enumerate(names):
        on = "" if given.lit is None else "," + "".join(str(laser) for laser in sorted(given.lit[place]))
        lines.append(f"{name},{0.04 * place:.2f},{given.cart_mm[place]:.3f}{on}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_pass(
    folder: Path,
    given: Pass | None = None,
    *,
    part: str = "laser",
    suffix: str = ".png",
    change: Callable[[int, Bytes], Bytes] = lambda _, picture: picture,
) -> Path:
    """Write a capture folder, or one more part of it; ``change`` may spoil pictures."""
    given = given or Pass()
    (folder / part).mkdir(parents=True)
    (folder / "capture.json").write_text(json.dumps(description(given)), encoding="utf-8")
    names = frame_names(len(given.cart_mm), suffix)
    for place, name in enumerate(names):
        assert cv2.imwrite(str(folder / part / name), change(place, render(given, place)))
    write_list(folder / part, names, given)
    return folder


NO_BLOCK = ((900.0, 900.0, 0.0), (901.0, 901.0, 1.0))
"""A block that no frame shows."""


def write_video_pass(folder: Path, given: Pass) -> Path:
    """The same as a lossless video, which is read in blue, green, red."""
    (folder / "laser").mkdir(parents=True)
    (folder / "capture.json").write_text(json.dumps(description(given)), encoding="utf-8")
    path = folder / "laser" / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 25, given.size)
    assert writer.isOpened()
    for place in range(len(given.cart_mm)):
        writer.write(render(given, place))
    writer.release()
    write_list(folder / "laser", [str(place) for place in range(len(given.cart_mm))], given)
    return folder
