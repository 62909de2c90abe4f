"""Calibration boards to print, as PDF: vectors in exact size, with a bar to measure on the print.

The format is Adobe Systems, "PDF Reference", sixth edition (PDF 1.7); only its simplest parts are used.
"""

from pathlib import Path
from typing import Literal, get_args

from twinline.calibration.board import Board
from twinline.errors import CalibrationError
from twinline.operations.exports.atomic import atomic_path

Paper = Literal["A4", "A3", "A2", "A1", "letter", "tabloid"]

PAPERS_MM: dict[Paper, tuple[float, float]] = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}

_POINTS_PER_MM = 72.0 / 25.4
_MARGIN_MM = 8.0
_LEGEND_MM = 22.0
_TEXT_MM = 3.4
_BARS_MM = (100.0, 50.0, 20.0)
_CIRCLE_SHARE = 0.25
# Control points of four Bezier arcs that deviate from a circle by 0.03 % of its radius.
_KAPPA = 0.5522847498


def board_page_mm(board: Board, paper: Paper) -> tuple[float, float]:
    """Width and height of the page on which a board fits, upright or lying.

    Raises
    ------
    CalibrationError
        ``bad-board`` if it fits neither way, or there is no such paper.
    """
    if paper not in get_args(Paper):
        raise CalibrationError(
            f"There is no paper {paper!r}; use one of {', '.join(get_args(Paper))}.", code="bad-board"
        )
    width, height = board_size_mm(board)
    short, long = PAPERS_MM[paper]
    for page in ((short, long), (long, short)):
        if width + 2 * _MARGIN_MM <= page[0] and height + 2 * _MARGIN_MM + _LEGEND_MM <= page[1]:
            return page
    fitting = [name for name, size in PAPERS_MM.items() if _fits(width, height, size)]
    step = f"use {' or '.join(fitting[:2])}, or smaller squares" if fitting else "use smaller squares or fewer of them"
    raise CalibrationError(
        f"The board is {width:.0f} x {height:.0f} mm and does not fit on {paper} ({short:g} x {long:g} mm); {step}.",
        code="bad-board",
    )


def _fits(width: float, height: float, paper: tuple[float, float]) -> bool:
    pages = (paper, paper[::-1])
    return any(width + 2 * _MARGIN_MM <= w and height + 2 * _MARGIN_MM + _LEGEND_MM <= h for w, h in pages)


def board_size_mm(board: Board) -> tuple[float, float]:
    """Width and height of the printed pattern."""
    if "circles" in board.kind:
        x, y, _ = board.points_mm().max(axis=0)
        return float(x) + board.square_mm, float(y) + board.square_mm
    return (board.columns + 1) * board.square_mm, (board.rows + 1) * board.square_mm


def write_board_pdf(path: Path, board: Board, paper: Paper = "A4") -> None:
    """Write a board as a page to print at 100 %.

    Under the board stand its description, a bar of a stated length to measure, and how to print.

    Raises
    ------
    CalibrationError
        ``bad-board`` if the board does not fit on the paper.
    OutputError
        If the file cannot be written; nothing is left behind then.
    """
    page = board_page_mm(board, paper)
    data = _document(page, _content(board, page), board.describe())
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _content(board: Board, page: tuple[float, float]) -> str:
    """Drawing commands in millimetres from the lower left of the page."""
    width, height = board_size_mm(board)
    left = (page[0] - width) / 2
    top = page[1] - (page[1] - _LEGEND_MM - height) / 2
    shapes = _circles(board, left, top) if "circles" in board.kind else _squares(board, left, top)
    commands = [f"{_POINTS_PER_MM:.9f} 0 0 {_POINTS_PER_MM:.9f} 0 0 cm", "0 g"]
    # One path for all: shapes that touch would else show hairlines between them.
    return "\n".join([*commands, *shapes, "f", *_legend(board, page)])


