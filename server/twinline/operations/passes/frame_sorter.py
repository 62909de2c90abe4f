"""Which frames of a laser pass show its light, and which laser's.

A frame reaches the host later than the board's report on the same moment, or earlier: so a frame waits until the board
has told of a time beyond its exposure. An event may come late, since it is sent again where it was lost, but telemetry
tells whether the lasers shine: a line that does not agree with the events known so far is believed only when they have
caught up.
"""

from collections import deque
from collections.abc import Callable
from math import floor, inf

from twinline.devices.board import BoardEvent, BoardMessage, LaserPass, LinkChange
from twinline.devices.camera import CameraFrame
from twinline.devices.serial.protocol_gen import EventKind

SWITCHING_S = 0.002
"""Uncertainty of the moment in which a laser is switched, against the frame's."""

Keep = Callable[[CameraFrame, frozenset[int]], None]


class FrameSorter:
    """Hands on the frames whose exposure lies within the lit range of a pass, with the lasers that were on.

    Parameters
    ----------
    plan
        The pass that the board runs.
    keep
        Called with each such frame. The set is empty where the lasers changed within the exposure.
    """

    def __init__(self, plan: LaserPass, keep: Keep) -> None:
        self._plan = plan
        self._keep = keep
        self._waiting: deque[CameraFrame] = deque()
        self._start_s: float | None = None
        self._end_s: float | None = None
        self._known_s = -inf
        self._told_s = -inf
        self._told_lit = False
        self._beyond = False
        self.kept = 0

    @property
    def begun(self) -> bool:
        """Whether the range has been entered."""
        return self._start_s is not None

    @property
    def complete(self) -> bool:
        """Whether the range has ended and a frame from beyond it has come, so that none is missing."""
        return self._end_s is not None and not self._waiting and self._beyond

    def message(self, message: BoardMessage) -> None:
        """Take in what the board tells."""
        if isinstance(message, LinkChange):
            return
        if isinstance(message, BoardEvent):
            if message.kind is EventKind.SCAN_START:
                self._start_s = message.host_time_s
            elif message.kind is EventKind.SCAN_END or self._cut(message):
                self._end_s = message.host_time_s
        else:
            self._told_s = max(self._told_s, message.host_time_s)
            self._told_lit = bool(message.lasers)
        if self._agrees():
            self._known_s = self._told_s
        self._sort()

    def frame(self, frame: CameraFrame) -> None:
        """Take in a frame."""
        self._waiting.append(frame)
        self._sort()

    def _agrees(self) -> bool:
        """Whether the newest telemetry tells of the same light as the events do."""
        if self._start_s is None:
            return not self._told_lit
        if self._end_s is not None:
            return True
        return self._told_lit or self._told_s <= self._start_s or not all(self._plan.phases)

    def _cut(self, message: BoardEvent) -> bool:
        """Whether the light ended before its time: a stop switches it off at once and brakes then."""
        ended = message.kind in (EventKind.MOTION_END, EventKind.LATCH, EventKind.BOOT)
        ended |= message.kind is EventKind.LASERS and not message.a
        return ended and self._start_s is not None and self._end_s is None

    def _sort(self) -> None:
        while self._waiting:
            frame = self._waiting[0]
            half = 0.5 * (frame.exposure_s or 0.0)
            if frame.host_time_s + half > self._known_s:
                return
            self._waiting.popleft()
            begins, ends = frame.host_time_s - half, frame.host_time_s + half
            if self._start_s is None or begins < self._start_s:
                continue
            if self._end_s is not None and ends > self._end_s:
                self._beyond = True
                continue
            self.kept += 1
            self._keep(frame, self._lasers(begins - self._start_s, ends - self._start_s))

    def _lasers(self, begins_s: float, ends_s: float) -> frozenset[int]:
        phases, phase_s = self._plan.phases, self._plan.phase_s
        if len(phases) == 1:
            return phases[0]
        first = floor((begins_s - SWITCHING_S) / phase_s)
        last = floor((ends_s + SWITCHING_S) / phase_s)
        return phases[first % len(phases)] if first == last else frozenset()
