"""The page is read back by a parser of its own, which knows rectangles, curves and the one matrix that is used."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from twinline.calibration.board import Board
from twinline.calibration.views import inspect_view
from twinline.errors import CalibrationError, OutputError
from twinline.operations.exports.board_pdf import board_page_mm, board_size_mm, write_board_pdf

BOARDS = [
    Board("chessboard", 9, 6, 20.0),
    Board("charuco", 9, 6, 20.0, 0.0, "DICT_5X5_100", 15.0),
    Board("charuco", 7, 10, 15.0, 0.0, "DICT_6X6_250", 11.0),
    Board("circles", 9, 6, 20.0),
    Board("asymmetric-circles", 4, 11, 12.0),
]
PX_PER_MM = 6
NUMBER = r"(-?\d+(?:\.\d+)?)"


def content(path: Path) -> str:
    data = path.read_bytes()
    length = int(re.search(rb"/Length (\d+)", data).group(1))  # type: ignore[union-attr]
    start = data.index(b"stream\n") + 7
    assert data[start + length :].startswith(b"\nendstream")
    return data[start : start + length].decode("cp1252")


def page_mm(path: Path) -> tuple[float, float]:
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", path.read_bytes())
    assert box is not None
    return float(box.group(1)) / 72 * 25.4, float(box.group(2)) / 72 * 25.4


def rendered(path: Path) -> np.ndarray:
    """The page as a printer with 6 dots per millimetre shows it, text and lines left out."""
    text = content(path)
    scale = re.match(rf"{NUMBER} 0 0 {NUMBER} 0 0 cm\n", text)
    assert scale is not None
    mm = float(scale.group(1)) / 72 * 25.4
    assert abs(mm - 1.0) < 1e-9
    width, height = page_mm(path)
    finer = 4
    image = np.full((round(height * PX_PER_MM) * finer, round(width * PX_PER_MM) * finer), 255, np.uint8)

    def place(x: float, y: float) -> list[float]:
        return [x * PX_PER_MM * finer, (height - y) * PX_PER_MM * finer]

    for values in re.findall(rf"^{' '.join([NUMBER] * 4)} re$", text, re.MULTILINE):
        x, y, w, h = map(float, values)
        (left, bottom), (right, top) = place(x, y), place(x + w, y + h)
        image[round(top) : round(bottom), round(left) : round(right)] = 0
    for line in re.findall(r"^.* m .* c$", text, re.MULTILINE):
        points = [float(v) for v in re.findall(NUMBER, line)]
        now, outline = np.array(points[:2]), []
        for arc in np.array(points[2:]).reshape(-1, 3, 2):
            t = np.linspace(0, 1, 20)[:, None]
            outline.append(
                (1 - t) ** 3 * now + 3 * (1 - t) ** 2 * t * arc[0] + 3 * (1 - t) * t**2 * arc[1] + t**3 * arc[2]
            )
            now = arc[2]
        polygon = np.array([place(*p) for p in np.concatenate(outline)])
        cv2.fillPoly(image, [polygon.round().astype(np.int32)], 0)
    small = cv2.resize(image, None, fx=1 / finer, fy=1 / finer, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 0.8), dtype=np.uint8)


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: f"{board.kind} {board.columns} x {board.rows}")
def test_the_printed_board_is_found_in_its_exact_size(board: Board, tmp_path: Path) -> None:
    write_board_pdf(tmp_path / "board.pdf", board)
    view = inspect_view("page", rendered(tmp_path / "board.pdf"), board)
    assert (view.verdict, len(view.ids)) == ("found", board.points)
    plane = np.column_stack([view.board_mm[:, :2], np.ones(board.points)])
    fit, *_ = np.linalg.lstsq(plane, view.pixels, rcond=None)
    # Upright, not mirrored, 6 px to the millimetre: 0.1 % of 180 mm is what a ruler shows.
    np.testing.assert_allclose(fit[:2] / PX_PER_MM, np.eye(2), atol=1e-3)
    assert np.abs(plane @ fit - view.pixels).max() < 0.35


def test_the_bar_is_as_long_as_it_says(tmp_path: Path) -> None:
    write_board_pdf(tmp_path / "board.pdf", BOARDS[0])
    text = content(tmp_path / "board.pdf")
    assert "(this bar is 100.0 mm)" in text
    bar = re.search(rf"^{NUMBER} {NUMBER} m {NUMBER} {NUMBER} l S$", text, re.MULTILINE)
    assert bar is not None
    x1, y1, x2, y2 = map(float, bar.groups())
    np.testing.assert_allclose((x2 - x1, y2 - y1), (100.0, 0.0), atol=1e-9)


def test_the_page_says_what_the_board_is_and_how_to_print_it(tmp_path: Path) -> None:
    write_board_pdf(tmp_path / "board.pdf", BOARDS[1])
    text = content(tmp_path / "board.pdf")
    assert "ChArUco, 9 x 6 inner corners, squares 20 mm, markers 15 mm, DICT_5X5_100" in text
    assert "100 %" in text
    assert b"/PrintScaling /None" in (tmp_path / "board.pdf").read_bytes()


def test_every_object_stands_where_the_table_says(tmp_path: Path) -> None:
    write_board_pdf(tmp_path / "board.pdf", BOARDS[0])
    data = (tmp_path / "board.pdf").read_bytes()
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", data).group(1))  # type: ignore[union-attr]
    places = re.findall(rb"^(\d{10}) 00000 n $", data[start:], re.MULTILINE)
    assert len(places) == 6
    for number, place in enumerate(places, 1):
        assert data[int(place) :].startswith(b"%d 0 obj\n" % number)


def test_the_paper_is_turned_where_the_board_needs_it(tmp_path: Path) -> None:
    write_board_pdf(tmp_path / "wide.pdf", BOARDS[0], "A4")
    write_board_pdf(tmp_path / "tall.pdf", BOARDS[2], "A4")
    np.testing.assert_allclose(page_mm(tmp_path / "wide.pdf"), (297, 210), atol=0.01)
    np.testing.assert_allclose(page_mm(tmp_path / "tall.pdf"), (210, 297), atol=0.01)


def test_the_board_stays_clear_of_the_legend_and_the_border() -> None:
    for board in BOARDS:
        (width, height), page = board_size_mm(board), board_page_mm(board, "A4")
        assert width + 16 <= page[0]
        assert height + 38 <= page[1]


def test_a_board_that_does_not_fit_names_a_paper_that_does(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"300 x 210 mm.*A3") as caught:
        write_board_pdf(tmp_path / "board.pdf", Board("chessboard", 9, 6, 30.0))
    assert caught.value.code == "bad-board"
    assert not list(tmp_path.iterdir())
    with pytest.raises(CalibrationError, match="smaller squares"):
        board_page_mm(Board("chessboard", 9, 6, 300.0), "A1")


def test_an_unknown_paper_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="A4, A3"):
        write_board_pdf(tmp_path / "board.pdf", BOARDS[0], "A9")  # type: ignore[arg-type]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="make its folder first"):
        write_board_pdf(tmp_path / "absent" / "board.pdf", BOARDS[0])
