"""Writing a recording: what goes in comes out, and a disk that fails is told of in one sentence."""

import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader

from tests.unit.recording.recorded_passes import Happening, Kind, Link, header, jpeg, line, shot, write_recording
from twinline.errors import OutputError
from twinline.recording.container_file import ContainerFile
from twinline.recording.pass_messages import Message, Picture
from twinline.recording.pass_reader import open_recording
from twinline.recording.pass_writer import PassWriter


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "laser.mcap"


class TestWriting:
    def test_frames_come_back_byte_by_byte_with_all_that_was_known_of_them(self, path: Path) -> None:
        with PassWriter(path, header()) as writer:
            writer.frame(shot(3), lasers=frozenset({2}), cart_mm=1.25)
            writer.frame(shot(4), "laser/off")
        recording = open_recording(path)
        (frame,) = recording.parts["laser"]
        assert frame.picture.raw_bytes() == jpeg(3)
        assert (frame.sequence, frame.host_time_s, frame.exposure_s) == (3, shot(3).host_time_s, 0.004)
        assert (frame.lasers, frame.cart_mm) == (frozenset({2}), 1.25)
        assert [f.picture.name for f in recording.parts["laser/off"]] == ["00000004.jpg"]
        assert recording.whole
        assert recording.problems == ()

    def test_telemetry_and_events_come_back_to_the_last_bit(self, path: Path) -> None:
        lines = [line(i, host_time_s=0.1 + i / 3, board_time_s=i / 7, earlier_adc=(1, 2, 3)) for i in range(50)]
        event = Happening(4, 1 / 3, 2 / 3, Kind.MOTION_END, 0.1, 0.2, 5, -6)
        with PassWriter(path, header()) as writer:
            for item in lines:
                writer.telemetry(item)
            writer.event(event)
            writer.link(Link(0.1, "down", "the cable was pulled."))
            writer.note(0.2, "exposure", "4 ms")
        recording = open_recording(path)
        assert [recording.telemetry.line(i) for i in range(50)] == lines
        (back,) = recording.events
        assert (back.n, back.host_time_s, back.board_time_s, back.kind) == (4, 1 / 3, 2 / 3, "motion-end")
        assert (back.cart_mm, back.slide_mm, back.a, back.b) == (0.1, 0.2, 5, -6)
        assert (recording.links[0].state, recording.notes[0].text) == ("down", "4 ms")

    def test_the_head_says_what_was_set(self, path: Path) -> None:
        given = header(settings={"exposure_ms": 4.0}, leg=2, adc_per_count=16.0, adc_valid=(1.5, 99.0), rig="{}")
        PassWriter(path, given).close()
        back = open_recording(path).header
        assert vars(back) == vars(given)

    def test_a_standard_reader_finds_every_message_through_the_index(self, path: Path) -> None:
        write_recording(path, 10)
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None
            assert summary.statistics is not None
            counts = {summary.channels[c].topic: n for c, n in summary.statistics.channel_message_counts.items()}
            schemas = {schema.name for schema in summary.schemas.values()}
            messages = list(reader.iter_messages())
        assert counts["/laser/image"] == counts["/laser/frame"] == 10
        assert {"foxglove.CompressedImage", "twinline.frame", "twinline.board_telemetry"} <= schemas
        assert len(messages) == sum(counts.values())

    def test_several_threads_may_hand_over_at_once(self, path: Path) -> None:
        with PassWriter(path, header()) as writer:

            def hand_over() -> None:
                for number in range(200):
                    writer.telemetry(line(number))

            threads = [threading.Thread(target=hand_over) for _ in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        assert len(open_recording(path).telemetry) == 800

    def test_after_flush_all_can_be_read_though_it_is_still_being_written(self, path: Path) -> None:
        with PassWriter(path, header()) as writer:
            for number in range(5):
                writer.frame(shot(number))
            writer.flush()
            recording = open_recording(path)
            assert len(recording.parts["laser"]) == 5
            assert not recording.whole
            writer.frame(shot(5))
        assert len(open_recording(path).parts["laser"]) == 6

    def test_what_is_handed_over_is_soon_in_the_file_without_being_asked(self, path: Path) -> None:
        with PassWriter(path, header()) as writer:
            empty = writer.status().written_bytes
            writer.telemetry(line(0))
            deadline = threading.Event()
            while writer.status().written_bytes == empty and not deadline.wait(0.01):
                pass
            assert len(open_recording(path).telemetry) == 1


class TestRefusing:
    def test_a_file_that_exists_is_never_written_over(self, path: Path) -> None:
        path.write_bytes(b"precious")
        with pytest.raises(OutputError, match=r"laser\.mcap exists already"):
            PassWriter(path, header())
        assert path.read_bytes() == b"precious"

    def test_a_folder_that_is_missing_is_named(self, tmp_path: Path) -> None:
        with pytest.raises(OutputError, match=r"absent/laser\.mcap cannot be written: no such file"):
            PassWriter(tmp_path / "absent" / "laser.mcap", header())

    def test_after_close_nothing_is_taken(self, path: Path) -> None:
        writer = PassWriter(path, header())
        writer.close()
        writer.close()
        with pytest.raises(OutputError, match="is closed already"):
            writer.frame(shot(0))

    def test_pixels_that_do_not_fit_their_size_are_refused(self, path: Path) -> None:
        with PassWriter(path, header()) as writer, pytest.raises(ValueError, match="bytes are not 64 x 48 pixels"):
            writer.picture(Picture("laser", -1, "0.png", "gray8", b"123", (64, 48), 0.0, 0))

    def test_names_with_folders_are_refused(self, path: Path) -> None:
        with PassWriter(path, header()) as writer, pytest.raises(ValueError, match="no plain file name"):
            writer.picture(Picture("laser", -1, "../0.png", "png", b"123", (64, 48), 0.0, 0))


class _StuckDisk:
    """Lets no message through until it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.entered, self.free = threading.Event(), threading.Event()
        original = ContainerFile.add

        def add(file: ContainerFile, message: Message) -> None:
            self.entered.set()
            self.free.wait(60)
            original(file, message)

        monkeypatch.setattr(ContainerFile, "add", add)


class TestFailing:
    def test_a_disk_that_is_too_slow_refuses_the_frame_and_keeps_the_others(
        self, path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        disk = _StuckDisk(monkeypatch)
        room = 2 * (max(len(jpeg(i)) for i in range(4)) + 500) + 100
        with PassWriter(path, header(), most_waiting_bytes=room) as writer:
            writer.frame(shot(0))
            assert disk.entered.wait(60)
            writer.frame(shot(1))
            with pytest.raises(OutputError, match=r"the disk is too slow, .* record to a faster disk") as caught:
                writer.frame(shot(2))
            assert caught.value.code == "disk-too-slow"
            writer.telemetry(line(0))
            disk.free.set()
            writer.frame(shot(3), timeout_s=60)
        recording = open_recording(path)
        assert [f.sequence for f in recording.parts["laser"]] == [0, 1, 3]
        assert len(recording.telemetry) == 1

    def test_after_an_error_of_the_disk_every_call_says_so_and_the_rest_is_readable(
        self, path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        writer = PassWriter(path, header())
        for number in range(5):
            writer.frame(shot(number))
        writer.flush()

        def fail(_: ContainerFile) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(ContainerFile, "flush", fail)
        writer.frame(shot(5))
        for call in (writer.flush, lambda: writer.frame(shot(6)), lambda: writer.telemetry(line(0)), writer.close):
            with pytest.raises(OutputError, match=r"laser\.mcap cannot be written: no space left.*free some space"):
                call()
        assert writer.status().problem is not None
        assert [f.sequence for f in open_recording(path).parts["laser"]][:5] == [0, 1, 2, 3, 4]

    def test_an_error_while_the_block_fails_otherwise_does_not_hide_it(
        self, path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(_: ContainerFile) -> None:
            raise OSError(5, "Input/output error")

        monkeypatch.setattr(ContainerFile, "finish", fail)
        with pytest.raises(KeyError), PassWriter(path, header()):
            raise KeyError
        with pytest.raises(OutputError, match="input/output error"), PassWriter(path.with_name("b.mcap"), header()):
            pass
