from typing import Any

import cv2
import numpy as np
import pytest

from tests.unit.calibration.board_pictures import Pose, picture, pose, project
from twinline.calibration.board import Board
from twinline.calibration.views import BoardView, compare_views, inspect_view, view_of_points
from twinline.errors import CalibrationError

CHESS = Board("chessboard", 9, 6, 12.0)
CHARUCO = Board("charuco", 9, 6, 12.0, 0.0, "DICT_5X5_100", 9.0)
CIRCLES = Board("circles", 9, 6, 12.0)
ASYMMETRIC = Board("asymmetric-circles", 4, 11, 9.0)
TILTED = ((25.0, -18.0, 8.0), (20.0, -10.0, 330.0))


def errors_px(view: BoardView, board: Board, where: Pose) -> np.ndarray:
    return np.asarray(np.linalg.norm(view.pixels - project(board.points_mm()[view.ids], where), axis=1))


class TestCorners:
    # Rendered with noise and blur of a real camera; circles' centres shift under perspective by what is allowed here.
    @pytest.mark.parametrize(
        ("board", "limit_px"), [(CHESS, 0.05), (CHARUCO, 0.12), (CIRCLES, 0.25), (ASYMMETRIC, 0.25)]
    )
    def test_every_point_is_found_where_it_is(self, board: Board, limit_px: float) -> None:
        where = pose(board, *TILTED)
        view = inspect_view("a.png", picture(board, where), board)
        assert (view.verdict, view.advice, len(view.ids)) == ("found", "", board.points)
        assert np.sqrt((errors_px(view, board, where) ** 2).mean()) < limit_px

    def test_far_and_near_boards_are_measured_equally_well(self) -> None:
        # A window of 5 px, right for the far board, leaves 0.09 px in the near one.
        rms = {}
        for z in (200.0, 600.0):
            where = pose(CHESS, (15.0, 10.0, 5.0), (0.0, 0.0, z))
            view = inspect_view("a.png", picture(CHESS, where), CHESS)
            rms[z] = np.sqrt((errors_px(view, CHESS, where) ** 2).mean())
        assert rms[200.0] < 0.06
        assert rms[600.0] < 0.08

    @pytest.mark.parametrize("board", [CHESS, CHARUCO, ASYMMETRIC])
    def test_a_board_turned_round_keeps_the_numbers_of_its_points(self, board: Board) -> None:
        assert board.turns_seen
        where = pose(board, (20.0, 5.0, 178.0), (10.0, 5.0, 330.0))
        view = inspect_view("a.png", picture(board, where), board)
        assert errors_px(view, board, where).max() < 0.5

    def test_a_chessboard_that_looks_the_same_turned_round_is_read_from_left_to_right(self) -> None:
        board = Board("chessboard", 8, 6, 12.0)
        assert not board.turns_seen
        upright, upside_down = (
            pose(board, (20.0, 5.0, 3.0), (0, 0, 330.0)),
            pose(board, (20, 5.0, 183.0), (0, 0, 330.0)),
        )
        for where in (upright, upside_down):
            view = inspect_view("a.png", picture(board, where), board)
            assert view.pixels[board.columns - 1, 0] > view.pixels[0, 0]

    def test_colour_pictures_are_measured_as_their_luminance(self) -> None:
        grey = picture(CHESS, pose(CHESS, *TILTED))
        view = inspect_view("a.png", np.stack([grey] * 3, axis=-1), CHESS)
        np.testing.assert_allclose(view.pixels, inspect_view("a.png", grey, CHESS).pixels, atol=1e-6)

    def test_the_tilt_is_seen_without_knowing_the_focal_length(self) -> None:
        for tilt in (30.0, 55.0):
            view = inspect_view("a.png", picture(CHESS, pose(CHESS, (tilt, 0.0, 20.0), (0.0, 0.0, 330.0))), CHESS)
            assert view.tilt_deg == pytest.approx(tilt, abs=2.0)


