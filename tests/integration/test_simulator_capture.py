"""A rendered capture folder: complete, honest to its owner, and true to its truth."""

import csv
import json
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from twinline.arrays import ByteArray
from twinline.devices.simulator.capture import render_capture
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.scenes import named_scene
from twinline.devices.simulator.workspace import swept_travel_mm
from twinline.errors import CancelledError, NotFoundError, OutputError, SettingsError
from twinline.geometry.rig_json import rig_from_json
from twinline.recording.capture import open_capture

SMALL = (200, 420)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rendered") / "capture"
    render_capture(path, "sphere", image_size=SMALL, pitch_mm=4.0, seed=11)
    return path


def picture(path: str) -> ByteArray:
    image = cv2.imread(path)
    assert image is not None, path
    return np.asarray(image, dtype=np.uint8)


def frame_rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "laser" / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_listed_frame_is_there_at_the_stated_size_and_time(folder: Path) -> None:
    rows = frame_rows(folder)
    assert len(rows) > 25
    assert sorted(row["frame"] for row in rows) == sorted(
        p.name for p in (folder / "laser").glob("*.jpg") if p.name != "off.jpg"
    )
    np.testing.assert_allclose([float(row["cart_mm"]) for row in rows], 4.0 * np.arange(len(rows)))
    np.testing.assert_allclose(np.diff([float(row["time_s"]) for row in rows]), 0.04)
    for name in (rows[0]["frame"], rows[-1]["frame"], "off.jpg"):
        assert picture(str(folder / "laser" / name)).shape == (SMALL[1], SMALL[0], 3)


def test_the_owner_learns_nothing_of_the_machine_s_errors(folder: Path) -> None:
    known = json.loads((folder / "capture.json").read_text())
    assert known == {
        "name": "sphere",
        "image_size": [200, 420],
        "stripe_runs": "along-u",
        "camera_matrix_guess": [[1030.0, 0.0, 100.0], [0.0, 1030.0, 210.0], [0.0, 0.0, 1.0]],
        "camera_height_mm": 430.0,
        "lasers": [
            {"baseline_mm": 251.5, "angle_deg": 65.5, "side": "+v"},
            {"baseline_mm": 251.5, "angle_deg": 62.5, "side": "-v"},
        ],
    }


def test_the_nominal_stripes_cross_well_below_the_bed() -> None:
    for laser in SimulatedRig().lasers:
        assert laser.known_baseline_mm * np.tan(np.radians(laser.known_angle_deg)) > 430.0 + 40.0


def test_the_laser_off_frame_shows_no_laser(folder: Path) -> None:
    rows = frame_rows(folder)
    off = picture(str(folder / "laser" / "off.jpg"))
    on = picture(str(folder / "laser" / rows[0]["frame"]))
    assert on[..., 2].max() > 120
    assert off[..., 2].max() < 60


def test_bright_pixels_and_the_true_rig_give_points_on_the_true_sphere(folder: Path) -> None:
    """Rays and planes are intersected here in the open, with OpenCV undoing the lens."""
    rig = rig_from_json((folder / "rig.json").read_text())
    truth = json.loads((folder / "truth.json").read_text())
    sphere = truth["scene"]["things"][0]["dimensions_mm"]
    centre = np.array([sphere["x"], sphere["y"], sphere["z"]])
    distances: dict[int, list[float]] = {1: [], 2: []}
    for row in frame_rows(folder):
        red = picture(str(folder / "laser" / row["frame"]))[..., 2].astype(float)
        for number, sheet in enumerate(rig.sheets, 1):
            half = red.copy()
            rows = np.arange(SMALL[1])
            # The lasers' halves of the picture meet at the principal point.
            half[rows < rig.camera.cy if number == 1 else rows > rig.camera.cy] = 0.0
            peak = half.argmax(axis=0)
            for column in np.flatnonzero(half.max(axis=0) > 90):
                near = np.arange(max(peak[column] - 5, 0), min(peak[column] + 6, SMALL[1]))
                light = np.clip(half[near, column] - 45, 0, None)
                v = (near * light).sum() / light.sum()
                ray = np.append(
                    cv2.undistortPoints(np.array([[[float(column), v]]]), rig.camera.matrix, rig.camera.distortion), 1.0
                )
                point = ray * sheet.offset_mm / (sheet.normal @ ray)
                in_bed = rig.bed_from_camera.rotation @ point + rig.bed_from_camera.translation_mm
                in_bed = in_bed + rig.travel * float(row["cart_mm"])
                if in_bed[2] > 15.0:
                    distances[number].append(float(np.linalg.norm(in_bed - centre) - sphere["radius"]))
    for number, values in distances.items():
        assert len(values) > 300, number
        assert abs(np.median(values)) < 0.05
        assert np.percentile(np.abs(values), 90) < 0.4


