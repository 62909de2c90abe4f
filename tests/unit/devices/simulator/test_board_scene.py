"""Boards: detected by OpenCV's own detectors where a pinhole with OpenCV's distortion sees their corners."""

import cv2
import numpy as np
import pytest

from twinline.arrays import ByteArray, FloatArray
from twinline.calibration.board import Board
from twinline.devices.simulator.board_print import board_thing, default_board, printed_face
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.renderer import Renderer, RoomLight
from twinline.devices.simulator.scenes import Scene, named_scene
from twinline.devices.simulator.world import Material, build_world
from twinline.errors import SettingsError

CHESSBOARD = Board("chessboard", 9, 6, 15.0, thickness_mm=2.0)
YAW_DEG = 7.0


def photograph(scene: Scene, cart_mm: float) -> ByteArray:
    world = build_world(scene.things, scene.bed, seed=1)
    return Renderer(world, SimulatedRig(), RoomLight((150.0, 150.0, 150.0)), seed=2).render(0, cart_mm, frozenset())


def expected_pixels(board: Board, centre_mm: tuple[float, float], cart_mm: float) -> FloatArray:
    """Inner corners row by row: rows run along +y of the bed, columns along +x, both turned by the yaw."""
    rig, yaw = SimulatedRig(), np.radians(YAW_DEG)
    across = board.square_mm * np.array([-np.sin(yaw), np.cos(yaw)])
    along = board.square_mm * np.array([np.cos(yaw), np.sin(yaw)])
    corners = [
        np.append(
            np.array(centre_mm) + (i - (board.columns - 1) / 2) * across + (j - (board.rows - 1) / 2) * along,
            board.thickness_mm,
        )
        for j in range(board.rows)
        for i in range(board.columns)
    ]
    travelled = (
        cart_mm
        * rig.travel_scale
        * np.array([np.cos(np.radians(rig.travel_yaw_deg)), np.sin(np.radians(rig.travel_yaw_deg)), 0.0])
    )
    in_camera = (np.array(corners) - travelled - (0.0, 0.0, rig.camera_height_mm)) @ rig.bed_from_camera
    lens = rig.lens
    matrix = np.array([[lens.focal_px[0], 0, lens.centre_px[0]], [0, lens.focal_px[1], lens.centre_px[1]], [0, 0, 1.0]])
    distortion = np.array([*lens.radial[:2], *lens.tangential, 0.0])
    seen, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, distortion)
    return np.asarray(seen, dtype=np.float64).reshape(-1, 2)


def test_chessboard_corners_are_seen_where_they_are() -> None:
    scene = Scene("board", (board_thing(CHESSBOARD, 3.0, -8.0, YAW_DEG),), Material((0.4, 0.4, 0.4), 0.05))
    grey = cv2.cvtColor(photograph(scene, 12.0), cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, (9, 6), flags=cv2.CALIB_CB_ACCURACY)
    assert found
    seen = corners.reshape(-1, 2)
    expected = expected_pixels(CHESSBOARD, (3.0, -8.0), 12.0)
    if np.linalg.norm(seen[0] - expected[0]) > 50:
        seen = seen[::-1]
    off = seen - expected
    assert np.abs(off.mean(axis=0)).max() < 0.03
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.08


def test_every_marker_of_the_built_in_board_is_read_and_its_corners_are_where_they_are() -> None:
    grey = cv2.cvtColor(photograph(named_scene("board"), -5.0), cv2.COLOR_BGR2GRAY)
    board = default_board()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    opencv_board = cv2.aruco.CharucoBoard((10, 7), 18.0, 13.5, dictionary)
    corners, numbers, _, markers = cv2.aruco.CharucoDetector(opencv_board).detectBoard(grey)
    assert sorted(markers.ravel()) == list(range(35))
    assert len(numbers) == 54
    off = corners.reshape(-1, 2) - expected_pixels(board, (0.0, 0.0), -5.0)[numbers.ravel()]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.12


@pytest.mark.parametrize("kind", ["circles", "asymmetric-circles"])
def test_circles_are_printed_about_their_points(kind: str) -> None:
    board = Board(kind, 5, 7, 12.0)  # type: ignore[arg-type]
    face, (x0, y0) = printed_face(board, 0.1)
    for x, y, _ in board.points_mm():
        column, row = round((x - x0) / 0.1), round((y - y0) / 0.1)
        assert face[row, column] < 0.1
        # 0.3 squares is the radius of a circle.
        assert face[row, column + 39] > 0.8
        assert face[row, column + 33] < 0.1


def test_a_printed_board_moves_with_its_print() -> None:
    here = named_scene("board")
    there = here.moved(30.0, 4.0)
    assert here.things[0].printed is not None
    assert there.things[0].printed is not None
    shift = np.subtract(there.things[0].printed.corner_mm, here.things[0].printed.corner_mm)
    np.testing.assert_allclose(shift, (30.0, 4.0))


def test_two_prints_in_one_scene_are_refused() -> None:
    board = board_thing(CHESSBOARD, 0.0, 0.0, 0.0)
    with pytest.raises(SettingsError, match="Only one object"):
        build_world((board, board.moved(200.0, 0.0)), Material(), seed=1)
