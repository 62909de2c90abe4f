"""What ``twinline reconstruct`` says to input it cannot use: one sentence that names cause and file, and nothing left.

Everything goes through the real process. Captures are small renderings, damaged on purpose.
"""

import errno
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.integration.command_line import files_below, require_refusal, twinline
from tests.unit.reconstruction.small_pass import (
    NO_BLOCK,
    Pass,
    description,
    frame_names,
    write_list,
    write_pass,
    write_video_pass,
)

FEW = Pass().with_frames(6, 12.0)
NAMES = frame_names(6)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pass(tmp_path_factory.mktemp("sound") / "capture", FEW)


@pytest.fixture
def capture(sound: Path, tmp_path: Path) -> Path:
    """A sound capture to damage."""
    shutil.copytree(sound, tmp_path / "capture")
    return tmp_path / "capture"


@pytest.fixture
def results(tmp_path: Path) -> Iterator[Path]:
    """A folder for results; it must be as empty after the command as it was before."""
    folder = tmp_path / "results"
    folder.mkdir()
    yield folder
    assert files_below(folder) == set()


def refused(capture: Path, results: Path, *words: str, options: tuple[object, ...] = ()) -> str:
    return require_refusal(twinline("reconstruct", capture, "-o", results / "cloud.ply", *options), *words)


def rewrite(capture: Path, **changes: object) -> None:
    """Change fields of capture.json; None takes one away."""
    fields = {**json.loads((capture / "capture.json").read_text()), **changes}
    (capture / "capture.json").write_text(json.dumps({k: v for k, v in fields.items() if v is not None}))


def test_an_empty_folder(tmp_path: Path, results: Path) -> None:
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", results, str(tmp_path / "empty"), "empty", "capture.json")


def test_a_folder_that_is_not_there(tmp_path: Path, results: Path) -> None:
    refused(tmp_path / "nowhere", results, str(tmp_path / "nowhere"), "does not exist")


def test_a_folder_without_capture_json(capture: Path, results: Path) -> None:
    (capture / "capture.json").unlink()
    refused(capture, results, str(capture / "capture.json"))


