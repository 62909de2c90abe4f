"""Recordings as a capture folder: ordinary files that anything can read."""

import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from twinline.errors import CaptureError, OutputError
from twinline.recording.atomic_file import output_error
from twinline.recording.frames import FrameEntry, FrameSequence
from twinline.recording.images import PictureFile
from twinline.recording.recorded_capture import RecordedCapture
from twinline.recording.stored import StoredPicture
from twinline.recording.tof_readings import recorded_readings

Report = Callable[[int, int], None]


@dataclass
class Exported:
    """What was written.

    Attributes
    ----------
    pictures
        Number of pictures.
    readings
        Readings of the distance sensor.
    problems
        What was left out, a sentence each.
    """

    pictures: int = 0
    readings: int = 0
    problems: list[str] = field(default_factory=list)


def export_folder(capture: RecordedCapture, folder: Path, *, report: Report = lambda done, total: None) -> Exported:
    """Write recordings into a new capture folder.

    Pictures are written as they were delivered; plain pixels become PNG. Positions and times are written with every
    digit, so that what is computed from the folder is what is computed from the recording.

    Parameters
    ----------
    folder
        Missing or empty; it is there as a whole or not at all.

    Raises
    ------
    CaptureError
        If a recording cannot be read any more, or holds a part that a capture folder cannot.
    OutputError
        If the folder is not empty, or cannot be written.
    """
    with _new_folder(folder) as temporary:
        writer = _FolderWriter(temporary, capture, report)
        writer.write()
    writer.exported.problems[:0] = capture.problems
    return writer.exported


class _FolderWriter:
    def __init__(self, folder: Path, capture: RecordedCapture, report: Report) -> None:
        self._folder, self._capture, self._report = folder, capture, report
        self.exported = Exported()

    def write(self) -> None:
        capture = self._capture
        self._text("capture.json", capture.recordings[0].header.capture)
        rig = next((r.header.rig for r in capture.recordings if r.header.rig is not None), None)
        if rig is not None:
            self._text("rig.json", rig)
        self._pass("laser", capture.laser)
        self._pass("reference", capture.reference)
        self._pass("motion", capture.motion())
        if isinstance(capture.laser_off, StoredPicture):
            off = capture.laser_off
            self._picture(off, self._folder / "laser" / f"off{PurePosixPath(off.name).suffix}")
        for view in capture.views():
            self._single(view)
        for pair in capture.sheets():
            self._single(pair.on)
            self._single(pair.off)
        self._heights()
        self._tof()

    def _pass(self, part: str, frames: FrameSequence | None) -> None:
        if frames is None:
            return
        folder = self._folder / part
        rows: list[str] = []
        names: set[str] = set()
        lasers = any(entry.lasers is not None for entry in frames.frames)
        timed = all(np.isfinite(entry.time_s) for entry in frames.frames)
        lost = 0
        for done, entry in enumerate(frames.frames, 1):
            name = _free_name(entry.name, entry.index, names)
            if entry.stored is not None and self._picture(entry.stored, folder / name):
                names.add(name)
                rows.append(self._row(entry, name, timed=timed, lasers=lasers))
            else:
                lost += 1
            self._report(done, len(frames))
        header = ["frame", *(["time_s"] if timed else []), "cart_mm", *(["lasers"] if lasers else [])]
        if rows:
            self._text(f"{part}/frames.csv", "\n".join([",".join(header), *rows]) + "\n")
        if lost:
            self.exported.problems.append(f"{lost} {part} frames are damaged in the recording and were left out.")

    def _row(self, entry: FrameEntry, name: str, *, timed: bool, lasers: bool) -> str:
        cells = [name, *([repr(entry.time_s)] if timed else []), repr(entry.cart_mm)]
        if lasers:
            on = range(1, len(self._capture.info.lasers) + 1) if entry.lasers is None else sorted(entry.lasers)
            cells.append("".join(str(number) for number in on))
        return ",".join(cells)

    def _single(self, picture: PictureFile) -> None:
        if isinstance(picture, StoredPicture) and not self._picture(
            picture, self._folder / picture.part / picture.name
        ):
            raise CaptureError(f"{picture} is damaged in the recording; there is nothing to put in its place.")

    def _heights(self) -> None:
        rows = []
        written: set[str] = set()
        for view in self._capture.heights():
            for picture in (view.path, view.off):
                if isinstance(picture, StoredPicture) and picture.name not in written:
                    written.add(picture.name)
                    self._picture(picture, self._folder / "heights" / picture.name)
            rows.append(f"{view.path.name},{view.height_mm!r},{'' if view.off is None else view.off.name}")
        if rows:
            self._text("heights/heights.csv", "\n".join(["frame,height_mm,off_frame", *rows]) + "\n")

    def _tof(self) -> None:
        table = recorded_readings(self._capture.recordings)
        if table is None:
            return
        columns = (table.time_s, table.cart_mm, table.slide_mm, table.reading)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        lines = [f"{t!r},{cart!r},{slide!r},{'' if r != r else repr(r)}" for t, cart, slide, r in rows]
        self._text("tof/samples.csv", "\n".join([f"time_s,cart_mm,slide_mm,{table.unit}", *lines]) + "\n")
        self.exported.readings = len(lines)

    def _picture(self, picture: StoredPicture, path: Path) -> bool:
        """Write a picture; False if the recording no longer has it as it was."""
        try:
            data = picture.raw_bytes()
        except OSError:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(_as_file(picture, data))
        self.exported.pictures += 1
        return True

    def _text(self, name: str, text: str) -> None:
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")


def _as_file(picture: StoredPicture, data: bytes) -> bytes:
    if picture.at.encoding in {"jpeg", "png"}:
        return data
    width, height = picture.at.size
    shape = (height, width) if picture.at.encoding == "gray8" else (height, width, 3)
    image = np.frombuffer(data, np.uint8).reshape(shape)
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return bytes(encoded.tobytes())


def _free_name(name: str, index: int, taken: set[str]) -> str:
    # ``off`` is the name of the picture with the lasers off.
    path = PurePosixPath(name)
    return f"{path.stem}-{index}{path.suffix}" if name in taken or path.stem == "off" else name


@contextmanager
def _new_folder(folder: Path) -> Iterator[Path]:
    """A folder to fill, which takes the given name when all is in it."""
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise OutputError(f"{folder} exists and is not an empty folder; choose another name.")
        temporary = folder.absolute().parent / f".{secrets.token_hex(8)}.part"
        temporary.mkdir()
    except OSError as error:
        raise output_error(folder, error) from error
    try:
        yield temporary
        if folder.exists():
            folder.rmdir()
        temporary.replace(folder)
    except OSError as error:
        raise output_error(folder, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