def test_the_true_mesh_lies_where_the_dimensions_say(folder: Path) -> None:
    dimensions = json.loads((folder / "truth.json").read_text())["scene"]["things"][0]["dimensions_mm"]
    mesh = trimesh.load_mesh(folder / "truth.ply")
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), [dimensions["x"], dimensions["y"], dimensions["z"]], atol=1e-4)
    np.testing.assert_allclose(mesh.extents / 2, dimensions["radius"], atol=1e-4)


def test_both_lasers_sweep_the_whole_scene() -> None:
    rig, scene = SimulatedRig(), named_scene("three-objects")
    first, last = swept_travel_mm(rig, scene)
    top = max(thing.mesh.bounds[1][2] for thing in scene.things)
    for laser in rig.lasers:
        for height in (0.0, top):
            reach = laser.ahead * (
                laser.known_baseline_mm - (430.0 - height) / np.tan(np.radians(laser.known_angle_deg))
            )
            assert first + reach <= scene.span_mm[0] + 1e-9
            assert last + reach >= scene.span_mm[1] - 1e-9


def test_threads_and_processes_write_the_same_frames(tmp_path: Path) -> None:
    options = {"image_size": (160, 400), "travel_mm": (0.0, 80.0), "pitch_mm": 4.0, "seed": 5}
    with ThreadPoolExecutor(1) as one:
        render_capture(tmp_path / "threads", "three-objects", executor=one, **options)  # type: ignore[arg-type]
    with ProcessPoolExecutor(2, mp_context=get_context("forkserver")) as two:
        render_capture(tmp_path / "processes", "three-objects", executor=two, **options)  # type: ignore[arg-type]
    names = sorted(path.name for path in (tmp_path / "threads" / "laser").iterdir())
    assert len(names) == 21 + 2
    for name in names:
        ours, theirs = ((tmp_path / kind / "laser" / name).read_bytes() for kind in ("threads", "processes"))
        assert ours == theirs, name


def test_alternating_lasers_are_named_in_the_frame_list_and_seen_one_at_a_time(tmp_path: Path) -> None:
    render_capture(tmp_path / "c", "bed", image_size=SMALL, travel_mm=(0.0, 6.0), pitch_mm=2.0, alternating=True)
    rows = frame_rows(tmp_path / "c")
    assert [row["lasers"] for row in rows] == ["1", "2", "1", "2"]
    for row in rows:
        red = picture(str(tmp_path / "c" / "laser" / row["frame"]))[..., 2]
        upper, lower = red[:200].max(), red[220:].max()
        assert (lower > 100, upper > 100) == (row["lasers"] == "1", row["lasers"] == "2")


