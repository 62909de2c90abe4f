"""A recording, or a folder of them, opened as a capture."""

import pickle
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from tests.unit.recording.recorded_passes import (
    FRAME_S,
    SPEED_MM_S,
    START_S,
    header,
    jpeg,
    line,
    shot,
    write_recording,
)
from tests.unit.recording.sample_captures import number_of, picture
from twinline.errors import CaptureError
from twinline.recording.capture import open_capture
from twinline.recording.images import read_image
from twinline.recording.pass_messages import tof_message
from twinline.recording.pass_writer import PassWriter
from twinline.recording.recorded_capture import RecordedCapture
from twinline.recording.stored import StoredEncoding


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "laser.mcap", 10)


class TestOneFile:
    def test_frames_have_the_position_of_their_mid_exposure(self, path: Path) -> None:
        laser = open_capture(path).laser
        assert laser is not None
        expected = [SPEED_MM_S * FRAME_S * number for number in range(10)]
        np.testing.assert_allclose([entry.cart_mm for entry in laser.frames], expected, atol=1e-9)
        np.testing.assert_allclose([entry.time_s - START_S for entry in laser.frames], np.arange(10) * FRAME_S)

    def test_a_share_travels_to_another_process_and_is_read_there(self, path: Path) -> None:
        laser = open_capture(path).laser
        assert laser is not None
        share = pickle.dumps(laser.select(range(3, 7)))
        assert len(share) < 4000
        images = [frame.image for frame in pickle.loads(share).read()]
        assert [number_of(image) for image in images if image is not None] == [3, 4, 5, 6]

    @pytest.mark.parametrize("encoding", ["jpeg", "gray8", "bgr8"])
    def test_pictures_are_read_as_they_were_taken(self, tmp_path: Path, encoding: StoredEncoding) -> None:
        path = tmp_path / "pass.mcap"
        with PassWriter(path, header()) as writer:
            writer.frame(shot(5, encoding), cart_mm=0.0)
            writer.frame(shot(6, encoding), "laser/off")
        capture = open_capture(path)
        assert capture.laser is not None
        assert capture.laser_off is not None
        (frame,) = capture.laser.read()
        assert frame.image is not None
        off = read_image(capture.laser_off)
        if encoding == "jpeg":
            assert (number_of(frame.image), number_of(off)) == (5, 6)
        elif encoding == "gray8":
            np.testing.assert_array_equal(frame.image, picture(5)[:, :, 0])
            np.testing.assert_array_equal(off, picture(6)[:, :, 0])
        else:
            grey = picture(5)[:, :, 0]
            np.testing.assert_array_equal(frame.image, np.stack([grey, grey // 2, grey // 4], axis=2))

    def test_a_damaged_frame_is_counted_and_the_rest_is_read(self, path: Path) -> None:
        laser = open_capture(path).laser
        assert laser is not None
        stored = laser.frames[4].stored
        assert stored is not None
        data = bytearray(path.read_bytes())
        data[stored.at.offset + 40] ^= 1
        path.write_bytes(data)
        frames = list(laser.read())
        assert [frame.entry.index for frame in frames if frame.image is None] == [4]
        assert frames[4].problem is not None
        assert frames[4].problem.endswith("the checksum does not match")

    def test_frames_without_a_position_are_left_out_and_told_of(self, tmp_path: Path) -> None:
        path = tmp_path / "pass.mcap"
        with PassWriter(path, header()) as writer:
            for number in range(10):
                writer.frame(shot(number))
            for number in range(17):
                writer.telemetry(line(number))
        capture = open_capture(path)
        assert capture.laser is not None
        assert [number_of(f.image) for f in capture.laser.read() if f.image is not None] == [0, 1, 2, 3, 4]
        assert [entry.index for entry in capture.laser.frames] == [0, 1, 2, 3, 4]
        (problem,) = capture.problems
        assert "5 frames are left out, since no telemetry tells where the cart was" in problem

    def test_without_any_telemetry_there_is_one_sentence(self, tmp_path: Path) -> None:
        path = tmp_path / "pass.mcap"
        with PassWriter(path, header()) as writer:
            writer.frame(shot(0))
        with pytest.raises(CaptureError, match="none of the 1 laser frames has a position"):
            open_capture(path)

    def test_a_pass_that_ended_before_its_first_frame_says_so(self, tmp_path: Path) -> None:
        path = tmp_path / "pass.mcap"
        PassWriter(path, header()).close()
        with pytest.raises(CaptureError, match="holds no frame and no reading"):
            open_capture(path)

    def test_the_rig_that_was_in_use_comes_with_it(self, tmp_path: Path, path: Path) -> None:
        from twinline.geometry.rig_json import rig_to_json

        plain = open_capture(path)
        assert not plain.has_rig
        assert plain.own_rig() is None
        text = rig_to_json(plain.rig())
        other = open_capture(write_recording(tmp_path / "other.mcap", 2, rig=text))
        rig = other.own_rig()
        assert other.has_rig
        assert rig is not None
        assert rig_to_json(rig) == text


class TestTof:
    def test_samples_of_telemetry_become_counts_at_the_board_s_own_times(self, tmp_path: Path) -> None:
        path = tmp_path / "tof.mcap"
        with PassWriter(path, header("tof", adc_per_count=16.0)) as writer:
            for number in range(8):
                writer.telemetry(line(number, adc=16 * (1000 + number), host_time_s=START_S + 0.01 * number))
        samples = open_capture(path).tof()
        assert samples is not None
        assert samples.unit == "adc"
        np.testing.assert_allclose(samples.reading, 1000 + np.arange(8))
        np.testing.assert_allclose(samples.time_s, START_S + 0.01 * np.arange(8))
        np.testing.assert_allclose(samples.distance_mm, 60 + 80 * samples.reading / 4095)

    def test_samples_outside_the_converter_s_limits_and_their_neighbours_are_no_readings(self, tmp_path: Path) -> None:
        path = tmp_path / "tof.mcap"
        with PassWriter(path, header("tof", adc_valid=(900.0, 1100.0))) as writer:
            for number in range(8):
                adc = {3: 1200, 7: 800}.get(number, 1000)
                writer.telemetry(line(number, adc=adc, host_time_s=START_S + 0.01 * number))
        samples = open_capture(path).tof()
        assert samples is not None
        # A reading is a mean since the one before: part of a neighbour may be wrong too.
        assert np.isnan(samples.reading).tolist() == [False, False, True, True, True, False, True, True]

    def test_earlier_samples_lie_between_the_lines(self, tmp_path: Path) -> None:
        path = tmp_path / "tof.mcap"
        with PassWriter(path, header("tof")) as writer:
            for number in (0, 1, 3):
                earlier = tuple(100 * number + k for k in (1, 2, 3))
                writer.telemetry(line(number, adc=100 * number + 4, earlier_adc=earlier))
        samples = open_capture(path).tof()
        assert samples is not None
        # The line numbered 2 was lost, and with it its samples.
        steps = np.array([0, 0.25, 0.5, 0.75, 1, 2.25, 2.5, 2.75, 3])
        np.testing.assert_allclose(samples.time_s, START_S + 0.01 * steps, atol=1e-9)
        np.testing.assert_allclose(samples.slide_mm, 0.5 * 0.01 * steps, atol=1e-12)
        assert samples.reading.tolist() == [4, 101, 102, 103, 104, 301, 302, 303, 304]

    def test_in_a_laser_pass_the_sensor_s_samples_are_no_tof_pass(self, path: Path) -> None:
        assert open_capture(path).tof() is None

    def test_readings_outside_the_range_become_nan_and_stay_as_rows(self, tmp_path: Path) -> None:
        path = tmp_path / "tof.mcap"
        with PassWriter(path, header("capture")) as writer:
            for number, reading in enumerate((100.0, None, 5000.0)):
                writer.message(tof_message(0.1 * number, 1.0, 2.0, reading, "adc"))
        capture = open_capture(path)
        samples = capture.tof()
        assert samples is not None
        assert np.isfinite(samples.reading).tolist() == [True, False, False]
        assert capture.rig().tof is not None


class TestFolder:
    def test_the_passes_of_a_scan_are_one_capture(self, tmp_path: Path) -> None:
        scan = tmp_path / "scan"
        scan.mkdir()
        write_recording(scan / "laser.mcap", 5)
        with PassWriter(scan / "tof.mcap", header("tof")) as writer:
            writer.telemetry(line(0))
        capture = open_capture(scan)
        assert isinstance(capture, RecordedCapture)
        assert capture.laser is not None
        assert len(capture.laser) == 5
        assert capture.tof() is not None
        assert capture.path == scan

    def test_a_pass_that_was_continued_is_one_pass(self, tmp_path: Path) -> None:
        scan = tmp_path / "scan"
        scan.mkdir()
        begun = datetime(2026, 11, 22, 8, tzinfo=UTC)
        write_recording(scan / "laser-1.mcap", 4, leg=1, started_at=begun + timedelta(seconds=60), host_time_s=START_S)
        write_recording(scan / "laser.mcap", 6, leg=0, started_at=begun, host_time_s=START_S)
        laser = open_capture(scan).laser
        assert laser is not None
        assert [number_of(f.image) for f in laser.read() if f.image is not None] == [0, 1, 2, 3, 4, 5, 0, 1, 2, 3]
        assert len({entry.name for entry in laser.frames}) == 10
        times = [entry.time_s for entry in laser.frames]
        assert times == sorted(times)
        assert times[6] == pytest.approx(START_S + 60)

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"scan_id": "s-2"}, "belong to different scans"),
            ({"capture": None}, "describe the scanner differently"),
            ({}, "both hold laser frames"),
        ],
    )
    def test_what_does_not_belong_together_is_named(
        self, tmp_path: Path, changes: dict[str, str | None], words: str
    ) -> None:
        scan = tmp_path / "scan"
        scan.mkdir()
        write_recording(scan / "a.mcap", 2)
        if "capture" in changes:
            changes = {"capture": header().capture.replace("three objects", "four objects")}
        write_recording(scan / "b.mcap", 2, **changes)
        with pytest.raises(CaptureError, match=words) as caught:
            open_capture(scan)
        assert "a.mcap" in caught.value.detail
        assert "b.mcap" in caught.value.detail

    def test_files_that_were_moved_still_read(self, tmp_path: Path, path: Path) -> None:
        moved = tmp_path / "elsewhere.mcap"
        shutil.move(path, moved)
        laser = open_capture(moved).laser
        assert laser is not None
        assert laser.frames[3].stored is not None
        assert laser.frames[3].stored.raw_bytes() == jpeg(3)
