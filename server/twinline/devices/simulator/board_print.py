"""A calibration board as a thing: a plate with a printed face, drawn from the board's description."""

import cv2
import numpy as np
import trimesh

from twinline.arrays import FloatArray
from twinline.calibration.board import Board
from twinline.devices.simulator.turns import turn_deg
from twinline.devices.simulator.world import Material, Print, Thing

PAPER, INK = 0.84, 0.05
"""Shares of light that come back."""
_FINE_MM = 0.05
_COARSE = 3
_SOFT_MM = 0.31
"""Standard deviation of what a camera 430 mm above takes away: 0.7 px of blur and the pixel's own width."""
_MARGIN_SQUARES = 0.6


def default_board() -> Board:
    """The board that ``twinline board`` prints unless told otherwise, on a plate."""
    return Board("charuco", 9, 6, 18.0, thickness_mm=3.0, dictionary="DICT_5X5_100", marker_mm=13.5)


def printed_face(board: Board, texel_mm: float = _FINE_MM) -> tuple[FloatArray, tuple[float, float]]:
    """Draw the printed face.

    Returns
    -------
    (rows, columns) array of float32, (float, float)
        Share of light that comes back, and the place of the middle of texel 0, 0 in the board's frame, mm.
    """
    square = board.square_mm
    circles = board.kind in ("circles", "asymmetric-circles")
    points = board.points_mm()
    border = (1.0 if circles else 1.0 + _MARGIN_SQUARES) * square
    low = points[:, :2].min(axis=0) - border
    high = points[:, :2].max(axis=0) + border
    columns, rows = (np.ceil((high - low) / texel_mm)).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * texel_mm
    y = low[1] + (np.arange(rows) + 0.5) * texel_mm
    if circles:
        face = np.full((rows, columns), PAPER, dtype=np.float32)
        for at_x, at_y, _ in points:
            near = np.hypot(x[np.newaxis, :] - at_x, y[:, np.newaxis] - at_y) < 0.3 * square
            face[near] = INK
    else:
        face = _squares(board, x, y)
    return face, (float(x[0]), float(y[0]))


def _squares(board: Board, x: FloatArray, y: FloatArray) -> FloatArray:
    """Dark and light squares, and markers in the light ones; the square left above the first corner is dark."""
    i = np.floor(x / board.square_mm).astype(int) + 1
    j = np.floor(y / board.square_mm).astype(int) + 1
    inside = ((i >= 0) & (i <= board.columns))[np.newaxis, :] & ((j >= 0) & (j <= board.rows))[:, np.newaxis]
    dark = inside & ((i[np.newaxis, :] + j[:, np.newaxis]) % 2 == 0)
    face = np.where(dark, INK, PAPER).astype(np.float32)
    for column, row, bits in board.markers():
        assert board.marker_mm is not None
        cells = np.pad(bits, 1)
        side = board.marker_mm / len(cells)
        start = 0.5 * (board.square_mm - board.marker_mm)
        left, top = (column - 1) * board.square_mm + start, (row - 1) * board.square_mm + start
        c = np.floor((x - left) / side).astype(int)
        r = np.floor((y - top) / side).astype(int)
        columns, rows = (np.flatnonzero((k >= 0) & (k < len(cells))) for k in (c, r))
        face[np.ix_(rows, columns)] = np.where(cells[np.ix_(r[rows], c[columns])], PAPER, INK)
    return face


def board_axes(yaw_deg: float) -> FloatArray:
    """(3, 3) rotation from the frame of a board that lies on the bed to the bed's, its rows across the travel."""
    face_up = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return np.asarray(turn_deg(np.array([0.0, 0.0, 1.0]), yaw_deg) @ face_up)


def board_thing(board: Board, x_mm: float, y_mm: float, yaw_deg: float) -> Thing:
    """A board lying on the bed, face up, the middle of its inner corners at x, y."""
    face, first = printed_face(board)
    rows, columns = (size // _COARSE * _COARSE for size in face.shape)
    size = (columns // _COARSE, rows // _COARSE)
    coarse = cv2.resize(face[:rows, :columns], size, interpolation=cv2.INTER_AREA)
    texel = _FINE_MM * _COARSE
    soft = cv2.GaussianBlur(coarse, (0, 0), _SOFT_MM / texel, borderType=cv2.BORDER_REPLICATE)
    axes = board_axes(yaw_deg)
    middle = board.points_mm().mean(axis=0)
    origin = np.array([x_mm, y_mm, board.thickness_mm]) - axes @ middle
    shift = 0.5 * (_COARSE - 1) * _FINE_MM
    corner = origin + axes @ np.array([first[0] + shift, first[1] + shift, 0.0])
    along = ((float(axes[0, 0]), float(axes[1, 0])), (float(axes[0, 1]), float(axes[1, 1])))
    printed = Print(np.asarray(soft, dtype=np.float32), (float(corner[0]), float(corner[1])), along, texel)
    thickness = max(board.thickness_mm, 0.1)
    # A texel less all round, so that no part of the face is beyond the print.
    extents = (texel * (size[0] - 2), texel * (size[1] - 2), thickness)
    mesh = trimesh.creation.box(extents)
    turn = np.eye(4)
    turn[:3, :3] = axes
    centre = origin + axes @ np.array([first[0] + 0.5 * texel * size[0], first[1] + 0.5 * texel * size[1], 0.0])
    turn[:3, 3] = (centre[0], centre[1], board.thickness_mm - 0.5 * thickness)
    mesh.apply_transform(turn)
    sizes = {
        "x": x_mm, "y": y_mm, "z": board.thickness_mm, "yaw_deg": yaw_deg, "square": board.square_mm,
        "columns": float(board.columns), "rows": float(board.rows),
    }  # fmt: skip
    return Thing("board", "board", sizes, mesh, Material((PAPER, PAPER, PAPER), 0.0), printed=printed)
