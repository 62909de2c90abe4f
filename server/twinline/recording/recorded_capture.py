"""Recordings as a capture: one file, or the files of one scan in a folder.

Each pass is a file of its own, and files belong together because they carry the same scan id and the same description
of the scanner. A pass that was interrupted goes on in another file, its next *leg*: legs of one part are joined in
their order. Where a frame's position is not recorded with it, it is interpolated from the telemetry of its own file.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import CaptureError
from twinline.geometry.nominal import TofUnit
from twinline.geometry.rig import Rig
from twinline.recording.capture import Capture, HeightView, SheetPair
from twinline.recording.cart_track import CartTrack, cart_at
from twinline.recording.frames import FrameEntry, FrameSequence
from twinline.recording.images import PictureFile
from twinline.recording.pass_reader import Recording, open_recording, require_parts
from twinline.recording.pass_rows import RecordedFrame
from twinline.recording.stored import StoredPicture
from twinline.recording.tof import TofSamples
from twinline.recording.tof_readings import recorded_readings, recorded_unit
from twinline.recording.topics import PartName


@dataclass(frozen=True, eq=False)
class RecordedCapture(Capture):
    """A capture that lies in recordings.

    Attributes
    ----------
    recordings
        In the order of their legs.
    unplaced
        Frames that are left out because their position is not known.
    """

    recordings: tuple[Recording, ...]
    unplaced: int

    @property
    def problems(self) -> tuple[str, ...]:
        """What is missing of the recordings; a sentence each."""
        found = [f"{r.path}: {'; '.join(r.problems)}." for r in self.recordings if r.problems]
        if self.unplaced:
            found.append(
                f"{self.path}: {self.unplaced} frames are left out, since no telemetry tells where the cart was."
            )
        return tuple(found)

    def views(self) -> tuple[PictureFile, ...]:
        """Views of the calibration board, by name."""
        return tuple(self._pictures("camera"))

    def motion(self) -> FrameSequence | None:
        """The board lying still while the cart travels; None where there is no such part."""
        return _sequence(self.path, self.recordings, "motion", self.info.image_size)[0]

    def sheets(self) -> tuple[SheetPair, ...]:
        """Poses of the board with the stripes on and off, by name.

        Raises
        ------
        CaptureError
            If a picture has no partner of the same name.
        """
        on = {picture.stem: picture for picture in self._pictures("sheets/on")}
        off = {picture.stem: picture for picture in self._pictures("sheets/off")}
        alone = sorted(on.keys() ^ off.keys())
        if alone:
            raise CaptureError(f"{self.path}: the board pose {alone[0]} was not taken with the stripes on and off.")
        return tuple(SheetPair(stem, on[stem], off[stem]) for stem in sorted(on))

    def heights(self) -> tuple[HeightView, ...]:
        """Blocks of known height; none where there is no such part.

        Raises
        ------
        CaptureError
            If a picture has no height, or lacks its view with the lasers off.
        """
        off = {picture.name: picture for picture in self._pictures("heights/off")}
        views = []
        for frame in _frames(self.recordings, "heights"):
            if frame.height_mm is None or (frame.off is not None and frame.off not in off):
                raise CaptureError(f"{frame.picture} has no height, or no view with the lasers off; record it again.")
            views.append(HeightView(frame.picture, frame.height_mm, None if frame.off is None else off[frame.off]))
        return tuple(views)

    def tof(self) -> TofSamples | None:
        """The ToF pass; None where there is none.

        Raises
        ------
        CaptureError
            If the scanner's description has no such sensor.
        """
        readings = recorded_readings(self.recordings)
        if readings is None:
            return None
        if self.info.tof is None:
            raise CaptureError(f"{self.path} holds a ToF pass, but its capture.json has no field tof.")
        return readings.samples(self.info.tof)

    @property
    def has_rig(self) -> bool:
        """Whether a rig was in use when it was recorded."""
        return any(r.header.rig is not None for r in self.recordings)

    def own_rig(self) -> Rig | None:
        """The rig in use when it was recorded; None where there was none.

        Raises
        ------
        RigError
            If it cannot be read.
        """
        return next((rig for r in self.recordings if (rig := r.header.read_rig()) is not None), None)

    def _tof_unit(self) -> TofUnit | None:
        return recorded_unit(self.recordings)

    def _pictures(self, part: PartName) -> Sequence[StoredPicture]:
        return sorted((frame.picture for frame in _frames(self.recordings, part)), key=lambda p: p.name)


def open_recorded(path: Path, files: Sequence[Path]) -> RecordedCapture:
    """Open recordings that belong together as one capture.

    Parameters
    ----------
    path
        What was asked for: the file, or the folder that the files are in.

    Raises
    ------
    CaptureError
        If a file is no recording, they do not belong together, or there is nothing in them.
    """
    recordings = sorted((open_recording(file) for file in files), key=lambda r: (r.header.leg, r.header.started_at))
    first = recordings[0]
    for other in recordings[1:]:
        if other.header.scan_id != first.header.scan_id:
            raise CaptureError(
                f"{first.path.name} and {other.path.name} in {path} belong to different scans "
                f"({first.header.scan_id} and {other.header.scan_id}); keep each scan in a folder of its own."
            )
        if other.header.capture != first.header.capture:
            raise CaptureError(
                f"{first.path.name} and {other.path.name} in {path} describe the scanner differently; a scan is made "
                "with one setting."
            )
    if len(recordings) == 1:
        require_parts(first)
    _require_one_per_leg(path, recordings)
    size = first.info.image_size
    laser, unplaced = _sequence(path, recordings, "laser", size)
    reference, more = _sequence(path, recordings, "reference", size)
    off = next((frame.picture for frame in _frames(recordings, "laser/off")), None)
    return RecordedCapture(path, first.info, laser, reference, off, tuple(recordings), unplaced + more)


def _require_one_per_leg(path: Path, recordings: Sequence[Recording]) -> None:
    seen: dict[tuple[PartName, int], Recording] = {}
    for recording in recordings:
        for part in recording.parts:
            other = seen.setdefault((part, recording.header.leg), recording)
            if other is not recording:
                raise CaptureError(
                    f"{other.path.name} and {recording.path.name} in {path} both hold {part} frames; keep one."
                )


def _frames(recordings: Sequence[Recording], part: PartName) -> tuple[RecordedFrame, ...]:
    return tuple(frame for recording in recordings for frame in recording.parts.get(part, ()))


def _sequence(
    path: Path, recordings: Sequence[Recording], part: PartName, size: tuple[int, int]
) -> tuple[FrameSequence | None, int]:
    """Frames of a part with their positions, and how many were left out for want of one."""
    holders = [recording for recording in recordings if recording.parts.get(part)]
    if not holders:
        return None, 0
    entries: list[FrameEntry] = []
    left_out = 0
    for recording in holders:
        frames = recording.parts[part]
        positions = frame_positions(recording, frames)
        for frame, cart_mm in zip(frames, positions.tolist(), strict=True):
            if not np.isfinite(cart_mm):
                left_out += 1
                continue
            name = _name(frame.picture.name, recording.header.leg)
            time_s = frame.host_time_s + recording.shift_from(holders[0])
            entries.append(FrameEntry(len(entries), name, time_s, cart_mm, frame.lasers, frame.picture))
    if not entries:
        raise CaptureError(
            f"{path}: none of the {left_out} {part} frames has a position, since no telemetry was recorded around "
            "them; record the pass again."
        )
    source = path if path.is_file() or len(holders) > 1 else holders[0].path
    places = holders[0].header.share_places.get(part) if len(holders) == 1 else None
    return FrameSequence(source, tuple(entries), size, share_places=places), left_out


def frame_positions(recording: Recording, frames: Sequence[RecordedFrame]) -> FloatArray:
    """Positions of the cart at the middle of each exposure, (n,), millimetres; NaN where they are not known."""
    given = np.array([np.nan if frame.cart_mm is None else frame.cart_mm for frame in frames], np.float64)
    unknown = np.isnan(given)
    if unknown.any() and len(recording.telemetry):
        telemetry = recording.telemetry
        track = CartTrack(telemetry.host_time_s, telemetry.board_time_s, telemetry.cart_mm)
        given[unknown] = cart_at(track, np.array([frame.host_time_s for frame in frames])[unknown])
    return given


def _name(name: str, leg: int) -> str:
    return name if leg == 0 else f"{PurePosixPath(name).stem}-leg{leg}{PurePosixPath(name).suffix}"
