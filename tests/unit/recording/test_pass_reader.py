"""Reading recordings that are not whole: cut off anywhere, damaged anywhere, or something else altogether."""

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tests.unit.recording.recorded_passes import header, jpeg, line, shot, write_recording
from twinline.errors import CaptureError
from twinline.recording.container_walk import is_container, walk
from twinline.recording.pass_reader import Recording, open_recording
from twinline.recording.pass_writer import PassWriter
from twinline.recording.repair import repair

CHUNK = 6


def chunk_starts(path: Path) -> list[tuple[int, int]]:
    """Start and end of each chunk, by the container's own lengths."""
    data = path.read_bytes()
    position, found = 8, []
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        if opcode == CHUNK:
            found.append((position, position + 9 + length))
        position += 9 + length
    return found


def write_in_chunks(path: Path, chunks: int = 4, frames: int = 3) -> Path:
    """A recording whose chunks hold so many frames each."""
    with PassWriter(path, header()) as writer:
        for number in range(chunks * frames):
            writer.frame(shot(number))
            writer.telemetry(line(4 * number))
            if number % frames == frames - 1:
                writer.flush()
    return path


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_in_chunks(tmp_path / "laser.mcap")


def readable(path: Path) -> list[int]:
    """Numbers of the frames that a recording still gives, each checked byte by byte."""
    frames = open_recording(path).parts.get("laser", ())
    for frame in frames:
        assert frame.picture.raw_bytes() == jpeg(frame.sequence)
    return [frame.sequence for frame in frames]


def opened_or_refused(path: Path) -> Recording | str:
    """The recording, or the sentence that says why not."""
    try:
        return open_recording(path)
    except CaptureError as error:
        return error.detail


class TestCutOff:
    def test_at_any_byte_every_complete_frame_before_the_cut_is_there_and_nothing_else(
        self, recording: Path, tmp_path: Path
    ) -> None:
        data = recording.read_bytes()
        ends = [frame.picture.at.offset + frame.picture.at.length for frame in open_recording(recording).parts["laser"]]
        first_chunk = chunk_starts(recording)[0][0]
        cut_off = tmp_path / "cut.mcap"
        rng = np.random.default_rng(20261122)
        near_ends = [end + d for end in (*ends, *(b for _, b in chunk_starts(recording))) for d in (-1, 0, 1, 9, 40)]
        for cut in {*range(first_chunk, first_chunk + 120), *near_ends, *rng.integers(first_chunk, len(data), 60)}:
            cut_off.write_bytes(data[:cut])
            numbers = readable(cut_off)
            whole = sum(end <= cut for end in ends)
            # The line about a frame follows it; without it the frame is not known.
            assert numbers == list(range(len(numbers)))
            assert whole - 1 <= len(numbers) <= whole
            opened = open_recording(cut_off)
            assert opened.whole == (cut >= len(data))
            assert opened.whole or opened.problems
            assert cut_off.read_bytes() == data[:cut]

    def test_before_the_first_chunk_there_is_one_sentence(self, recording: Path, tmp_path: Path) -> None:
        data = recording.read_bytes()
        cut_off = tmp_path / "cut.mcap"
        for cut in range(1, chunk_starts(recording)[0][0]):
            cut_off.write_bytes(data[:cut])
            found = opened_or_refused(cut_off)
            assert str(cut_off) in found if isinstance(found, str) else not (found.whole or found.parts)

    def test_zeros_after_a_power_cut_are_the_end(self, recording: Path, tmp_path: Path) -> None:
        start, _ = chunk_starts(recording)[2]
        cut_off = tmp_path / "cut.mcap"
        cut_off.write_bytes(recording.read_bytes()[:start] + bytes(100_000))
        assert readable(cut_off) == [0, 1, 2, 3, 4, 5]

    def test_a_repaired_copy_is_whole_and_the_original_as_it_was(self, recording: Path, tmp_path: Path) -> None:
        _, end = chunk_starts(recording)[2]
        cut_off, copy = tmp_path / "cut.mcap", tmp_path / "copy.mcap"
        cut_off.write_bytes(recording.read_bytes()[:end])
        before = cut_off.read_bytes()
        (problem,) = repair(cut_off, copy)
        assert "not finished" in problem
        assert readable(copy) == readable(cut_off) == list(range(9))
        assert open_recording(copy).whole
        assert cut_off.read_bytes() == before