def test_a_capture_json_that_is_no_json(capture: Path, results: Path) -> None:
    (capture / "capture.json").write_text('{"name": "half a')
    refused(capture, results, str(capture / "capture.json"), "line 1")


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"camera_height_mm": None}, "camera_height_mm"),
        ({"camera_height_mm": -3}, "camera_height_mm"),
        ({"image_size": [160]}, "image_size"),
        ({"stripe_runs": "across"}, "stripe_runs"),
        ({"lasers": [{"baseline_mm": 150.0, "angle_deg": "sixty", "side": "+v"}]}, "angle_deg"),
        ({"exposure_ms": 5}, "exposure_ms"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_wrong_field_of_capture_json_is_named(
    changes: dict[str, Any], field: str, capture: Path, results: Path
) -> None:
    rewrite(capture, **changes)
    refused(capture, results, str(capture / "capture.json"), field)


def test_a_capture_without_a_laser_pass(capture: Path, results: Path) -> None:
    shutil.rmtree(capture / "laser")
    refused(capture, results, str(capture), "laser/")


def test_frames_of_mixed_size(capture: Path, results: Path) -> None:
    cv2.imwrite(str(capture / "laser" / NAMES[4]), np.zeros((60, 80, 3), np.uint8))
    refused(capture, results, str(capture / "laser" / NAMES[4]), "80 x 60", "160 x 120")


def test_frames_of_another_size_than_capture_json_says(capture: Path, results: Path) -> None:
    rewrite(capture, image_size=[640, 480])
    refused(capture, results, str(capture / "laser" / NAMES[0]), "image_size", "640 x 480", "160 x 120")


def truncate(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def test_a_truncated_jpeg_that_is_the_only_frame(tmp_path: Path, results: Path) -> None:
    folder = write_pass(tmp_path / "capture", Pass().with_frames(1), suffix=".jpg")
    truncate(folder / "laser" / "0000.jpg")
    refused(folder, results, "0000.jpg", "truncated")


def test_one_truncated_jpeg_among_many_is_counted_and_the_rest_is_kept(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "capture", FEW, suffix=".jpg")
    whole = twinline("reconstruct", folder, "-o", tmp_path / "whole.ply", "--json")
    truncate(folder / "laser" / "0002.jpg")
    done = twinline("reconstruct", folder, "-o", tmp_path / "rest.ply", "--json")
    assert whole.returncode == done.returncode == 0
    all_frames, rest = json.loads(whole.stdout), json.loads(done.stdout)
    assert (all_frames["problem_count"], rest["problem_count"]) == (0, 1)
    assert (all_frames["frames_used"], rest["frames_used"], rest["frames"]) == (6, 5, 6)
    assert [problem["frame"] for problem in rest["problems"]] == ["0002.jpg"]
    assert "truncated" in rest["problems"][0]["reason"]
    assert 0.75 * all_frames["points"] < rest["points"] < 0.9 * all_frames["points"]
    assert "1 of 6 frames" in done.stderr
    assert str(folder / "laser" / "0002.jpg") in done.stderr


def test_all_frames_broken(capture: Path, results: Path) -> None:
    for name in NAMES:
        truncate(capture / "laser" / name)
    refused(capture, results, str(capture / "laser"), NAMES[0], "truncated")


def use_video(capture: Path, content: bytes) -> Path:
    shutil.rmtree(capture / "laser")
    (capture / "laser").mkdir()
    (capture / "laser" / "video.mp4").write_bytes(content)
    write_list(capture / "laser", ["0", "1", "2"], FEW)
    return capture / "laser" / "video.mp4"


@pytest.mark.parametrize(
    "content", [b"", b"no video at all", b"\0\0\0\x18ftypmp42" + bytes(4000)], ids=["empty", "text", "damaged"]
)
def test_a_video_that_cannot_be_read(content: bytes, capture: Path, results: Path) -> None:
    refused(capture, results, str(use_video(capture, content)), "video")


def test_a_frame_number_past_the_end_of_the_video(tmp_path: Path, results: Path) -> None:
    folder = write_video_pass(tmp_path / "capture", FEW)
    write_list(folder / "laser", ["0", "1", "7"], FEW)
    refused(folder, results, str(folder / "laser" / "frames.csv"), "7", "video.avi", "6 frames")


def test_frame_numbers_that_run_backwards(tmp_path: Path, results: Path) -> None:
    folder = write_video_pass(tmp_path / "capture", FEW)
    write_list(folder / "laser", ["0", "2", "1"], FEW)
    refused(folder, results, str(folder / "laser" / "frames.csv"), "backwards", "from 2 to 1")


def test_a_list_that_names_missing_frames(capture: Path, results: Path) -> None:
    (capture / "laser" / NAMES[3]).unlink()
    refused(capture, results, str(capture / "laser" / "frames.csv"), NAMES[3])


def test_a_list_whose_time_runs_backwards(capture: Path, results: Path) -> None:
    table = capture / "laser" / "frames.csv"
    lines = table.read_text().splitlines()
    lines[3], lines[4] = lines[4], lines[3]
    table.write_text("\n".join(lines) + "\n")
    refused(capture, results, str(table), "line 5", "backwards")


def test_a_missing_list(capture: Path, results: Path) -> None:
    (capture / "laser" / "frames.csv").unlink()
    refused(capture, results, str(capture / "laser" / "frames.csv"), "missing")


def test_no_stripe_in_any_frame(tmp_path: Path, results: Path) -> None:
    dark = replace(FEW, laser_dn=0.0, block=NO_BLOCK)
    folder = write_pass(tmp_path / "capture", dark)
    refused(folder, results, "None of the 6 frames", str(folder / "laser"), "stripe")


def test_a_rig_for_another_image_size(capture: Path, results: Path, tmp_path: Path) -> None:
    other = write_pass(tmp_path / "other", Pass(size=(200, 120)).with_frames(1))
    rig = tmp_path / "rig.json"
    assert twinline("rig", other, "-o", rig).returncode == 0
    refused(capture, results, "200 x 120", "160 x 120", str(capture), options=("--rig", rig))


def test_a_rig_whose_stripes_run_the_other_way(capture: Path, results: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.json"
    rewrite(capture, stripe_runs="along-v", lasers=[{"baseline_mm": 150.0, "angle_deg": 60.0, "side": "+u"}])
    assert twinline("rig", capture, "-o", rig).returncode == 0
    (capture / "capture.json").write_text(json.dumps(description(FEW)))
    refused(capture, results, "along-v", "along-u", str(capture / "capture.json"), options=("--rig", rig))


def test_a_rig_file_that_is_missing_or_no_rig(capture: Path, results: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.json"
    refused(capture, results, str(rig), options=("--rig", rig))
    rig.write_text("[]")
    refused(capture, results, str(rig), options=("--rig", rig))


def test_stripes_that_cross_within_the_depth_range(capture: Path, results: Path) -> None:
    laser = {"baseline_mm": 105.0, "angle_deg": 60.0}
    rewrite(capture, lasers=[{**laser, "side": "+v"}, {**laser, "side": "-v"}])
    refused(capture, results, "cross", "182 mm", "alternate")


def test_a_laser_that_the_rig_has_not_got(capture: Path, results: Path) -> None:
    rewrite(capture, lasers=[{"baseline_mm": 150.0, "angle_deg": 60.0, "side": "+v"}])
    refused(capture, results, "laser2", options=("--sources", "laser2"))


@pytest.mark.parametrize(
    ("option", "value", "known"),
    [
        ("--method", "best", "maximum-likelihood"),
        ("--channel", "ultraviolet", "red-blue"),
        ("--sources", "laser3", "laser1"),
        ("--sources", ",", "laser1"),
    ],
)
def test_an_unknown_choice_is_answered_with_the_known_ones(
    option: str, value: str, known: str, capture: Path, results: Path
) -> None:
    refused(capture, results, value.strip(","), known, options=(option, value))


def test_a_reference_of_another_length(capture: Path, results: Path) -> None:
    write_pass(capture.parent / "other", FEW.with_frames(4, 12.0))
    shutil.move(capture.parent / "other" / "laser", capture / "reference")
    refused(capture, results, "reference/", "4 frames", "laser/ has 6")


def test_a_damaged_laser_off_picture(capture: Path, results: Path) -> None:
    (capture / "laser" / "off.png").write_bytes(b"nothing")
    refused(capture, results, str(capture / "laser" / "off.png"))


def test_a_laser_off_picture_of_another_size(capture: Path, results: Path) -> None:
    cv2.imwrite(str(capture / "laser" / "off.png"), np.zeros((60, 80, 3), np.uint8))
    refused(capture, results, str(capture / "laser" / "off.png"), "80 x 60", "160 x 120")


def test_a_file_instead_of_a_folder(capture: Path, results: Path) -> None:
    refused(
        capture / "laser" / NAMES[0], results, str(capture / "laser" / NAMES[0]), "neither a recording nor a folder"
    )


class TestOutput:
    def test_a_folder_that_does_not_exist(self, capture: Path, tmp_path: Path) -> None:
        before = files_below(tmp_path)
        target = tmp_path / "no" / "such" / "cloud.ply"
        require_refusal(twinline("reconstruct", capture, "-o", target), str(target), "no such file or directory")
        assert files_below(tmp_path) == before

    def test_a_folder_in_place_of_the_file(self, capture: Path, results: Path) -> None:
        (results / "cloud.ply").mkdir()
        refused(capture, results, str(results / "cloud.ply"), "it is a folder")
        (results / "cloud.ply").rmdir()

    def test_an_unknown_kind_of_file(self, capture: Path, results: Path) -> None:
        target = results / "cloud.xlsx"
        require_refusal(twinline("reconstruct", capture, "-o", target), str(target), ".ply", ".glb")

    @pytest.mark.parametrize("suffix", [".ply", ".glb"])
    def test_a_full_disk(self, suffix: str, capture: Path, results: Path) -> None:
        # Every flush fails as it does where no block is left; a file system of our own would need root.
        full = f"import os; from twinline.cli import main\ndef fail(_): raise OSError({errno.ENOSPC}, 'x')\n"
        full = full.replace("'x'", "os.strerror(28)") + "os.fsync = fail\nmain()"
        target = results / f"cloud{suffix}"
        done = twinline("reconstruct", capture, "-o", target, "--workers", 1, start=("-c", full))
        require_refusal(done, str(target), "no space left on device", "free some space")

    @pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit on the size of files")
    @pytest.mark.parametrize("suffix", [".ply", ".glb"])
    def test_a_file_that_grows_beyond_what_the_system_allows(self, suffix: str, capture: Path, results: Path) -> None:
        # The write itself fails after 16 kB: the half that was written must be gone.
        target = results / f"cloud{suffix}"
        done = twinline("reconstruct", capture, "-o", target, "--workers", 1, before=limit_files(16_384))
        require_refusal(done, str(target), "file too large")

    def test_an_earlier_result_stays_when_the_new_one_fails(self, capture: Path, tmp_path: Path) -> None:
        target = tmp_path / "cloud.ply"
        target.write_bytes(b"earlier")
        (capture / "laser" / NAMES[0]).unlink()
        require_refusal(twinline("reconstruct", capture, "-o", target))
        assert target.read_bytes() == b"earlier"
        assert not [path for path in tmp_path.iterdir() if "part" in path.name]


def limit_files(most_bytes: int) -> Callable[[], None]:
    """For the child: no file may grow beyond so many bytes."""

    def limit() -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

    return limit
