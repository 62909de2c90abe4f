"""Recordings under a process that is killed and disks that are full: real ones."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.unit.recording.recorded_passes import header, jpeg, line, shot
from twinline.errors import OutputError
from twinline.recording.pass_reader import open_recording
from twinline.recording.pass_writer import PassWriter

REPOSITORY = Path(__file__).resolve().parents[2]
MOST_LOST_S = 1.0


def record_and_kill(path: Path, after_s: float) -> list[tuple[int, float]]:
    """Frames that a process handed over, with their times, until it was killed; the last entry is the killing."""
    command = [sys.executable, "-m", "tests.integration.recording_process", str(path)]
    paths = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "server"), os.environ.get("PYTHONPATH", "")])
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, cwd=REPOSITORY, env={**os.environ, "PYTHONPATH": paths}, encoding="utf-8"
    ) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        time.sleep(after_s)
        killed_s = time.monotonic()
        process.send_signal(signal.SIGKILL)
        lines = [first, *process.stdout.read().splitlines()]
    handed_over = [(int(n), float(s)) for n, s in (text.split() for text in lines if text.count(" ") == 1)]
    return [*handed_over, (-1, killed_s)]


class TestKilled:
    @pytest.mark.parametrize("after_s", [0.9, 1.33, 1.8])
    def test_kill_9_loses_at_most_the_last_second(self, tmp_path: Path, after_s: float) -> None:
        path = tmp_path / "laser.mcap"
        *handed_over, (_, killed_s) = record_and_kill(path, after_s)
        before = path.read_bytes()
        recording = open_recording(path)
        frames = recording.parts["laser"]
        numbers = [frame.sequence for frame in frames]
        assert numbers == [number % 200 for number in range(len(numbers))]
        assert all(frame.picture.raw_bytes() == jpeg(frame.sequence) for frame in frames)
        safe = [number for number, time_s in handed_over if time_s <= killed_s - MOST_LOST_S]
        assert len(numbers) >= len(safe)
        assert len(recording.telemetry) >= len(safe)
        assert numbers
        assert not recording.whole
        assert path.read_bytes() == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own of 1 MB; skips where this user may not mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("mounting a small disk needs more rights than this user has")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def record_until_refused(path: Path) -> tuple[int, OutputError]:
    """Frames that were taken until the writer refused, and what it said."""
    writer = PassWriter(path, header())
    taken = 0
    try:
        while True:
            writer.frame(shot(taken % 200))
            writer.telemetry(line(taken))
            taken += 1
            if taken % 50 == 0:
                writer.flush()
    except OutputError as error:
        with pytest.raises(OutputError):
            writer.close()
        return taken, error


class TestFull:
    def test_a_full_disk_is_told_of_and_what_was_written_stays_readable(self, small_disk: Path) -> None:
        path = small_disk / "laser.mcap"
        taken, error = record_until_refused(path)
        assert (
            error.detail
            == f"{path} cannot be written: no space left on device; free some space or choose another disk."
        )
        self._require_readable(path, taken)

    def test_a_file_that_may_not_grow_is_told_of_and_what_was_written_stays_readable(self, tmp_path: Path) -> None:
        path = tmp_path / "laser.mcap"
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
        try:
            taken, error = record_until_refused(path)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert error.detail.startswith(f"{path} cannot be written: file too large")
        self._require_readable(path, taken)

    def test_a_disk_that_is_full_from_the_start_is_told_of_at_once(self, small_disk: Path) -> None:
        with pytest.raises(OSError, match="No space left"):
            (small_disk / "filler").write_bytes(bytes(2 << 20))
        with pytest.raises(OutputError, match="no space left on device"):
            PassWriter(small_disk / "laser.mcap", header())

    @staticmethod
    def _require_readable(path: Path, taken: int) -> None:
        recording = open_recording(path)
        frames = recording.parts["laser"]
        assert 0.8 * 1_000_000 < path.stat().st_size <= 1 << 20
        assert len(frames) > 0.8 * (taken - 50)
        assert all(frame.picture.raw_bytes() == jpeg(frame.sequence) for frame in frames)
        assert [frame.sequence for frame in frames] == [number % 200 for number in range(len(frames))]
        assert not recording.whole
