from contextlib import suppress
from pathlib import Path

import cv2
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.unit.recording.sample_captures import SIZE, picture, write_list, write_pictures, write_video
from twinline.errors import CaptureError, FrameError
from twinline.recording.frame_list import open_frames


def rewrite(folder: Path, *lines: str, header: str = "frame,time_s,cart_mm") -> None:
    (folder / "frames.csv").write_text("\n".join([header, *lines, ""]))


@pytest.fixture
def laser(tmp_path: Path) -> Path:
    write_pictures(tmp_path / "laser", 4)
    return tmp_path / "laser"


def test_each_line_becomes_an_entry(laser: Path) -> None:
    rewrite(laser, "0001.png, 0.5 ,-3e0,12", "", "0000.png,0.5,2.25,", header="frame,time_s,cart_mm,lasers")
    frames = open_frames(laser, SIZE, 2).frames
    assert [(f.index, f.name, f.time_s, f.cart_mm, f.lasers) for f in frames] == [
        (0, "0001.png", 0.5, -3.0, frozenset({1, 2})),
        (1, "0000.png", 0.5, 2.25, frozenset()),
    ]


def test_without_the_column_lasers_all_are_on(laser: Path) -> None:
    assert {frame.lasers for frame in open_frames(laser, SIZE, 2).frames} == {None}


def test_a_table_saved_by_a_spreadsheet_is_read(laser: Path) -> None:
    (laser / "frames.csv").write_bytes(b'\xef\xbb\xbfcart_mm,frame,time_s\r\n1.5,"0000.png",0\r\n')
    assert open_frames(laser, SIZE, 2).frames[0].cart_mm == 1.5


def test_without_a_list_the_travel_is_unknown_and_the_error_says_what_to_write(laser: Path) -> None:
    (laser / "frames.csv").unlink()
    with pytest.raises(CaptureError, match=r"frames\.csv is missing, so the travel is unknown.*frame,time_s,cart_mm"):
        open_frames(laser, SIZE, 2)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], r"frames\.csv lists no frames"),
        (["0000.png,0,0", "absent.png,1,1"], r"frames\.csv names absent\.png, which is not in .*laser"),
        (["a.png,0,0", "b.png,1,1"], r"names a\.png.*2 of 2 frames are missing"),
        (["7,0,0"], r"names frame number 7, but .*laser holds no video"),
        (["0000.png,1,0", "0001.png,0.5,1"], r"line 3: time_s runs backwards, from 1 s to 0\.5 s"),
        (["0000.png,0,zero"], r"line 2: cart_mm must be a number .*'zero'"),
        (["0000.png,0,nan"], "line 2: cart_mm must be a number"),
        (["0000.png,0,1e999"], "line 2: cart_mm must be a number"),
        (["0000.png,0,1_0"], "line 2: cart_mm must be a number"),
        (["0000.png,0,"], "line 2: cart_mm is empty"),
        ([",0,1"], "line 2: frame is empty"),
        (["0000.png,0,1,5"], "line 2: 4 values where the header names 3"),
        (["0000.png,0,0", "0000.png,1,1"], r"line 3: frame 0000\.png was already listed in line 2"),
        (["../laser/0000.png,0,0"], "file name without folders"),
        (["..,0,0"], "file name without folders"),
        (['"0000.png,0,0'], "not a CSV file|values"),
    ],
)
def test_a_wrong_list_is_an_error_that_names_the_line(laser: Path, lines: list[str], words: str) -> None:
    rewrite(laser, *lines)
    with pytest.raises(CaptureError, match=words):
        open_frames(laser, SIZE, 2)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("", "is empty"),
        ("frame,time_s", "no column 'cart_mm'"),
        ("frame,time_s,cart_mm,speed", "unknown column 'speed'"),
        ("frame,time_s,cart_mm,frame", "'frame' twice"),
    ],
)
def test_a_wrong_header_is_an_error(laser: Path, header: str, words: str) -> None:
    (laser / "frames.csv").write_text(header)
    with pytest.raises(CaptureError, match=words):
        open_frames(laser, SIZE, 2)


@pytest.mark.parametrize(("lasers", "cell"), [(2, "3"), (2, "1 2"), (1, "2"), (1, "12"), (2, "x")])
def test_an_unknown_laser_is_an_error(laser: Path, lasers: int, cell: str) -> None:
    rewrite(laser, f"0000.png,0,0,{cell}", header="frame,time_s,cart_mm,lasers")
    with pytest.raises(CaptureError, match=f"line 2: lasers is '{cell}', but capture.json has {lasers}"):
        open_frames(laser, SIZE, lasers)


