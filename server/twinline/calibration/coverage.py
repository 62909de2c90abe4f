"""Where in the image and under which tilts a board was shown, and what is still missing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray

GRID = (8, 5)
TILT_RINGS_DEG = (15.0, 30.0, 45.0)
DIRECTIONS = ("right", "down", "left", "up")

_REGIONS = (
    ("upper left corner", "upper edge", "upper right corner"),
    ("left edge", "middle", "right edge"),
    ("lower left corner", "lower edge", "lower right corner"),
)
_ENOUGH_PER_REGION = 2
_TILT_WANTED_DEG = 30.0
_DEPTH_RATIO_WANTED = 1.25


@dataclass(frozen=True)
class Advice:
    """One thing to know about the views so far: whether it is still missing, in a few words, with its number."""

    missing: bool
    text: str
    detail: str


@dataclass(frozen=True, eq=False)
class Coverage:
    """What a set of views covers.

    Attributes
    ----------
    cells : (5, 8) int array
        Points seen in each cell of a grid over the image, by row and column.
    share
        Share of the cells with at least one point, 0 to 1.
    tilts_deg : (v,) array
        Angle of each view's board to the image plane.
    directions_deg : (v,) array
        Direction to which it faces, in the image: 0 right, 90 down, 180 left, -90 up.
    rings : (4, 4) int array
        Views by direction (right, down, left, up) and tilt (to 15, to 30, to 45 degrees, beyond); the first column
        counts every view below 15 degrees once, under the direction nearest to it.
    distances_mm : (v,) array
        From the camera to the middle of the board.
    advice
        What is missing, and what is good, most urgent first.
    """

    cells: IntArray
    share: float
    tilts_deg: FloatArray
    directions_deg: FloatArray
    rings: IntArray
    distances_mm: FloatArray
    advice: tuple[Advice, ...]


def coverage(
    pixels: Sequence[FloatArray],
    rotations: FloatArray,
    centres_mm: FloatArray,
    size: tuple[int, int],
) -> Coverage:
    """Coverage of the image and of the board's poses.

    Parameters
    ----------
    pixels
        Points seen in each view, (n, 2).
    rotations : (v, 3, 3) array
        Rotations ``camera_from_board``.
    centres_mm : (v, 3) array
        Middle of the board in the camera frame.
    size
        Width and height of the image in pixels.
    """
    cells, views = _cells(pixels, size)
    # The board's z points away from the viewer, so its face looks along -z.
    facing = -np.asarray(rotations)[:, :, 2]
    tilts = np.degrees(np.arccos(np.clip(-facing[:, 2], -1.0, 1.0)))
    directions = np.degrees(np.arctan2(facing[:, 1], facing[:, 0]))
    rings = np.zeros((4, 4), dtype=np.int64)
    quarter = np.round(directions / 90.0).astype(int) % 4
    np.add.at(rings, (quarter, np.searchsorted(TILT_RINGS_DEG, tilts)), 1)
    distances = np.linalg.norm(centres_mm, axis=1)
    advice = (*_image_advice(views), *_tilt_advice(rings), *_distance_advice(distances))
    ordered = tuple(sorted(advice, key=lambda item: not item.missing))
    return Coverage(cells, float((cells > 0).mean()), tilts, directions, rings, distances, ordered)


def _cells(pixels: Sequence[FloatArray], size: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Points per cell of the fine grid, and views per cell of the coarse one of nine regions."""
    columns, rows = GRID
    cells = np.zeros((rows, columns), dtype=np.int64)
    regions = np.zeros((3, 3), dtype=np.int64)
    for points in pixels:
        share = np.clip((points + 0.5) / np.array(size), 0.0, 1.0 - 1e-9)
        np.add.at(cells, (tuple((share[:, ::-1] * (rows, columns)).astype(int).T)), 1)
        seen = {tuple(place) for place in (share[:, ::-1] * 3).astype(int)}
        for row, column in seen:
            regions[row, column] += 1
    return cells, regions


def _image_advice(regions: IntArray) -> list[Advice]:
    advice = []
    for row, names in enumerate(_REGIONS):
        for column, name in enumerate(names):
            views = int(regions[row, column])
            if views < _ENOUGH_PER_REGION:
                state = "is empty" if views == 0 else "is thin"
                advice.append(Advice(True, f"{name[0].upper()}{name[1:]} {state}", f"{_views(views)} there"))
    return advice or [Advice(False, "Image", "every region covered")]


def _tilt_advice(rings: IntArray) -> list[Advice]:
    advice = []
    for number, direction in enumerate(DIRECTIONS):
        beyond = int(rings[number, 2:].sum())
        if beyond == 0:
            some = int(rings[number, 1])
            where = {"left": "to the left", "right": "to the right"}.get(direction, direction)
            text = f"No tilt {where} beyond {_TILT_WANTED_DEG:.0f}°"
            advice.append(Advice(True, text, f"{_views(some)} from 15° to 30°"))
    return advice or [Advice(False, "Tilts", f"beyond {_TILT_WANTED_DEG:.0f}° in all four directions")]


def _distance_advice(distances_mm: FloatArray) -> list[Advice]:
    near, far = float(distances_mm.min()), float(distances_mm.max())
    span = f"{near:.0f} to {far:.0f} mm"
    if far < _DEPTH_RATIO_WANTED * near:
        return [Advice(True, "Distance hardly varies", f"{span}; show the board nearer and farther")]
    return [Advice(False, "Distance", f"varies {span}")]


def _views(count: int) -> str:
    return "no view" if count == 0 else f"{count} view{'s' if count > 1 else ''}"
