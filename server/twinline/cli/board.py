"""``twinline board``."""

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import typer

from twinline.calibration.board import Board, BoardKind
from twinline.operations.exports.board_pdf import Paper, write_board_pdf

MARKER_SHARE = 0.75
"""Side of a marker in squares, unless given: large enough to read, with a white margin that corners need."""


@dataclass(frozen=True)
class BoardRequest:
    """The options of the command."""

    output: Path
    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float | None
    dictionary: str
    paper: str


def run_board(request: BoardRequest) -> None:
    """Write the board, and say what to put into capture.json."""
    charuco = request.kind == "charuco"
    marker_mm = request.marker_mm if request.marker_mm is not None or not charuco else MARKER_SHARE * request.square_mm
    board = Board(
        cast(BoardKind, request.kind),
        request.columns,
        request.rows,
        request.square_mm,
        dictionary=request.dictionary if charuco else None,
        marker_mm=marker_mm,
    )
    write_board_pdf(request.output, board, cast(Paper, request.paper))
    typer.echo(f"{board.describe()}: {request.output}. Print it at 100 % and measure the bar.")