def test_pictures_of_another_size_than_stated_are_an_error_with_both_sizes(laser: Path) -> None:
    with pytest.raises(CaptureError, match=r"0000\.png is 64 x 48 px, but capture\.json says image_size 1280 x 720"):
        open_frames(laser, (1280, 720), 2)


def test_a_broken_first_picture_leaves_the_size_to_the_next(laser: Path) -> None:
    (laser / "0000.png").write_bytes(b"")
    assert len(open_frames(laser, SIZE, 2)) == 4
    with pytest.raises(CaptureError, match=r"0001\.png is 64 x 48"):
        open_frames(laser, (1280, 720), 2)


def test_the_travel_of_a_lying_board_needs_no_times(laser: Path) -> None:
    rewrite(laser, "0002.png,5", "0001.png,7", header="frame,cart_mm")
    assert [f.cart_mm for f in open_frames(laser, SIZE, 2, timed=False).frames] == [5.0, 7.0]


class TestVideo:
    def test_frame_numbers_of_a_video_are_accepted(self, tmp_path: Path) -> None:
        write_video(tmp_path, "video.avi", "MJPG", 6)
        write_list(tmp_path, ["1", "3", "5"])
        sequence = open_frames(tmp_path, SIZE, 2)
        assert [f.name for f in sequence.frames] == ["1", "3", "5"]
        assert sequence.source == tmp_path / "video.avi"

    @pytest.mark.parametrize(
        ("numbers", "words"),
        [
            (["0", "6"], r"frame 6 is past the end of video\.avi, which has 6 frames \(0 to 5\)"),
            (["2", "1"], "frame numbers run backwards, from 2 to 1"),
            (["1", "1"], "already listed"),
            (["1", "01"], "run backwards"),
            (["1", "two"], "'two' is not a frame number"),
        ],
    )
    def test_wrong_numbers_are_an_error(self, tmp_path: Path, numbers: list[str], words: str) -> None:
        write_video(tmp_path, "video.avi", "MJPG", 6)
        write_list(tmp_path, numbers)
        with pytest.raises(CaptureError, match=words):
            open_frames(tmp_path, SIZE, 2)

    def test_a_video_of_another_size_is_an_error(self, tmp_path: Path) -> None:
        write_video(tmp_path, "video.avi", "MJPG", 2)
        write_list(tmp_path, ["0"])
        with pytest.raises(CaptureError, match=r"video\.avi is 64 x 48 px, but .* 1280 x 720"):
            open_frames(tmp_path, (1280, 720), 2)

    def test_two_videos_are_an_error(self, tmp_path: Path) -> None:
        for name in ("video.avi", "video.mp4"):
            (tmp_path / name).write_bytes(b"RIFF")
        write_list(tmp_path, ["0"])
        with pytest.raises(CaptureError, match=r"several videos \(video\.avi, video\.mp4\)"):
            open_frames(tmp_path, SIZE, 2)

    @pytest.mark.parametrize(
        "data", [b"", b"RIFF____AVI and nothing else", b"#EXTM3U\nfile:///etc/hostname\n", bytes(5000)]
    )
    def test_an_unreadable_video_is_a_frame_error_that_names_it(self, tmp_path: Path, data: bytes) -> None:
        (tmp_path / "video.avi").write_bytes(data)
        write_list(tmp_path, ["0"])
        with pytest.raises(FrameError, match=r"video\.avi is not a video"):
            open_frames(tmp_path, SIZE, 2)


CELLS = st.sampled_from(["frame", "cart_mm", "0000.png", "0001.png", "1", "-2.5", "", '"', "\0", "é"]) | st.text(
    max_size=5
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(st.lists(st.lists(CELLS, max_size=4), max_size=4))
def test_any_table_gives_a_capture_error_or_frames(laser: Path, rows: list[list[str]]) -> None:
    text = "\n".join(["frame,time_s,cart_mm", *(",".join(row) for row in rows)])
    (laser / "frames.csv").write_bytes(text.encode("utf-8", "surrogatepass"))
    with suppress(CaptureError):
        assert len(open_frames(laser, SIZE, 2))


def test_a_reference_to_a_folder_is_a_missing_file(laser: Path) -> None:
    (laser / "sub.png").mkdir()
    rewrite(laser, "sub.png,0,0")
    with pytest.raises(CaptureError, match=r"names sub\.png, which is not in"):
        open_frames(laser, SIZE, 2)


def test_other_pictures_in_the_folder_are_ignored(laser: Path) -> None:
    assert cv2.imwrite(str(laser / "off.png"), picture(0))
    assert len(open_frames(laser, SIZE, 2)) == 4
