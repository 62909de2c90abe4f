"""``capture.json``: what the owner of a scanner knows about it before calibration, parsed strictly."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import CaptureError
from twinline.geometry.rig import StripeRuns
from twinline.geometry.sheet import SIDES, Side
from twinline.recording.json_fields import MAX_NUMBER, Fields, as_number, parse_object

BoardKind = Literal["chessboard", "charuco", "circles"]

_MAX_BYTES = 1_000_000
_MAX_PIXELS = 32768
_MAX_BOARD = 1000
_RUNS: tuple[StripeRuns, ...] = ("along-u", "along-v")
_BOARD_KINDS: tuple[BoardKind, ...] = ("chessboard", "charuco", "circles")


@dataclass(frozen=True)
class Board:
    """A calibration board; ``columns`` and ``rows`` count inner corners (circles for a board of circles).

    Attributes
    ----------
    square_mm
        Side of a square, or distance between neighbouring circles.
    thickness_mm
        Height of the printed face above the surface the board lies on.
    dictionary, marker_mm
        Name of the marker dictionary and side of a marker; for ``charuco`` only.
    """

    kind: BoardKind
    columns: int
    rows: int
    square_mm: float
    thickness_mm: float = 0.0
    dictionary: str | None = None
    marker_mm: float | None = None


@dataclass(frozen=True)
class LaserNominal:
    """A laser as built: distance to the camera along the travel, angle of its sheet to that baseline, side."""

    baseline_mm: float
    angle_deg: float
    side: Side


@dataclass(frozen=True)
class TofNominal:
    """The point distance sensor as built.

    Attributes
    ----------
    range_mm : (float, float)
        Shortest and longest valid distance.
    mount_mm : (float, float, float)
        Sensor at slide position 0 against the camera centre's foot point on the bed: x along the travel, y across,
        z above the bed.
    volts : (float, float) or None
        Voltages at the two ends of the range.
    adc_counts
        Number of codes of the converter; code 0 is the first voltage, the last code the second.
    """

    range_mm: tuple[float, float]
    mount_mm: tuple[float, float, float]
    volts: tuple[float, float] | None = None
    adc_counts: int | None = None


@dataclass(frozen=True, eq=False)
class CaptureInfo:
    """The contents of ``capture.json``.

    Attributes
    ----------
    image_size : (int, int)
        Width and height of every picture in pixels.
    camera_matrix_guess : (3, 3) array
        Pixels.
    board
        None where there is none; the camera and the sheets cannot be calibrated then.
    camera_height_mm
        Camera centre above the bed.
    tof
        None without such a sensor.
    """

    name: str
    image_size: tuple[int, int]
    stripe_runs: StripeRuns
    camera_matrix_guess: FloatArray
    camera_height_mm: float
    lasers: tuple[LaserNominal, ...]
    board: Board | None = None
    tof: TofNominal | None = None


def read_capture_json(path: Path) -> CaptureInfo:
    """Read and check ``capture.json``.

    Raises
    ------
    CaptureError
        Naming the file and the field, as ``lasers[1].side``.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise CaptureError(f"{path} is missing; a capture folder needs one that describes the scanner.") from error
    except OSError as error:
        raise CaptureError(f"{path} cannot be read: {error.strerror or error}.") from error
    if len(data) > _MAX_BYTES:
        raise CaptureError(f"{path} is larger than {_MAX_BYTES} bytes; it is no description of a scanner.")
    return parse_capture_json(data, path)


def parse_capture_json(data: bytes, path: Path) -> CaptureInfo:
    """Check the text of a ``capture.json``; ``path`` is for the error's words only."""
    return _capture(parse_object(data, path))


def capture_json_text(info: CaptureInfo) -> str:
    """The text of a ``capture.json`` that says the same; reading it gives it back exactly."""
    fields: dict[str, object] = {
        "name": info.name,
        "image_size": list(info.image_size),
        "stripe_runs": info.stripe_runs,
        "camera_matrix_guess": info.camera_matrix_guess.tolist(),
        "camera_height_mm": info.camera_height_mm,
        "lasers": [asdict(laser) for laser in info.lasers],
    }
    for name, part in (("board", info.board), ("tof", info.tof)):
        if part is not None:
            fields[name] = {key: value for key, value in asdict(part).items() if value is not None}
    return json.dumps(fields, indent=1)


