from typing import Any

import numpy as np
import pytest

from twinline.calibration.board import Board
from twinline.errors import CalibrationError


def test_the_points_of_a_chessboard_run_row_by_row_in_millimetres() -> None:
    points = Board("chessboard", 4, 3, 12.5).points_mm()
    assert points.shape == (12, 3)
    np.testing.assert_array_equal(points[[0, 1, 4, 11]], [[0, 0, 0], [12.5, 0, 0], [0, 12.5, 0], [37.5, 25.0, 0]])


def test_every_second_row_of_asymmetric_circles_is_shifted_by_half_a_distance() -> None:
    points = Board("asymmetric-circles", 4, 11, 10.0).points_mm()
    np.testing.assert_array_equal(points[[0, 1, 4, 8]], [[0, 0, 0], [20, 0, 0], [10, 10, 0], [0, 20, 0]])


def test_a_charuco_board_has_a_marker_in_every_bright_square() -> None:
    board = Board("charuco", 9, 6, 12.0, 0.0, "5x5_100", 9.0)
    markers = board.markers()
    assert len(markers) == 35
    assert all((column + row) % 2 == 1 for column, row, _ in markers)
    assert {bits.shape for _, _, bits in markers} == {(5, 5)}
    assert len({bits.tobytes() for _, _, bits in markers}) == 35
    assert Board("chessboard", 9, 6, 12.0).markers() == ()


def test_the_description_names_everything_needed_to_make_the_board_again() -> None:
    text = Board("charuco", 9, 6, 12.0, 0.0, "DICT_5X5_100", 9.0).describe()
    assert all(part in text for part in ("ChArUco", "9 x 6", "12 mm", "9 mm", "DICT_5X5_100"))


@pytest.mark.parametrize(
    ("board", "word"),
    [
        (("hexagons", 9, 6, 12.0), "kind"),
        (("chessboard", 1, 6, 12.0), "9 x 6"),
        (("chessboard", 2, 2, 12.0), "9 x 6"),
        (("chessboard", 200, 200, 12.0), "larger squares"),
        (("chessboard", 9, 6, 0.0), "square_mm"),
        (("chessboard", 9, 6, float("nan")), "square_mm"),
        (("chessboard", 9, 6, 12.0, -1.0), "thickness_mm"),
        (("chessboard", 9, 6, 12.0, 0.0, "DICT_5X5_100", 9.0), "charuco"),
        (("charuco", 9, 6, 12.0), "dictionary"),
        (("charuco", 9, 6, 12.0, 0.0, "DICT_5X5_100", 12.0), "marker_mm"),
        (("charuco", 9, 6, 12.0, 0.0, "DICT_9X9_100", 9.0), "DICT_4X4_50"),
        (("charuco", 12, 9, 12.0, 0.0, "DICT_5X5_50", 9.0), "65 markers"),
        (("asymmetric-circles", 4, 10, 12.0), "odd"),
    ],
)
def test_an_impossible_board_is_refused_with_the_reason(board: tuple[Any, ...], word: str) -> None:
    with pytest.raises(CalibrationError, match=word) as caught:
        Board(*board)
    assert caught.value.code == "bad-board"
