import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.recording.sample_captures import SIZE, number_of, picture, write_list, write_pictures, write_video
from twinline.errors import CaptureError, FrameError
from twinline.recording.frame_list import open_frames
from twinline.recording.frames import FrameSequence


def numbers_read(sequence: FrameSequence, indices: list[int]) -> list[int]:
    return [number_of(frame.image) for frame in sequence.read(indices) if frame.image is not None]


def write_uneven_video(path: Path, times: list[int]) -> Path:
    """A video of numbered pictures at the given multiples of 40 ms, and its list."""
    raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25, SIZE, raw)
    for i, time in enumerate(times):
        writer.set(cv2.VIDEOWRITER_PROP_PTS, time)
        writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, 1)
        writer.write(cv2.imencode(".jpg", picture(i))[1].reshape(1, -1))
    writer.release()
    write_list(path.parent, [str(i) for i in range(len(times))])
    return path


@pytest.fixture
def pictures(tmp_path: Path) -> FrameSequence:
    write_pictures(tmp_path, 12)
    return open_frames(tmp_path, SIZE, 2)


class TestPictures:
    def test_only_the_frames_asked_for_are_read(self, pictures: FrameSequence) -> None:
        for name in ("0000.png", "0005.png"):
            (pictures.source / name).unlink()
        frames = list(pictures.read([2, 3, 9]))
        assert [frame.entry.index for frame in frames] == [2, 3, 9]
        assert numbers_read(pictures, [2, 3, 9]) == [2, 3, 9]

    def test_frames_are_read_one_by_one(self, pictures: FrameSequence) -> None:
        reading = pictures.read()
        assert next(reading).image is not None
        (pictures.source / "0001.png").unlink()
        assert next(reading).image is None

    def test_a_truncated_jpeg_is_counted_and_the_rest_is_kept(self, tmp_path: Path) -> None:
        names = write_pictures(tmp_path, 5, ".jpg")
        broken = tmp_path / names[2]
        broken.write_bytes(broken.read_bytes()[:-100])
        frames = list(open_frames(tmp_path, SIZE, 2).read())
        assert [frame.image is None for frame in frames] == [False, False, True, False, False]
        problem = frames[2].problem
        assert problem is not None
        assert "0002.jpg is truncated" in problem

    def test_a_frame_of_another_size_is_a_problem_of_that_frame(self, pictures: FrameSequence) -> None:
        assert cv2.imwrite(str(pictures.source / "0007.png"), picture(7, (80, 48)))
        frames = list(pictures.read([6, 7, 8]))
        assert [frame.image is None for frame in frames] == [False, True, False]
        assert "0007.png is 80 x 48 px, not 64 x 48 px" in (frames[1].problem or "")

    def test_mixed_sizes_are_found_from_the_headers(self, pictures: FrameSequence) -> None:
        pictures.check_sizes()
        assert cv2.imwrite(str(pictures.source / "0007.png"), picture(7, (80, 48)))
        with pytest.raises(CaptureError, match=r"mixed sizes: .*0007\.png is 80 x 48 px, where 64 x 48 px"):
            pictures.check_sizes()

    def test_a_broken_file_does_not_count_as_another_size(self, pictures: FrameSequence) -> None:
        (pictures.source / "0003.png").write_bytes(b"\x89PNG\r\n\x1a\n")
        pictures.check_sizes()

    def test_frames_must_be_asked_for_in_order(self, pictures: FrameSequence) -> None:
        with pytest.raises(ValueError, match="ascending"):
            pictures.read([3, 3])


class TestSelection:
    def test_selected_frames_keep_their_place_in_the_pass(self, pictures: FrameSequence) -> None:
        part = pictures.select(range(1, 12, 4))
        assert [frame.entry.index for frame in part.read()] == [1, 5, 9]
        assert numbers_read(part, [0, 2]) == [1, 9]

    def test_chunks_cover_every_frame_once(self, pictures: FrameSequence) -> None:
        assert [i for chunk in pictures.chunks(5) for i in chunk] == list(range(12))
        assert max(len(chunk) for chunk in pictures.chunks(5)) == 5

    def test_a_selection_is_small_to_send(self, pictures: FrameSequence) -> None:
        assert len(pickle.dumps(pictures.select([3]))) < 1000