class TestVerdicts:
    @pytest.mark.parametrize(
        ("change", "verdict", "words"),
        [
            ({"blur_px": 4.0}, "blurred", "focus"),
            ({"dark": 5.0, "bright": 20.0, "noise": 0.5}, "under-exposed", "grey levels"),
            ({"dark": 90.0, "bright": 900.0, "blur_px": 1.2}, "over-exposed", "shorten the exposure"),
        ],
    )
    def test_a_bad_picture_of_a_board_is_named(self, change: dict[str, Any], verdict: str, words: str) -> None:
        view = inspect_view("a.png", picture(CHESS, pose(CHESS, *TILTED), **change), CHESS)
        assert view.verdict == verdict
        assert words in view.advice
        assert not view.usable

    @pytest.mark.parametrize("window", [(17, 1), (1, 17)])
    def test_motion_in_one_direction_is_blur_too(self, window: tuple[int, int]) -> None:
        sharp = picture(CHESS, pose(CHESS, (20.0, 10.0, 0.0), (0.0, 0.0, 330.0)))
        moved = np.asarray(cv2.blur(sharp, window), np.uint8)
        assert inspect_view("a.png", moved, CHESS).verdict == "blurred"

    def test_white_at_the_end_of_the_scale_does_no_harm_while_edges_stay_in_place(self) -> None:
        where = pose(CHESS, *TILTED)
        view = inspect_view("a.png", picture(CHESS, where, dark=0.0, bright=255.0), CHESS)
        assert view.verdict == "found"
        assert view.appearance is not None
        assert view.appearance.saturated > 0.3

    def test_a_board_seen_almost_from_the_side_is_too_oblique(self) -> None:
        view = inspect_view("a.png", picture(CHESS, pose(CHESS, (68.0, 0.0, 0.0), (0.0, 0.0, 250.0))), CHESS)
        assert (view.verdict, view.usable) == ("too-oblique", False)
        assert "65°" in view.advice

    def test_a_part_of_a_charuco_board_is_used(self) -> None:
        where = pose(CHARUCO, (15.0, 10.0, 5.0), (170.0, 0.0, 330.0))
        view = inspect_view("a.png", picture(CHARUCO, where), CHARUCO)
        assert view.verdict == "partial"
        assert view.usable
        assert 10 < len(view.ids) < CHARUCO.points
        assert f"{CHARUCO.points - len(view.ids)} of 54" in view.advice
        assert errors_px(view, CHARUCO, where).max() < 0.5

    def test_a_part_of_a_chessboard_is_named_and_not_used(self) -> None:
        view = inspect_view("a.png", picture(CHESS, pose(CHESS, (15.0, 10, 5), (180.0, 0.0, 330.0))), CHESS)
        assert (view.verdict, view.usable) == ("partial", False)
        assert "of the 9 x 6 corners" in view.advice

    def test_a_mirrored_picture_is_recognised_by_the_markers(self) -> None:
        image = picture(CHARUCO, pose(CHARUCO, *TILTED))
        view = inspect_view("a.png", np.ascontiguousarray(image[:, ::-1]), CHARUCO)
        assert view.verdict == "mirrored"
        assert "flip" in view.advice
        assert CHARUCO.mirroring_seen
        assert not CHESS.mirroring_seen

    @pytest.mark.parametrize("level", [0, 128, 255])
    def test_an_empty_picture_has_no_board(self, level: int) -> None:
        view = inspect_view("a.png", np.full((480, 640), level, np.uint8), CHESS)
        assert view.verdict in ("not-found", "under-exposed", "over-exposed")
        assert view.advice
        assert not view.usable

    def test_a_larger_board_than_stated_is_a_wrong_size(self) -> None:
        view = inspect_view("a.png", picture(CHESS, pose(CHESS, *TILTED)), Board("chessboard", 8, 5, 12.0))
        assert view.grid_seen == (9, 6)


class TestComparison:
    def test_the_size_that_the_pictures_show_is_named_where_another_was_stated(self) -> None:
        stated = Board("chessboard", 8, 6, 12.0)
        views = [
            inspect_view(f"{z}.png", picture(CHESS, pose(CHESS, (15.0, 10.0, 5.0), (0.0, 0.0, z))), stated)
            for z in (250.0, 330.0, 400.0)
        ]
        judged = compare_views(views, stated)
        assert [view.verdict for view in judged] == ["wrong-size"] * 3
        assert "9 x 6 inner corners are seen, not 8 x 6" in judged[0].advice

    def test_the_same_pose_twice_is_a_duplicate_of_the_first(self) -> None:
        here = project(CHESS.points_mm(), pose(CHESS, *TILTED))
        there = project(CHESS.points_mm(), pose(CHESS, (25.0, -18.0, 8.0), (40.0, -10.0, 330.0)))
        views = [view_of_points(n, (1280, 720), CHESS, p) for n, p in (("a", here), ("b", there), ("c", here + 0.8))]
        judged = compare_views(views, CHESS)
        assert [view.verdict for view in judged] == ["found", "found", "duplicate"]
        assert "as in a" in judged[2].advice

    def test_points_that_are_not_the_boards_are_refused(self) -> None:
        with pytest.raises(CalibrationError, match="53 points where the board"):
            view_of_points("a", (1280, 720), CHESS, np.zeros((53, 2)))
