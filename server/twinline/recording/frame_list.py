"""Opening the frames of a pass: the folder, its ``frames.csv`` and the video, checked against each other."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

from twinline.errors import CaptureError, FrameError
from twinline.recording.csv_table import Row, parse_whole, read_table
from twinline.recording.frames import FrameEntry, FrameSequence
from twinline.recording.images import PICTURE_SUFFIXES, picture_size
from twinline.recording.video import index_video

LIST_NAME = "frames.csv"
_NOT_VIDEO = frozenset({".csv", ".json", ".txt", ".md", ""}) | PICTURE_SUFFIXES


def open_frames(
    folder: Path, image_size: tuple[int, int], lasers: int, *, timed: bool = True, needed: str = "the travel"
) -> FrameSequence:
    """Open the frames of one pass.

    Parameters
    ----------
    folder
        Holds ``frames.csv`` and either pictures or one file ``video.*``.
    image_size
        Width and height in pixels that ``capture.json`` states.
    lasers
        Number of lasers of the rig.
    timed
        Whether the list must have a column ``time_s``.
    needed
        What is unknown without the list, for the error's words.

    Raises
    ------
    CaptureError
        If the list is missing, empty, malformed, names a missing file or frame, or runs backwards; or if the first
        readable picture has another size than ``image_size``.
    FrameError
        If the video cannot be read.
    """
    files = list_files(folder)
    table = folder / LIST_NAME
    if LIST_NAME not in files:
        raise CaptureError(
            f"{table} is missing, so {needed} is unknown; write it with the header "
            f"{'frame,time_s,cart_mm' if timed else 'frame,cart_mm'} and one line per frame."
        )
    entries = _read_entries(table, lasers, timed)
    video = _find_video(folder, files)
    if video is not None and parse_whole(entries[0].name) is not None:
        return _open_video(table, video, entries, image_size)
    _check_names(table, folder, files, entries)
    sequence = FrameSequence(folder, tuple(entries), image_size)
    _check_first_size(sequence)
    return sequence


def list_files(folder: Path) -> frozenset[str]:
    """Names of the files directly in a folder.

    Raises
    ------
    CaptureError
        If the folder cannot be listed.
    """
    try:
        with os.scandir(folder) as listing:
            return frozenset(entry.name for entry in listing if entry.is_file())
    except OSError as error:
        raise CaptureError(f"{folder} cannot be listed: {error.strerror or error}.") from error


def list_pictures(folder: Path) -> tuple[Path, ...]:
    """Pictures (PNG, JPEG) directly in a folder, by name; none if there is no such folder.

    Raises
    ------
    CaptureError
        If the folder cannot be listed.
    """
    if not folder.is_dir():
        return ()
    return tuple(folder / name for name in sorted(list_files(folder)) if Path(name).suffix.lower() in PICTURE_SUFFIXES)


def plain_name(row: Row, column: str) -> str:
    """A cell that must be the name of a file beside the table: no folders, so that nothing outside is read."""
    name = row.text(column)
    if "/" in name or "\\" in name or "\0" in name or name in {".", ".."}:
        raise row.error(f"{column} must be a file name without folders, not {name[:60]!r}.")
    return name


def _read_entries(table: Path, lasers: int, timed: bool) -> Sequence[FrameEntry]:
    required = ("frame", "time_s", "cart_mm") if timed else ("frame", "cart_mm")
    optional = ("lasers",) if timed else ("time_s",)
    entries: list[FrameEntry] = []
    lines: dict[str, int] = {}
    for row in read_table(table, required, optional):
        name = plain_name(row, "frame")
        time_s = row.number("time_s") if row.cells.get("time_s") or timed else math.nan
        entry = FrameEntry(len(entries), name, time_s, row.number("cart_mm"), _lasers_on(row, lasers))
        if name in lines:
            raise row.error(f"frame {name} was already listed in line {lines[name]}; list each frame once.")
        if entries and time_s < entries[-1].time_s:
            before = entries[-1].time_s
            raise row.error(
                f"time_s runs backwards, from {before:g} s to {time_s:g} s; list frames as they were taken."
            )
        lines[name] = row.line
        entries.append(entry)
    if not entries:
        raise CaptureError(f"{table} lists no frames; write one line per frame below the header.")
    return entries


def _lasers_on(row: Row, lasers: int) -> frozenset[int] | None:
    if "lasers" not in row.cells:
        return None
    text = row.cells["lasers"]
    for digit in text:
        if not ("1" <= digit <= str(lasers)):
            known = "1" if lasers == 1 else "1, 2 or 12"
            raise row.error(
                f"lasers is {text[:20]!r}, but capture.json has {lasers}; write {known}, or nothing for none."
            )
    return frozenset(int(digit) for digit in text)


def _find_video(folder: Path, files: frozenset[str]) -> Path | None:
    videos = sorted(n for n in files if Path(n).stem == "video" and Path(n).suffix.lower() not in _NOT_VIDEO)
    if len(videos) > 1:
        raise CaptureError(f"{folder} holds several videos ({', '.join(videos[:4])}); keep one.")
    return folder / videos[0] if videos else None


def _open_video(table: Path, path: Path, entries: Sequence[FrameEntry], image_size: tuple[int, int]) -> FrameSequence:
    index = index_video(path)
    last = -1
    numbered = []
    for entry in entries:
        number = parse_whole(entry.name)
        if number is None:
            raise CaptureError(f"{table}: frame {entry.name!r} is not a frame number of {path.name}.")
        if number <= last:
            raise CaptureError(
                f"{table}: frame numbers run backwards, from {last} to {number}; list frames as they were taken."
            )
        if number >= index.count:
            raise CaptureError(
                f"{table}: frame {number} is past the end of {path.name}, which has {index.count} frames "
                f"(0 to {index.count - 1})."
            )
        last = number
        numbered.append(FrameEntry(entry.index, str(number), entry.time_s, entry.cart_mm, entry.lasers))
    if index.size != image_size:
        raise _wrong_size(path, index.size, image_size)
    return FrameSequence(path, tuple(numbered), image_size, index)


def _check_names(table: Path, folder: Path, files: frozenset[str], entries: Sequence[FrameEntry]) -> None:
    missing = [entry.name for entry in entries if entry.name not in files]
    if not missing:
        return
    more = f" ({len(missing)} of {len(entries)} frames are missing)" if len(missing) > 1 else ""
    if parse_whole(missing[0]) is not None:
        raise CaptureError(f"{table} names frame number {missing[0]}, but {folder} holds no video.*{more}.")
    raise CaptureError(f"{table} names {missing[0]}, which is not in {folder}{more}; copy it there or remove its line.")


def _check_first_size(sequence: FrameSequence) -> None:
    for entry in sequence.frames:
        try:
            size = picture_size(sequence.source / entry.name)
        except FrameError:
            continue
        if size != sequence.image_size:
            raise _wrong_size(sequence.source / entry.name, size, sequence.image_size)
        return


def _wrong_size(path: Path, size: tuple[int, int], expected: tuple[int, int]) -> CaptureError:
    return CaptureError(
        f"{path} is {size[0]} x {size[1]} px, but capture.json says image_size {expected[0]} x {expected[1]}; "
        f"correct image_size or use the right frames."
    )
