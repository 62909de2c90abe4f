"""Calibration boards: chessboard, ChArUco, circles.

A board's frame has x along its rows (to the right of the printed face), y down its columns, and z into the board, away
from the viewer; its origin is the first inner corner (or circle). A chessboard is taken to have a dark square between
its first four inner corners, as the boards that Twinline prints have.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.errors import CalibrationError

BoardKind = Literal["chessboard", "charuco", "circles", "asymmetric-circles"]

_MAX_POINTS = 10_000


@dataclass(frozen=True)
class Board:
    """A printed board; ``columns`` and ``rows`` count inner corners, or circles in a row and rows of circles.

    Attributes
    ----------
    square_mm
        Side of a square, or distance between neighbouring circles. In ``asymmetric-circles`` every second row is
        shifted by this, rows are this far apart, and circles in a row twice as far.
    thickness_mm
        Height of the printed face above the surface the board lies on.
    dictionary, marker_mm
        Name of the marker dictionary (as "DICT_5X5_100", "DICT_" may be left out) and side of a marker's black
        square; for ``charuco`` only.

    Raises
    ------
    CalibrationError
        ``bad-board`` if there can be no such board.
    """

    kind: BoardKind
    columns: int
    rows: int
    square_mm: float
    thickness_mm: float = 0.0
    dictionary: str | None = None
    marker_mm: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(BoardKind):
            raise _impossible(f"its kind must be one of {', '.join(get_args(BoardKind))}, not {self.kind!r}")
        if min(self.columns, self.rows) < 2 or max(self.columns, self.rows) < 3:
            raise _impossible(
                f"{self.columns} x {self.rows} points do not fix a pose; use at least 3 x 2, better 9 x 6 inner corners"
            )
        if self.columns * self.rows > _MAX_POINTS:
            raise _impossible(f"{self.columns} x {self.rows} points are more than {_MAX_POINTS}; use larger squares")
        if not 0 < self.square_mm < np.inf:
            raise _impossible(f"square_mm must be a length above 0, not {self.square_mm:g}")
        if not 0 <= self.thickness_mm < np.inf:
            raise _impossible(f"thickness_mm must be 0 or above, not {self.thickness_mm:g}")
        if self.kind == "asymmetric-circles" and self.rows % 2 == 0:
            raise _impossible(f"with {self.rows} rows it looks the same turned round; use an odd number of rows")
        if self.kind == "charuco":
            self._check_markers()
        elif self.dictionary is not None or self.marker_mm is not None:
            raise _impossible(f"dictionary and marker_mm are for charuco boards, not for {self.kind}")

    def _check_markers(self) -> None:
        if self.dictionary is None or self.marker_mm is None:
            raise _impossible("a charuco board needs a dictionary and marker_mm")
        if not 0 < self.marker_mm < self.square_mm:
            raise _impossible(
                f"marker_mm must be above 0 and below square_mm ({self.square_mm:g}), not {self.marker_mm:g}"
            )
        available = len(marker_dictionary(self.dictionary).bytesList)
        needed = (self.columns + 1) * (self.rows + 1) // 2
        if needed > available:
            raise _impossible(
                f"{needed} markers are needed and {self.dictionary} has {available}; choose a larger dictionary"
            )

    @property
    def points(self) -> int:
        """Number of inner corners or circles."""
        return self.columns * self.rows

    @property
    def turns_seen(self) -> bool:
        """Whether a picture tells which way round the board lies; if not, it may be read turned by 180 degrees."""
        if self.kind == "charuco":
            return True
        if self.kind == "chessboard":
            return (self.columns + self.rows) % 2 == 1
        return self.kind == "asymmetric-circles"

    @property
    def mirroring_seen(self) -> bool:
        """Whether a mirrored picture can be told from a true one; a chessboard looks the same in a mirror."""
        return self.kind == "charuco"

    def describe(self) -> str:
        """The board in words and numbers."""
        size = f"{self.columns} x {self.rows}"
        if self.kind == "charuco":
            return (
                f"ChArUco, {size} inner corners, squares {self.square_mm:g} mm, markers {self.marker_mm:g} mm, "
                f"{self.dictionary}"
            )
        if self.kind == "chessboard":
            return f"chessboard, {size} inner corners, squares {self.square_mm:g} mm"
        name = "circles" if self.kind == "circles" else "asymmetric circles"
        return f"{name}, {size}, spacing {self.square_mm:g} mm"

    def points_mm(self) -> FloatArray:
        """Inner corners or circle centres in the board's frame, row by row.

        Returns
        -------
        (columns * rows, 3) array
            Millimetres; z is 0.
        """
        row, column = np.divmod(np.arange(self.points), self.columns)
        x = 2.0 * column + row % 2 if self.kind == "asymmetric-circles" else column.astype(np.float64)
        return np.asarray(np.column_stack([x, row, np.zeros(self.points)]) * self.square_mm)

    def markers(self) -> tuple[tuple[int, int, BoolArray], ...]:
        """Markers of a ChArUco board in the order of their numbers.

        Returns
        -------
        tuple of (column, row, bits)
            Square the marker stands in, counted from the upper left, and which of its cells are white, (n, n) without
            the black border of one cell around them. Empty for other boards.
        """
        if self.kind != "charuco" or self.dictionary is None:
            return ()
        dictionary = marker_dictionary(self.dictionary)
        size = int(dictionary.markerSize)
        light = [(c, r) for r in range(self.rows + 1) for c in range(self.columns + 1) if (c + r) % 2]
        bits = (cv2.aruco.Dictionary.getBitsFromByteList(code[None], size) for code in dictionary.bytesList)
        return tuple((c, r, np.asarray(cells, dtype=bool)) for (c, r), cells in zip(light, bits, strict=False))


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """A predefined dictionary of markers by its name.

    Raises
    ------
    CalibrationError
        ``bad-board`` if there is none of this name.
    """
    wanted = name.upper() if name.upper().startswith("DICT_") else f"DICT_{name.upper()}"
    known = sorted(key for key in vars(cv2.aruco) if key.startswith("DICT_") and key == key.upper())
    if wanted not in known:
        raise _impossible(f"there is no marker dictionary {name!r}; use one of {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(int(getattr(cv2.aruco, wanted)))


def _impossible(reason: str) -> CalibrationError:
    return CalibrationError(f"The board cannot be used: {reason}.", code="bad-board")
