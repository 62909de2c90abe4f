"""Pictures of a calibration board, each with a verdict and what to do about it."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.calibration.board import Board
from twinline.calibration.corners import grid_of, nearest_corner_px
from twinline.calibration.detection import Detection, detect_board, grey
from twinline.calibration.foreshortening import tilt_from_homography_deg
from twinline.calibration.sharpness import Appearance, board_appearance, picture_sharpness
from twinline.errors import CalibrationError

Verdict = Literal[
    "found",
    "partial",
    "blurred",
    "over-exposed",
    "under-exposed",
    "too-oblique",
    "too-small",
    "duplicate",
    "mirrored",
    "wrong-size",
    "not-found",
]

MAX_BLUR_PX = 2.5
MAX_TILT_DEG = 65.0
MIN_SPACING_PX = 6.0
MIN_CONTRAST = 25.0
MAX_SATURATED = 0.5
MAX_GROWTH_PX = 0.5
_DUPLICATE_SHARE = 0.02
_PARTIAL_LEAST = 8
_SAME_GRID_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class BoardView:
    """One picture of a board.

    Attributes
    ----------
    name
        What the picture is called in reports, as a file name.
    size
        Width and height of the picture in pixels.
    ids : (n,) int array
        Which points of the board were found; empty where the board was not.
    board_mm : (n, 3) array
        These points in the board's frame.
    pixels : (n, 2) array
        And in the picture.
    verdict, advice
        What became of the picture, and in words: the numbers, and what to do next; empty advice for a good view.
    appearance
        Sharpness and exposure; None where the board was not found.
    tilt_deg
        Angle between the board's normal and the line of sight, from its foreshortening alone; NaN if unknown. It is
        good to some degrees from about 15 degrees on.
    grid_seen
        Inner corners (the larger number first) of the chessboard that is really in the picture, where one was seen.
    """

    name: str
    size: tuple[int, int]
    ids: IntArray
    board_mm: FloatArray
    pixels: FloatArray
    verdict: Verdict = "found"
    advice: str = ""
    appearance: Appearance | None = None
    tilt_deg: float = float("nan")
    grid_seen: tuple[int, int] | None = None

    @property
    def usable(self) -> bool:
        """Whether a calibration may use it."""
        return self.verdict in ("found", "partial") and len(self.ids) > 0


def view_of_points(name: str, size: tuple[int, int], board: Board, pixels: FloatArray) -> BoardView:
    """A view of a whole board whose points were measured elsewhere, in the board's order, (n, 2) pixels.

    Raises
    ------
    CalibrationError
        ``wrong-board`` if their number is not the board's.
    """
    if np.shape(pixels) != (board.points, 2):
        raise CalibrationError(
            f"{name} has {len(pixels)} points where the board ({board.describe()}) has {board.points}; correct the "
            "board's columns and rows.",
            code="wrong-board",
        )
    return BoardView(name, size, np.arange(board.points), board.points_mm(), np.asarray(pixels, dtype=np.float64))


def inspect_view(name: str, image: ByteArray, board: Board) -> BoardView:
    """Find the board in one picture and judge whether the picture is fit for calibration.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) uint8 array
        The picture.
    """
    picture = grey(image)
    found = detect_board(picture, board)
    size = (picture.shape[1], picture.shape[0])
    points = board.points_mm()[found.ids]
    view = BoardView(name, size, found.ids, points, found.pixels, grid_seen=found.grid_seen)
    if not found:
        return _not_found(view, picture, found, board)
    grid = grid_of(found.ids, found.pixels, board.columns, board.rows)
    reach = 0.4 if board.marker_mm is None else 0.4 * (1.0 - board.marker_mm / board.square_mm)
    appearance = board_appearance(picture, grid, circles="circles" in board.kind, reach=reach)
    tilt = tilt_from_homography_deg(points, found.pixels)
    return _judged(replace(view, appearance=appearance, tilt_deg=tilt), grid, board)


def _judged(view: BoardView, grid: FloatArray, board: Board) -> BoardView:
    seen = view.appearance
    spacing = float(np.nanmin(nearest_corner_px(grid))) if len(view.ids) > 1 else 0.0
    missing = board.points - len(view.ids)
    if len(view.ids) < min(_PARTIAL_LEAST, board.points) or np.linalg.matrix_rank(view.board_mm, tol=1e-9) < 2:
        return replace(
            view,
            verdict="not-found",
            advice=f"only {len(view.ids)} of {board.points} points are seen; move the board into the picture",
        )
    if seen is not None and seen.saturated > MAX_SATURATED and seen.growth_px > MAX_GROWTH_PX:
        advice = (
            f"{100 * seen.saturated:.0f} % of its bright parts are at full scale and reach {seen.growth_px:.1f} px "
            "into the dark ones; shorten the exposure"
        )
        return replace(view, verdict="over-exposed", advice=advice)
    if seen is not None and seen.blur_px > min(MAX_BLUR_PX, 0.25 * spacing):
        advice = f"blurred, its edges are {seen.blur_px:.1f} px wide; hold the board still and focus on it"
        return replace(view, verdict="blurred", advice=advice)
    if seen is not None and seen.contrast < MIN_CONTRAST:
        advice = f"bright and dark differ by {seen.contrast:.0f} grey levels only; use more light or a longer exposure"
        return replace(view, verdict="under-exposed", advice=advice)
    if spacing < MIN_SPACING_PX:
        advice = f"its points are {spacing:.1f} px apart; bring the board nearer"
        return replace(view, verdict="too-small", advice=advice)
    if view.tilt_deg > MAX_TILT_DEG:
        advice = f"tilted by {view.tilt_deg:.0f}°; stay below {MAX_TILT_DEG:.0f}°"
        return replace(view, verdict="too-oblique", advice=advice)
    if missing:
        return replace(view, verdict="partial", advice=f"{missing} of {board.points} points are hidden")
    return view


def _not_found(view: BoardView, picture: ByteArray, found: Detection, board: Board) -> BoardView:
    if found.mirrored:
        advice = "the board is seen mirrored; switch off the camera's flip, or print the board unmirrored"
        return replace(view, verdict="mirrored", advice=advice)
    blur = picture_sharpness(picture)
    if blur > MAX_BLUR_PX:
        advice = f"no whole board seen, and the sharpest edges are {blur:.1f} px wide; focus on it and hold it still"
        return replace(view, verdict="blurred", advice=advice)
    if found.grid_seen is not None:
        return _other_grid(view, found.grid_seen, board)
    bright, dark = float(np.percentile(picture, 98)), float(np.percentile(picture, 2))
    if dark > 230 or (picture >= 254).mean() > MAX_SATURATED:
        advice = (
            f"no board seen, and {100 * (picture >= 254).mean():.0f} % of the picture is at full scale; expose less"
        )
        return replace(view, verdict="over-exposed", advice=advice)
    if bright - dark < MIN_CONTRAST:
        advice = f"no board seen, and the picture spans {bright - dark:.0f} grey levels only; use more light"
        return replace(view, verdict="under-exposed", advice=advice)
    return replace(
        view, advice=f"no {board.describe()} seen; bring the whole board into the picture", verdict="not-found"
    )


def _other_grid(view: BoardView, grid: tuple[int, int], board: Board) -> BoardView:
    columns, rows = grid
    if columns * rows <= board.points:
        advice = (
            f"only {columns} x {rows} of the {board.columns} x {board.rows} corners are seen; bring the whole board "
            "into the picture, or use a ChArUco board"
        )
        return replace(view, verdict="partial", advice=advice)
    advice = f"{columns} x {rows} inner corners are seen, not {board.columns} x {board.rows}; correct the board"
    return replace(view, verdict="wrong-size", advice=advice)


def compare_views(views: Iterable[BoardView], board: Board) -> tuple[BoardView, ...]:
    """Judge views against each other: the same pose twice, and a board of another size than was stated.

    Returns
    -------
    tuple of BoardView
        In the same order; of views that show the same pose the first keeps its verdict.
    """
    seen = tuple(views)
    actual = actual_grid(seen, board)
    if actual is not None:
        advice = (
            f"{actual[0]} x {actual[1]} inner corners are seen, not {board.columns} x {board.rows}; correct the board"
        )
        return tuple(
            replace(view, verdict="wrong-size", advice=advice) if view.usable or view.grid_seen else view
            for view in seen
        )
    kept: list[BoardView] = []
    judged: list[BoardView] = []
    for view in seen:
        twin = next((other for other in kept if view.usable and _same_pose(view, other)), None)
        if twin is not None:
            advice = f"shows the board as in {twin.name}; move or tilt it between pictures"
            judged.append(replace(view, verdict="duplicate", advice=advice))
            continue
        if view.usable:
            kept.append(view)
        judged.append(view)
    return tuple(judged)


def actual_grid(views: Sequence[BoardView], board: Board) -> tuple[int, int] | None:
    """Size of the chessboard that most pictures show, if it is not the stated one; None if it is, or is unknown.

    The stated size may be found inside a larger board, so what is found does not prove it.
    """
    stated = (max(board.columns, board.rows), min(board.columns, board.rows))
    counts = Counter(view.grid_seen for view in views if view.grid_seen is not None)
    if board.kind != "chessboard" or not counts or stated in counts:
        return None
    size, number = counts.most_common(1)[0]
    found_whole = sum(view.usable for view in views)
    wider = size[0] >= stated[0] and size[1] >= stated[1]
    if number < max(1, _SAME_GRID_SHARE * sum(counts.values())):
        return None
    return size if wider or not found_whole else None


def _same_pose(view: BoardView, other: BoardView) -> bool:
    """Whether all common points lie within 2 % of the board's extent of each other."""
    common, here, there = np.intersect1d(view.ids, other.ids, assume_unique=True, return_indices=True)
    if len(common) < 4 or view.size != other.size:
        return False
    moved = np.linalg.norm(view.pixels[here] - other.pixels[there], axis=1)
    extent = float(np.linalg.norm(np.ptp(other.pixels[there], axis=0)))
    return bool(moved.max() < _DUPLICATE_SHARE * extent)
