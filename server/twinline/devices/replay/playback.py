"""What time it is in a recording that plays: shared by its camera and its board, so that they stay together."""

import asyncio
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from twinline.errors import CaptureError
from twinline.recording.capture import open_capture
from twinline.recording.pass_header import PassKind
from twinline.recording.pass_reader import Recording
from twinline.recording.recorded_capture import RecordedCapture


class Playback:
    """A position in recordings that moves with the loop's time.

    Everything is handed out when its turn comes. With ``stamps="recorded"`` it keeps the times that it was recorded
    with: what is computed from a replay is bit by bit what was computed from the original. With ``stamps="loop"`` a
    pass is moved as a whole to the loop's present, which whoever drives the machine and looks at the clock needs; that
    rounds times, so what is computed differs in the last digits.

    Parameters
    ----------
    recordings
        The passes of a scan.
    speed
        Seconds of the recording in a second of the loop; infinite for as fast as anybody reads.
    armed
        Whether to wait for a pass to be asked for. Otherwise the first recording plays as soon as anybody reads.
    stamps
        Which times frames, telemetry and events carry.

    Attributes
    ----------
    lit
        Lasers that the machine that stands in has switched on; the camera's still pictures go by it.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        *,
        speed: float = 1.0,
        armed: bool = False,
        stamps: Literal["recorded", "loop"] = "recorded",
    ) -> None:
        if not speed > 0:
            raise ValueError("a replay needs a positive speed")
        self.recordings = tuple(recordings)
        self.armed = armed
        self.moves_stamps = stamps == "loop"
        self.lit: frozenset[int] = frozenset()
        self._speed = speed
        self._left = list(recordings)
        self._current: Recording | None = None
        self._first_s = 0.0
        self._begun_s = 0.0
        self._passes = 0
        self._begun = asyncio.Event()

    @property
    def current(self) -> Recording | None:
        """The recording that plays; None before it begins."""
        return self._current

    @property
    def passes(self) -> int:
        """How many recordings have begun to play."""
        return self._passes

    @property
    def speed(self) -> float:
        """Seconds of the recording in a second of the loop."""
        return self._speed

    def begin(self, kind: PassKind | None = None, plan: Mapping[str, object] | None = None) -> Recording | None:
        """Begin to play a recording.

        Parameters
        ----------
        kind
            Of which kind; any if None.
        plan
            What ``PassHeader.settings`` should say under ``plan``; if none says so, the next of the kind is taken.

        Returns
        -------
        Recording or None
            What plays now; None if there is none left.
        """
        fitting = [r for r in self._left if kind is None or r.header.kind in {kind, "capture"}]
        planned = [r for r in fitting if plan is not None and r.header.settings.get("plan") == plan]
        if not fitting:
            return None
        chosen = (planned or fitting)[0]
        self._left.remove(chosen)
        self._current = chosen
        self._passes += 1
        self._first_s = first_time_s(chosen)
        self._begun_s = asyncio.get_running_loop().time()
        begun, self._begun = self._begun, asyncio.Event()
        begun.set()
        return chosen

    def begin_unless_armed(self) -> None:
        """Begin with the first recording, unless a pass is to be waited for or something plays already."""
        if not self.armed and not self._passes:
            self.begin()

    async def next_pass(self, after: int) -> Recording:
        """Wait until more than so many recordings have begun; the one that plays then."""
        while self._passes <= after or self._current is None:
            await self._begun.wait()
        return self._current

    @property
    def upcoming(self) -> Recording | None:
        """The recording that would play next; None if there is none left."""
        return self._left[0] if self._left else None

    def stamp_s(self, host_time_s: float) -> float:
        """The time that something carries when it is handed out, from the time that it was recorded with."""
        return host_time_s - self._first_s + self._begun_s if self.moves_stamps else host_time_s

    def due_in_s(self, host_time_s: float) -> float:
        """Seconds of the loop until a moment of the recording comes; 0 if it is past, or has no time."""
        if math.isinf(self._speed) or not math.isfinite(host_time_s):
            return 0.0
        played_s = asyncio.get_running_loop().time() - self._begun_s
        return max((host_time_s - self._first_s) / self._speed - played_s, 0.0)


def open_playback(
    path: Path, *, speed: float = 1.0, armed: bool = False, stamps: Literal["recorded", "loop"] = "recorded"
) -> Playback:
    """A playback of a recording, or of the recordings of a scan in a folder.

    Raises
    ------
    CaptureError
        If it is no recording.
    """
    capture = open_capture(path)
    if not isinstance(capture, RecordedCapture):
        raise CaptureError(f"{path} is a capture folder, not a recording; import it first.")
    return Playback(capture.recordings, speed=speed, armed=armed, stamps=stamps)


def first_time_s(recording: Recording) -> float:
    """Host time of the first thing in a recording."""
    times = [frames[0].host_time_s for frames in recording.parts.values()]
    times += [events[0].host_time_s for events in (recording.events, recording.links) if events]
    if len(recording.telemetry):
        times.append(float(recording.telemetry.host_time_s[0]))
    known = [time_s for time_s in times if math.isfinite(time_s)]
    return min(known, default=recording.header.host_time_s)
