"""``twinline reconstruct`` as a process: what it writes, what it says, and that its options do what they say."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.integration.command_line import files_below, twinline
from tests.integration.ply_points import read_points
from tests.unit.reconstruction.small_pass import Pass, write_pass, write_video_pass
from twinline.recording.images import read_image
from twinline.recording.video import index_video, read_video

GIVEN = Pass().with_frames(24, 4.0)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pass(tmp_path_factory.mktemp("pass") / "capture", GIVEN)


def header(path: Path) -> list[str]:
    return path.read_bytes().split(b"end_header\n")[0].decode().splitlines()


def test_the_ply_holds_as_many_points_as_were_reported(capture: Path, tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.ply"
    done = twinline("reconstruct", capture, "-o", cloud, "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    lines = header(cloud)
    assert f"element vertex {summary['points']}" in lines
    assert "format binary_little_endian 1.0" in lines
    assert f"comment rig_id {summary['rig_id']}" in lines
    assert "comment recording_id small pass" in lines
    # x y z, colour, source, sigma, intensity.
    body = cloud.read_bytes().split(b"end_header\n", 1)[1]
    assert len(body) == summary["points"] * (3 * 4 + 3 + 1 + 2 * 4)
    sources = ("laser1", "laser2", "both lasers", "tof", "filled")
    assert summary["points"] == sum(summary["counts"].get(name, 0) for name in sources)
    assert len(read_points(cloud)) == summary["points"]
    assert files_below(tmp_path) == {"cloud.ply"}


def test_the_summary_s_box_and_the_cloud_agree(capture: Path, tmp_path: Path) -> None:
    summary = json.loads(twinline("reconstruct", capture, "-o", tmp_path / "cloud.ply", "--json").stdout)
    points = read_points(tmp_path / "cloud.ply")
    np.testing.assert_allclose(points.min(axis=0), summary["low_mm"], atol=1e-4)
    np.testing.assert_allclose(points.max(axis=0), summary["high_mm"], atol=1e-4)
    assert summary["frames"] == summary["frames_used"] == 24
    assert summary["problems"] == []
    assert 0.0 < summary["median_sigma_mm"] < 0.2
    assert summary["output"] == str(tmp_path / "cloud.ply")


def test_without_json_one_line_says_it_all(capture: Path, tmp_path: Path) -> None:
    done = twinline("reconstruct", capture, "-o", tmp_path / "cloud.ply", "--ascii", "--every", 2)
    assert done.returncode == 0
    assert done.stdout.count("\n") == 1
    assert "from 12 of 12 frames" in done.stdout
    assert "nominal" in done.stderr
    assert header(tmp_path / "cloud.ply")[1] == "format ascii 1.0"


def test_the_same_input_gives_the_same_file_whatever_the_number_of_workers(capture: Path, tmp_path: Path) -> None:
    for name, workers in (("one.ply", ["--workers", 1]), ("three.ply", ["--workers", 3]), ("all.ply", [])):
        assert twinline("reconstruct", capture, "-o", tmp_path / name, *workers).returncode == 0
    assert (tmp_path / "one.ply").read_bytes() == (tmp_path / "three.ply").read_bytes()
    assert (tmp_path / "one.ply").read_bytes() == (tmp_path / "all.ply").read_bytes()


def test_one_source_leaves_the_other_out(capture: Path, tmp_path: Path) -> None:
    done = twinline("reconstruct", capture, "-o", tmp_path / "cloud.ply", "--sources", "laser2", "--json")
    counts = json.loads(done.stdout)["counts"]
    assert counts["laser2"] > 3000
    assert "laser1" not in counts


def test_a_glb_is_written_in_metres(capture: Path, tmp_path: Path) -> None:
    assert twinline("reconstruct", capture, "-o", tmp_path / "cloud.glb").returncode == 0
    data = (tmp_path / "cloud.glb").read_bytes()
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, _ = struct.unpack("<I4s", data[12:20])
    accessor = json.loads(data[20 : 20 + size])["accessors"][0]
    assert accessor["max"][2] == pytest.approx(0.015, abs=0.001)


def test_a_rig_of_one_s_own_is_used(capture: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.json"
    assert twinline("rig", capture, "-o", rig).returncode == 0
    higher = json.loads(rig.read_text())
    higher["bed_from_camera"]["translation_mm"][2] += 5.0
    rig.write_text(json.dumps(higher))
    for name, options in (("plain.ply", []), ("higher.ply", ["--rig", rig])):
        assert twinline("reconstruct", capture, "-o", tmp_path / name, *options).returncode == 0
    plain, raised = (read_points(tmp_path / n)[:, 2] for n in ("plain.ply", "higher.ply"))
    assert float(np.median(raised) - np.median(plain)) == pytest.approx(5.0, abs=0.05)


def test_a_video_gives_what_its_frames_as_pictures_give(tmp_path: Path) -> None:
    import cv2

    video = write_video_pass(tmp_path / "video", GIVEN)
    pictures = write_pass(tmp_path / "pictures", GIVEN)
    path = video / "laser" / "video.avi"
    for number, image in read_video(path, index_video(path), range(24)):
        assert image is not None
        assert cv2.imwrite(str(pictures / "laser" / f"{number:04d}.png"), image)
    assert read_image(pictures / "laser" / "0000.png").shape == (120, 160, 3)
    for folder in (video, pictures):
        assert twinline("reconstruct", folder, "-o", folder / "cloud.ply").returncode == 0
    one, other = (read_points(folder / "cloud.ply") for folder in (video, pictures))
    assert len(one) > 5000
    np.testing.assert_array_equal(one, other)