def _squares(board: Board, left: float, top: float) -> list[str]:
    side = board.square_mm
    shapes = [
        _rectangle(left + column * side, top - (row + 1) * side, side, side)
        for row in range(board.rows + 1)
        for column in range(board.columns + 1)
        if (row + column) % 2 == 0
    ]
    for column, row, white in board.markers():
        marker = board.marker_mm or 0.0
        cells = len(white) + 2
        cell = marker / cells
        x, y = left + column * side + (side - marker) / 2, top - row * side - (side - marker) / 2
        for i in range(cells):
            for j in range(cells):
                inside = 0 < i < cells - 1 and 0 < j < cells - 1
                if not (inside and white[i - 1, j - 1]):
                    shapes.append(_rectangle(x + j * cell, y - (i + 1) * cell, cell, cell))
    return shapes


def _circles(board: Board, left: float, top: float) -> list[str]:
    radius = _CIRCLE_SHARE * board.square_mm * (1.4 if board.kind == "asymmetric-circles" else 1.0)
    margin = board.square_mm / 2
    return [_circle(left + margin + x, top - margin - y, radius) for x, y, _ in board.points_mm()]


def _legend(board: Board, page: tuple[float, float]) -> list[str]:
    room = page[0] - 2 * _MARGIN_MM
    bar = next((length for length in _BARS_MM if length <= room), _BARS_MM[-1])
    x, y = _MARGIN_MM, _MARGIN_MM + 3.0
    lines = [
        f"Twinline calibration board: {board.describe()}",
        "Print at 100 % (actual size, no fit to page), mount on a flat plate, then measure the bar and a long row.",
    ]
    return [
        "0.2 w 0 G",
        f"{x:.4f} {y:.4f} m {x + bar:.4f} {y:.4f} l S",
        f"{x:.4f} {y - 1.5:.4f} m {x:.4f} {y + 1.5:.4f} l S",
        f"{x + bar:.4f} {y - 1.5:.4f} m {x + bar:.4f} {y + 1.5:.4f} l S",
        _text(x + bar + 2.0, y - 1.0, f"this bar is {bar:.1f} mm"),
        *(_text(x, y + 10.0 - 5.0 * i, line, _fitting_size(line, room)) for i, line in enumerate(lines)),
    ]


def _fitting_size(text: str, room_mm: float) -> float:
    # Helvetica's letters are half as wide as high on average.
    return min(_TEXT_MM, room_mm / (0.52 * len(text)))


def _rectangle(x: float, y: float, width: float, height: float) -> str:
    return f"{x:.5f} {y:.5f} {width:.5f} {height:.5f} re"


def _circle(x: float, y: float, r: float) -> str:
    k = _KAPPA * r
    arcs = [
        (x + r, y + k, x + k, y + r, x, y + r),
        (x - k, y + r, x - r, y + k, x - r, y),
        (x - r, y - k, x - k, y - r, x, y - r),
        (x + k, y - r, x + r, y - k, x + r, y),
    ]
    return f"{x + r:.5f} {y:.5f} m " + " ".join(" ".join(f"{v:.5f}" for v in arc) + " c" for arc in arcs)


def _text(x: float, y: float, text: str, size_mm: float = _TEXT_MM) -> str:
    escaped = text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
    return f"BT /F1 {size_mm:.3f} Tf {x:.4f} {y:.4f} Td ({escaped}) Tj ET"


def _document(page_mm: tuple[float, float], content: str, title: str) -> bytes:
    """A PDF of one page."""
    width, height = (side * _POINTS_PER_MM for side in page_mm)
    stream = content.encode("cp1252", errors="replace")
    name = title.replace("\\", "").replace("(", "").replace(")", "").encode("ascii", errors="replace").decode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] "
        "/Resources << /Font << /F1 5 0 R >> >> /Contents 4 0 R >>".encode("ascii"),
        f"<< /Length {len(stream)} >>\nstream\n".encode("ascii") + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        f"<< /Title ({name}) /Creator (Twinline) >>".encode("ascii"),
    ]
    out = bytearray(b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n")
    places = []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    start = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info 6 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, start)
    return bytes(out)