class TestVideo:
    @pytest.mark.parametrize(
        ("name", "codec"), [("video.avi", "MJPG"), ("video.mp4", "mp4v"), ("video.avi", "XVID"), ("video.mkv", "FFV1")]
    )
    def test_any_frame_read_alone_is_the_one_asked_for(self, tmp_path: Path, name: str, codec: str) -> None:
        write_video(tmp_path, name, codec, 200)
        write_list(tmp_path, [str(i) for i in range(200)])
        sequence = open_frames(tmp_path, SIZE, 2)
        assert numbers_read(sequence, list(range(200))) == list(range(200))
        rng = np.random.default_rng(20240607)
        for _ in range(10):
            wanted = sorted(rng.choice(200, 4, replace=False).tolist())
            assert numbers_read(sequence, wanted) == wanted

    def test_frames_at_uneven_times_are_still_told_apart(self, tmp_path: Path) -> None:
        times = np.cumsum(np.random.default_rng(20240607).integers(1, 4, 200)).tolist()
        path = write_uneven_video(tmp_path / "video.mkv", times)
        sequence = open_frames(tmp_path, SIZE, 2)
        by_rate = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        by_rate.set(cv2.CAP_PROP_POS_FRAMES, 150)
        assert number_of(by_rate.read()[1]) != 150, "the video must be one that the library's own seeking gets wrong"
        for i in range(100, 200, 7):
            assert numbers_read(sequence, [i]) == [i]

    def test_a_frame_read_alone_has_the_same_pixels_as_in_sequence(self, tmp_path: Path) -> None:
        write_video(tmp_path, "video.mp4", "mp4v", 120)
        write_list(tmp_path, [str(i) for i in range(120)])
        sequence = open_frames(tmp_path, SIZE, 2)
        one_by_one = [next(sequence.read([i])).image for i in (61, 99, 119)]
        together = [frame.image for frame in sequence.read()]
        for alone, index in zip(one_by_one, (61, 99, 119), strict=True):
            assert alone is not None
            np.testing.assert_array_equal(alone, together[index])

    def test_chunks_cover_every_frame_once_and_start_where_decoding_can(self, tmp_path: Path) -> None:
        write_video(tmp_path, "video.mp4", "mp4v", 100)
        write_list(tmp_path, [str(i) for i in range(10, 100)])
        sequence = open_frames(tmp_path, SIZE, 2)
        assert sequence.video is not None
        chunks = sequence.chunks(8)
        assert [i for chunk in chunks for i in chunk] == list(range(90))
        assert len(chunks) > 2
        assert {int(sequence.frames[c.start].name) for c in chunks[1:]} <= set(sequence.video.keys.tolist())

    @pytest.mark.parametrize("first", [0, 25, 30, 31])
    def test_a_damaged_stretch_is_counted_and_the_rest_is_kept(self, tmp_path: Path, first: int) -> None:
        path = write_video(tmp_path, "video.avi", "MJPG", 60)
        write_list(tmp_path, [str(i) for i in range(60)])
        data = bytearray(path.read_bytes())
        starts = [i for i in range(len(data) - 2) if data[i : i + 3] == b"\xff\xd8\xff"]
        assert len(starts) == 60
        data[starts[30] : starts[31] - 8] = bytes(starts[31] - 8 - starts[30])
        path.write_bytes(data)
        frames = list(open_frames(tmp_path, SIZE, 2).read(range(first, 60)))
        assert [f.problem for f in frames if f.image is None] == [f"frame 30 of {path} cannot be decoded"][: first < 31]
        assert [number_of(f.image) for f in frames if f.image is not None] == [i for i in range(first, 60) if i != 30]

    def test_a_video_that_vanished_is_an_error(self, tmp_path: Path) -> None:
        path = write_video(tmp_path, "video.avi", "MJPG", 3)
        write_list(tmp_path, ["0", "1"])
        sequence = open_frames(tmp_path, SIZE, 2)
        path.unlink()
        with pytest.raises(FrameError, match=r"video\.avi cannot be read"):
            list(sequence.read())


def test_another_process_reads_its_share(tmp_path: Path) -> None:
    write_video(tmp_path, "video.avi", "MJPG", 40)
    write_list(tmp_path, [str(i) for i in range(40)])
    sequence = open_frames(tmp_path, SIZE, 2)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(numbers_read, sequence.select(range(20, 30)), [0, 9]).result() == [20, 29]