class TestDamaged:
    def test_a_changed_byte_of_a_picture_is_noticed_and_only_that_frame_is_lost(self, recording: Path) -> None:
        frames = open_recording(recording).parts["laser"]
        data = bytearray(recording.read_bytes())
        data[frames[4].picture.at.offset + 50] ^= 1
        recording.write_bytes(data)
        damaged = open_recording(recording).parts["laser"]
        with pytest.raises(OSError, match="checksum does not match"):
            damaged[4].picture.raw_bytes()
        assert all(frame.picture.raw_bytes() == jpeg(frame.sequence) for frame in damaged if frame.sequence != 4)

    @pytest.mark.parametrize("size", [20, 3000])
    def test_a_chunk_that_makes_no_sense_costs_its_own_frames_only(self, recording: Path, size: int) -> None:
        start, _ = chunk_starts(recording)[1]
        data = bytearray(recording.read_bytes())
        data[start : start + size] = np.random.default_rng(7).integers(0, 256, size, np.uint8).tobytes()
        recording.write_bytes(data)
        opened = open_recording(recording)
        numbers = [frame.sequence for frame in opened.parts["laser"]]
        assert {0, 1, 2, 6, 7, 8, 9, 10, 11} <= set(numbers)
        assert not opened.whole
        assert any("are damaged" in problem for problem in opened.problems)

    def test_a_line_of_telemetry_that_is_no_json_is_counted(self, recording: Path) -> None:
        data = recording.read_bytes()
        recording.write_bytes(data.replace(b'{"n":4,', b'{"n"!4,', 1))
        opened = open_recording(recording)
        assert len(opened.telemetry) == 11
        assert opened.problems == ("1 of its messages cannot be used",)

    def test_a_full_check_finds_a_changed_digit_that_nothing_else_would(self, recording: Path, tmp_path: Path) -> None:
        data = recording.read_bytes()
        changed = data.replace(b'"adc":104', b'"adc":105', 1)
        assert changed != data
        recording.write_bytes(changed)
        assert walk(recording).problems == []
        (problem,) = repair(recording, tmp_path / "copy.mcap")
        assert "does not match its checksum" in problem

    @pytest.mark.parametrize("seed", range(40))
    def test_noise_anywhere_never_crashes_and_never_gives_a_wrong_picture(self, recording: Path, seed: int) -> None:
        rng = np.random.default_rng(seed)
        data = bytearray(recording.read_bytes())
        for _ in range(10):
            at, length = int(rng.integers(0, len(data))), int(rng.integers(1, 200))
            data[at : at + length] = rng.integers(0, 256, len(data[at : at + length]), np.uint8).tobytes()
        recording.write_bytes(data)
        found = opened_or_refused(recording)
        if isinstance(found, str):
            assert found.endswith(".")
            return
        recorded = {jpeg(number) for number in range(12)}
        for frame in found.parts.get("laser", ()):
            with suppress(OSError):
                assert frame.picture.raw_bytes() in recorded


class TestForeign:
    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"", "is empty"),
            (b"\x89MCA", "cut off within its first bytes"),
            (b"\x89PNG\r\n\x1a\n" + bytes(100), "is not an MCAP file"),
            (b"RIFF" + bytes(100), "is not an MCAP file"),
        ],
    )
    def test_another_file_is_refused_in_one_sentence(self, tmp_path: Path, content: bytes, words: str) -> None:
        path = tmp_path / "other.mcap"
        path.write_bytes(content)
        with pytest.raises(CaptureError, match=words):
            open_recording(path)

    def test_an_mcap_file_of_another_program_is_refused(self, tmp_path: Path) -> None:
        from mcap.writer import Writer

        path = tmp_path / "robot.mcap"
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start("ros2", "another program")
            writer.finish()
        with pytest.raises(CaptureError, match="was not written by Twinline"):
            open_recording(path)

    def test_a_compressed_copy_is_refused_with_the_next_step(self, tmp_path: Path) -> None:
        from mcap.writer import CompressionType, Writer

        path = tmp_path / "small.mcap"
        with path.open("wb") as stream:
            writer = Writer(stream, compression=CompressionType.LZ4)
            writer.start("twinline", "another program")
            channel = writer.register_channel("/note", "json", 0)
            writer.add_message(channel, 0, b"{}" * 100, 0)
            writer.finish()
        with pytest.raises(CaptureError, match="decompress it first"):
            open_recording(path)

    def test_a_newer_format_is_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "new.mcap"
        write_recording(path, 2)
        data = path.read_bytes()
        path.write_bytes(data.replace(b"format\x01\x00\x00\x001", b"format\x01\x00\x00\x009", 1))
        with pytest.raises(CaptureError, match="has recording format 9, and this version reads up to 1"):
            open_recording(path)

    def test_a_container_is_known_by_its_first_bytes(self, tmp_path: Path, recording: Path) -> None:
        nothing = tmp_path / "nothing.mcap"
        nothing.touch()
        picture = tmp_path / "a.png"
        picture.write_bytes(b"\x89PNG")
        assert is_container(recording)
        assert is_container(nothing)
        assert not is_container(picture)
        assert not is_container(tmp_path / "absent")