def _capture(fields: Fields) -> CaptureInfo:
    name = fields.text("name")
    size = fields.get("image_size")
    if not (isinstance(size, list) and len(size) == 2 and all(_is_pixels(n) for n in size)):
        fields.fail("image_size", f"two whole numbers from 1 to {_MAX_PIXELS}, width and height")
    runs = fields.choice("stripe_runs", _RUNS)
    matrix = _camera_matrix(fields)
    board = _board(fields.nested("board")) if fields.has("board") else None
    height = fields.number("camera_height_mm", 0, MAX_NUMBER)
    lasers = _lasers(fields, runs)
    tof = _tof(fields.nested("tof")) if fields.has("tof") else None
    fields.done()
    return CaptureInfo(name, (size[0], size[1]), runs, matrix, height, lasers, board, tof)


def _is_pixels(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MAX_PIXELS


def _camera_matrix(fields: Fields) -> FloatArray:
    value = fields.get("camera_matrix_guess")
    rows = value if isinstance(value, list) and len(value) == 3 else []
    numbers = [as_number(item) for row in rows if isinstance(row, list) and len(row) == 3 for item in row]
    matrix = np.array([n for n in numbers if n is not None])
    if matrix.size != 9:
        fields.fail("camera_matrix_guess", "3 rows of 3 numbers")
    matrix = matrix.reshape(3, 3)
    if min(matrix[0, 0], matrix[1, 1]) <= 0 or matrix[0, 1] or matrix[1, 0] or matrix[2].tolist() != [0, 0, 1]:
        fields.fail("camera_matrix_guess", "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive fx and fy")
    matrix.setflags(write=False)
    return matrix


def _board(fields: Fields) -> Board:
    kind = fields.choice("kind", _BOARD_KINDS)
    columns = fields.whole("columns", 2, _MAX_BOARD)
    rows = fields.whole("rows", 2, _MAX_BOARD)
    square = fields.number("square_mm", 0, MAX_NUMBER)
    thickness = fields.number("thickness_mm", 0, MAX_NUMBER, open_low=False) if fields.has("thickness_mm") else 0.0
    dictionary, marker = None, None
    if kind == "charuco":
        dictionary = fields.text("dictionary")
        marker = fields.number("marker_mm", 0, square)
        if marker >= square:
            fields.fail("marker_mm", f"smaller than square_mm ({square:g})")
    fields.done()
    return Board(kind, columns, rows, square, thickness, dictionary, marker)


def _lasers(fields: Fields, runs: StripeRuns) -> tuple[LaserNominal, ...]:
    objects = fields.objects("lasers")
    if not 1 <= len(objects) <= 2:
        fields.fail("lasers", "a list of one or two lasers")
    across = "v" if runs == "along-u" else "u"
    lasers: list[LaserNominal] = []
    for laser in objects:
        baseline = laser.number("baseline_mm", 0, MAX_NUMBER)
        angle = laser.number("angle_deg", 0, 180)
        if angle >= 180:
            laser.fail("angle_deg", "above 0 and below 180")
        side = laser.choice("side", SIDES)
        if side[1] != across:
            laser.fail("side", f'"+{across}" or "-{across}" where stripe_runs is "{runs}"')
        if any(other.side == side for other in lasers):
            laser.fail("side", "the side opposite to the first laser's")
        laser.done()
        lasers.append(LaserNominal(baseline, angle, side))
    return tuple(lasers)


def _tof(fields: Fields) -> TofNominal:
    low, high = fields.numbers("range_mm", 2)
    if not 0 <= low < high:
        fields.fail("range_mm", "the shortest and the longest distance, 0 or more and ascending")
    volts = None
    if fields.has("volts"):
        first, second = fields.numbers("volts", 2)
        if first == second:
            fields.fail("volts", "two different voltages")
        volts = (first, second)
    counts = fields.whole("adc_counts", 2, 2**32) if fields.has("adc_counts") else None
    x, y, z = fields.numbers("mount_mm", 3)
    fields.done()
    return TofNominal((low, high), (x, y, z), volts, counts)
