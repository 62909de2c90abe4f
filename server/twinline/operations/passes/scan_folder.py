"""Where the passes of one scan lie, and what has been recorded of them so far."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from twinline.errors import CaptureError, InputError
from twinline.operations.passes.requests import LaserPassRequest, ScanRequest, TofPassRequest
from twinline.recording.pass_header import PassKind, new_scan_id
from twinline.recording.pass_reader import Recording, open_recording
from twinline.recording.recorded_capture import frame_positions

_SUFFIX = ".mcap"


@dataclass(frozen=True)
class ScanFolder:
    """A folder of recordings with one scan id; see `twinline.recording.recorded_capture`.

    Attributes
    ----------
    path
        The folder.
    scan_id
        Shared by all its recordings.
    """

    path: Path
    scan_id: str

    @classmethod
    def create(cls, path: Path) -> "ScanFolder":
        """A new folder, or an empty one.

        Raises
        ------
        CaptureError
            There is something in it already.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
            occupied = next(path.iterdir(), None)
        except OSError as error:
            raise CaptureError(f"{path} cannot be made: {(error.strerror or str(error)).lower()}.") from error
        if occupied is not None:
            raise CaptureError(f"{path} is not empty ({occupied.name} is in it); give a new folder for the recording.")
        return cls(path, new_scan_id())

    @classmethod
    def reopen(cls, path: Path) -> "ScanFolder":
        """The folder of a scan that was begun.

        Raises
        ------
        CaptureError
            There is no recording in it, or one of them cannot be read.
        """
        files = sorted(path.glob(f"*{_SUFFIX}"))
        if not files:
            raise CaptureError(f"{path} holds no recording, so there is no pass to continue.")
        return cls(path, open_recording(files[0]).header.scan_id)

    def legs(self, kind: PassKind) -> list[Recording]:
        """Recordings of a pass, in their order."""
        found = [open_recording(file) for file in sorted(self.path.glob(f"{kind}-*{_SUFFIX}"))]
        return sorted(found, key=lambda recording: recording.header.leg)

    def next_leg(self, kind: PassKind) -> tuple[int, Path]:
        """Number and file of the next leg of a pass."""
        taken = [path.stem.rpartition("-")[2] for path in self.path.glob(f"{kind}-*{_SUFFIX}")]
        number = max((int(text) for text in taken if text.isdecimal()), default=-1) + 1
        return number, self.path / f"{kind}-{number}{_SUFFIX}"

    def laser_pass_left(self) -> tuple[LaserPassRequest, float] | None:
        """The request of the laser pass and where it has to go on; None if it was never begun.

        The place is the position of its last frame, or the beginning where there is none. Where the lasers take turns
        it is the last frame of the one that has not come as far, so that neither lacks a line.
        """
        legs = self.legs("laser")
        if not legs:
            return None
        request = _laser_request(legs[0])
        return request, request.from_mm + request.direction * _reached_mm(request, legs)

    def tof_pass_left(self) -> tuple[TofPassRequest, int] | None:
        """The request of the ToF pass and how many of its rows are whole; None if it was never begun."""
        legs = self.legs("tof")
        if not legs:
            return None
        request = _tof_request(legs[0])
        return request, sum(event.kind == "row-end" for leg in legs for event in leg.events)


def recorded_requests(recordings: Sequence[Recording]) -> ScanRequest:
    """What was asked for when recordings of one scan were made.

    Raises
    ------
    CaptureError
        They do not say.
    """
    laser = next((r for r in recordings if r.header.kind == "laser"), None)
    tof = next((r for r in recordings if r.header.kind == "tof"), None)
    return ScanRequest(
        None if laser is None else _laser_request(laser),
        None if tof is None else _tof_request(tof),
    )


def _reached_mm(request: LaserPassRequest, legs: list[Recording]) -> float:
    """How far from its beginning the pass has come."""
    turns = (frozenset({1}), frozenset({2})) if request.alternating else (None,)
    reached = dict.fromkeys(turns, 0.0)
    for leg in legs:
        frames = leg.parts.get("laser", ())
        for frame, cart_mm in zip(frames, frame_positions(leg, frames).tolist(), strict=True):
            turn = frame.lasers if request.alternating else None
            if turn in reached and isfinite(cart_mm):
                reached[turn] = max(reached[turn], (cart_mm - request.from_mm) * request.direction)
    return min(reached.values())


def _request(recording: Recording) -> dict[str, object]:
    request = recording.header.settings.get("request")
    if not isinstance(request, dict):
        raise CaptureError(f"{recording.path} does not say which pass it belongs to; it cannot be continued.")
    return request


def _laser_request(recording: Recording) -> LaserPassRequest:
    try:
        return LaserPassRequest.from_json(_request(recording))
    except (TypeError, InputError) as error:
        raise CaptureError(f"{recording.path} does not say how its laser pass was asked for: {error}.") from error


def _tof_request(recording: Recording) -> TofPassRequest:
    try:
        return TofPassRequest.from_json(_request(recording))
    except (TypeError, InputError) as error:
        raise CaptureError(f"{recording.path} does not say how its ToF pass was asked for: {error}.") from error