def test_progress_ends_at_the_total_and_comes_from_the_calling_thread(tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    render_capture(
        tmp_path / "c", "bed", image_size=(64, 360), travel_mm=(0.0, 40.0), pitch_mm=1.0,
        report=lambda done, total: calls.append((done, total)),
    )  # fmt: skip
    assert calls[0] == (0, 41)
    assert calls[-1] == (41, 41)
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


def test_a_cancelled_rendering_leaves_no_folder_that_looks_like_a_capture(tmp_path: Path) -> None:
    def stop() -> None:
        raise CancelledError("Stopped.")

    with pytest.raises(CancelledError):
        render_capture(tmp_path / "c", "bed", image_size=(64, 360), travel_mm=(0.0, 40.0), checkpoint=stop)
    assert not (tmp_path / "c" / "capture.json").exists()


def test_a_folder_with_a_capture_is_not_overwritten(folder: Path) -> None:
    with pytest.raises(OutputError, match="already holds a capture"):
        render_capture(folder, "bed", image_size=SMALL)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="file"):
        render_capture(tmp_path / "file" / "c", "bed", image_size=(64, 360), travel_mm=(0.0, 1.0))


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"scene": "moon"}, NotFoundError, "three-objects"),
        ({"pitch_mm": 0.0}, SettingsError, "pitch above 0 mm"),
        ({"travel_mm": (5.0, 1.0)}, SettingsError, "5.0 to 1.0"),
        ({"pitch_mm": 1e-6}, SettingsError, "larger pitch"),
        ({"image_size": (8, 8)}, SettingsError, "8 x 8"),
    ],
)
def test_impossible_wishes_are_refused_before_anything_is_written(
    tmp_path: Path, options: dict[str, object], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        render_capture(tmp_path / "c", **{"image_size": (64, 360), **options})  # type: ignore[arg-type]
    assert not (tmp_path / "c").exists()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "capture"
    render_capture(path, "sphere", travel_mm=(0.0, 4.0), pitch_mm=2.0, parts={"camera", "motion", "tof"}, seed=2)
    return path


def test_the_parts_for_calibration_open_as_a_capture(whole: Path) -> None:
    capture = open_capture(whole)
    assert len(capture.views()) == 16
    motion = capture.motion()
    assert motion is not None
    np.testing.assert_allclose(np.diff([entry.cart_mm for entry in motion.frames]), 22.0)
    tof = capture.tof()
    assert tof is not None
    assert np.isfinite(tof.distance_mm).mean() > 0.99
    assert set(np.round(np.diff(np.unique(tof.cart_mm)), 6)) == {1.5}
    assert capture.info.board is not None
    assert capture.info.board.kind == "charuco"


def test_the_board_under_way_moves_by_the_true_travel(whole: Path) -> None:
    """OpenCV's own detector and pose, with the true intrinsics, see the board move against the camera."""
    rig = rig_from_json((whole / "rig.json").read_text())
    board = cv2.aruco.CharucoBoard((10, 7), 18.0, 13.5, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    places = []
    for name in ("00.png", "05.png"):
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(picture(str(whole / "motion" / name)))
        assert len(numbers) > 45
        points = np.asarray(board.getChessboardCorners())[numbers.ravel()]
        _, turn, shift = cv2.solvePnP(points, corners, rig.camera.matrix, rig.camera.distortion)
        in_camera = cv2.Rodrigues(turn)[0] @ np.array([90.0, 63.0, 0.0]) + shift.ravel()
        places.append(rig.bed_from_camera.apply(in_camera[np.newaxis])[0])
    np.testing.assert_allclose(places[0] - places[1], rig.travel * 5 * 22.0, atol=0.08)
    # The printed face lies as high as the board is thick.
    assert places[0][2] == pytest.approx(3.0, abs=0.5)


def test_tof_readings_off_the_slopes_lie_on_the_true_surface(whole: Path) -> None:
    rig = rig_from_json((whole / "rig.json").read_text())
    ball = json.loads((whole / "truth.json").read_text())["scene"]["things"][0]["dimensions_mm"]
    with (whole / "tof" / "samples.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["adc"]]
    assert rig.tof is not None
    cart, slide, adc = (np.array([float(row[name]) for row in rows]) for name in ("cart_mm", "slide_mm", "adc"))
    start = rig.tof.position_mm + np.outer(cart, rig.travel) + np.outer(slide, rig.tof.slide)
    points = start + np.outer(rig.tof.offset_mm + rig.tof.gain_mm_per_unit * adc, rig.tof.beam)
    aside = np.hypot(points[:, 0] - ball["x"], points[:, 1] - ball["y"])
    top = aside < 3.0
    high = ball["z"] + np.sqrt(ball["radius"] ** 2 - aside[top] ** 2)
    assert top.sum() > 20
    # On the way up and down the lag of 0.36 mm along the sweep leaves 0.06 mm at 3 mm from the top.
    assert np.abs(points[top, 2] - high).max() < 0.12
    assert np.abs(points[aside > 30.0, 2]).max() < 0.06


@pytest.mark.parametrize("part", ["sheets", "Camera"])
def test_parts_that_cannot_be_made_are_refused_before_anything_is_written(tmp_path: Path, part: str) -> None:
    with pytest.raises(SettingsError, match="camera, motion, tof"):
        render_capture(tmp_path / "c", "bed", image_size=(64, 360), parts={part})
    assert not (tmp_path / "c").exists()
