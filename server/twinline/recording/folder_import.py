"""A capture folder as a recording: every picture as it is, byte by byte, in one container."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2

from twinline.errors import CaptureError, FrameError, OutputError
from twinline.recording.atomic_file import atomic_path
from twinline.recording.capture import Capture, open_capture
from twinline.recording.frames import FrameSequence
from twinline.recording.images import PictureFile, picture_size
from twinline.recording.pass_header import PassHeader
from twinline.recording.pass_messages import Picture, tof_message
from twinline.recording.pass_writer import PassWriter
from twinline.recording.stored import StoredEncoding
from twinline.recording.tof import read_tof_table
from twinline.recording.topics import PartName

Report = Callable[[int, int], None]

_WAIT_S = 600.0
_PNG_START = b"\x89PNG"
_SEQUENCES: tuple[PartName, ...] = ("laser", "reference", "motion")


@dataclass(frozen=True)
class Imported:
    """What went into a recording.

    Attributes
    ----------
    pictures
        Number of pictures, those of all parts together.
    readings
        Readings of the distance sensor.
    """

    pictures: int
    readings: int


def import_folder(folder: Path, output: Path, *, report: Report = lambda done, total: None) -> Imported:
    """Write a capture folder into one recording.

    Pictures are taken as they are. Frames of a video are decoded and kept as PNG, which loses nothing of what a
    reconstruction sees. Files that are no part of a capture are left out.

    Raises
    ------
    CaptureError, FrameError
        If the folder is no usable capture.
    OutputError
        If the recording cannot be written; nothing is left behind then.
    """
    capture = open_capture(folder)
    if not capture.path.is_dir() or not (capture.path / "capture.json").is_file():
        raise CaptureError(f"{folder} is a recording already; give a capture folder.")
    sequences = [(part, frames) for part in _SEQUENCES if (frames := _frames(capture, part)) is not None]
    singles = list(_singles(capture))
    total = sum(len(frames) for _, frames in sequences) + len(singles)
    done = 0
    with atomic_path(output) as temporary:
        try:
            with PassWriter(temporary, _header(capture, dict(sequences)), sync=False) as writer:
                for part, frames in sequences:
                    for picture in _pictures(part, frames):
                        writer.picture(picture, timeout_s=_WAIT_S)
                        report(done := done + 1, total)
                for picture in singles:
                    writer.picture(picture, timeout_s=_WAIT_S)
                    report(done := done + 1, total)
                readings = _write_tof(capture, writer)
        except OutputError as error:
            # The temporary name means nothing to whoever reads the message.
            raise OutputError(error.detail.replace(str(temporary), str(output)), code=error.code) from error
    return Imported(done, readings)


def _header(capture: Capture, sequences: dict[PartName, FrameSequence]) -> PassHeader:
    rig = capture.path / "rig.json"
    places = {part: frames.places_to_share() for part, frames in sequences.items()}
    return PassHeader(
        kind="capture",
        capture=_text(capture.path / "capture.json"),
        rig=_text(rig) if rig.is_file() else None,
        settings={"imported_from": capture.path.resolve().name},
        share_places={part: row for part, row in places.items() if row is not None},
    )


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path} cannot be read as a text file: {error}.") from error


def _frames(capture: Capture, part: PartName) -> FrameSequence | None:
    if part == "motion":
        return capture.motion()
    return capture.laser if part == "laser" else capture.reference


def _pictures(part: PartName, frames: FrameSequence) -> Iterator[Picture]:
    if frames.video is None:
        for entry in frames.frames:
            yield _picture(
                part, frames.picture(entry), host_time_s=entry.time_s, cart_mm=entry.cart_mm, lasers=entry.lasers,
                sequence=entry.index,
            )  # fmt: skip
        return
    for frame in frames.read():
        # A frame that cannot be decoded is kept as one of no bytes: still listed, still counted as broken.
        data = b"" if frame.image is None else _png(frame.image)
        yield Picture(
            part, -1, f"{int(frame.entry.name):06d}.png", "png", data, frames.image_size, frame.entry.time_s,
            frame.entry.index, lasers=frame.entry.lasers, cart_mm=frame.entry.cart_mm,
        )  # fmt: skip


def _png(image: cv2.typing.MatLike) -> bytes:
    encoded, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not encoded:
        raise FrameError("A frame of the video could not be kept as PNG.")
    return bytes(data.tobytes())


def _singles(capture: Capture) -> Iterator[Picture]:
    if capture.laser_off is not None:
        yield _picture("laser/off", capture.laser_off)
    for view in capture.views():
        yield _picture("camera", view)
    for pair in capture.sheets():
        yield _picture("sheets/on", pair.on)
        yield _picture("sheets/off", pair.off)
    kept: set[str] = set()
    for height in capture.heights():
        off = None if height.off is None else height.off.name
        yield _picture("heights", height.path, height_mm=height.height_mm, off=off)
        if height.off is not None and height.off.name not in kept:
            kept.add(height.off.name)
            yield _picture("heights/off", height.off)


def _picture(
    part: PartName,
    file: PictureFile,
    *,
    host_time_s: float = math.nan,
    cart_mm: float | None = None,
    lasers: frozenset[int] | None = None,
    sequence: int = 0,
    height_mm: float | None = None,
    off: str | None = None,
) -> Picture:
    try:
        data = file.read_bytes()
    except OSError as error:
        raise FrameError(f"{file} cannot be read: {error.strerror or error}.") from error
    name = file.name
    png = data.startswith(_PNG_START) or (not data.startswith(b"\xff\xd8") and name.lower().endswith(".png"))
    encoding: StoredEncoding = "png" if png else "jpeg"
    return Picture(
        part, -1, name, encoding, data, _size(file), host_time_s, sequence,
        lasers=lasers, cart_mm=cart_mm, height_mm=height_mm, off=off,
    )  # fmt: skip


def _size(file: PictureFile) -> tuple[int, int]:
    try:
        return picture_size(Path(str(file)))
    except FrameError:
        return (0, 0)


def _write_tof(capture: Capture, writer: PassWriter) -> int:
    path = capture.path / "tof" / "samples.csv"
    if not path.is_file():
        return 0
    table = read_tof_table(path)
    rows = zip(
        table.time_s.tolist(), table.cart_mm.tolist(), table.slide_mm.tolist(), table.reading.tolist(), strict=True
    )
    for time_s, cart_mm, slide_mm, reading in rows:
        writer.message(tof_message(time_s, cart_mm, slide_mm, reading if math.isfinite(reading) else None, table.unit))
    return len(table.time_s)
