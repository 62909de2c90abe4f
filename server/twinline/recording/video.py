"""Frame-exact reading of video files.

Players may land a few frames beside the frame they were asked for. For a scanner that is a wrong cart position, so
every frame is identified by its presentation time, which an index of the whole file lists in order. The index comes
from the container alone (nothing is decoded), at the speed of reading the file.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twinline.arrays import ByteArray, IntArray
from twinline.errors import FrameError

_KNOWN_STARTS = ((0, b"RIFF"), (4, b"ftyp"), (4, b"moov"), (4, b"mdat"), (4, b"wide"), (4, b"free"), (4, b"skip"),
                 (0, b"\x1a\x45\xdf\xa3"), (0, b"\x00\x00\x01\xba"), (0, b"\x00\x00\x01\xb3"), (0, b"\x47"),
                 (0, b"\xff\xd8"))  # fmt: skip
# Decoding this many frames that nobody asked for costs about as much as a seek to the key frame before the target.
_SEEK_GAP = 48
_SEEK_STEPS_BACK = (0, 8, 64, 512)
# Failures in a row after which the decoder is taken to have reached the end; one failure is one damaged frame.
_MAX_FAILURES = 250


@dataclass(frozen=True, eq=False)
class VideoIndex:
    """What is known of a video before anything is decoded.

    Attributes
    ----------
    size : (int, int)
        Width and height in pixels.
    count
        Frames in the file.
    rate_hz
        Frames per second that the file states.
    times_us : (count,) int64 array or None
        Presentation time of each frame, ascending; None if the file gives no usable times, in which case frames are
        counted from the start.
    keys : (k,) int64 array
        Numbers of the frames that can be decoded without those before them.
    """

    size: tuple[int, int]
    count: int
    rate_hz: float
    times_us: IntArray | None
    keys: IntArray


def index_video(path: Path) -> VideoIndex:
    """Read the index of a video.

    Raises
    ------
    FrameError
        If the file is missing, no video, or holds no frame that can be decoded.
    """
    capture = _open(path)
    try:
        decodes = capture.grab()
        first_us = _time_us(capture)
        size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
    finally:
        capture.release()
    if not decodes or min(size) < 1:
        raise FrameError(f"{path} is a video without a frame that can be decoded; record or convert it again.")
    times, keys = _scan(path)
    # Some files give their packets other times than their frames, or show less than they hold (edit lists).
    usable = len(times) > 0 and int(times[0]) == first_us and bool((np.diff(times) > 0).all()) and rate_hz > 0
    if not usable:
        return VideoIndex(size, _count_by_decoding(path), rate_hz, None, np.zeros(1, np.int64))
    return VideoIndex(size, len(times), rate_hz, times, np.flatnonzero(keys).astype(np.int64))


def read_video(path: Path, index: VideoIndex, numbers: Sequence[int]) -> Iterator[tuple[int, ByteArray | None]]:
    """Decode the frames with the given numbers.

    Parameters
    ----------
    numbers
        0-based frame numbers, strictly ascending.

    Yields
    ------
    (int, (h, w, 3) uint8 array or None)
        The number and the picture in blue, green, red; None for a frame that the decoder could not deliver.

    Raises
    ------
    FrameError
        If the video cannot be opened.
    """
    capture = _open(path)
    try:
        here = -1
        for number in numbers:
            if number >= index.count:
                yield number, None
                continue
            if here < number:
                here = _advance(path, capture, index, here, number)
            if here != number:
                yield number, None
                continue
            delivered, image = capture.retrieve()
            yield number, np.asarray(image, dtype=np.uint8) if delivered else None
    finally:
        capture.release()


def _open(path: Path) -> cv2.VideoCapture:
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror or error}.") from error
    # Playlists are text that makes the decoder open other files and addresses; only real containers go there.
    if not any(head[at : at + len(start)] == start for at, start in _KNOWN_STARTS):
        raise FrameError(f"{path} is not a video that can be read; use AVI, MP4, MOV, Matroska, WebM or MPEG.")
    capture = cv2.VideoCapture()
    # The decoder's own threads would compete with the worker processes; rotation hints belong to players.
    capture.open(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    if not capture.isOpened():
        raise FrameError(f"{path} is not a video that can be read: it is damaged or its coding is unknown.")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture


def _time_us(capture: cv2.VideoCapture) -> int:
    return round(1000.0 * capture.get(cv2.CAP_PROP_POS_MSEC))


def _scan(path: Path) -> tuple[IntArray, IntArray]:
    """Presentation times in microseconds, ascending, and whether each is a key frame; from packets, undecoded."""
    capture = _open(path)
    try:
        times: list[int] = []
        keys: list[int] = []
        if capture.set(cv2.CAP_PROP_FORMAT, -1):
            while capture.grab():
                times.append(_time_us(capture))
                keys.append(int(capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME)))
    finally:
        capture.release()
    order = np.argsort(np.array(times, np.int64), kind="stable")
    return np.array(times, np.int64)[order], np.array(keys, np.int64)[order]


def _count_by_decoding(path: Path) -> int:
    capture = _open(path)
    try:
        count = failures = 0
        while failures < _MAX_FAILURES:
            if capture.grab():
                # A failure inside the video is a frame that was there; those at the end are the end.
                count += failures + 1
                failures = 0
            else:
                failures += 1
        return count
    finally:
        capture.release()


def _advance(path: Path, capture: cv2.VideoCapture, index: VideoIndex, here: int, number: int) -> int:
    """Grab until ``number`` or, where it cannot be decoded, the first frame after it; returns the number grabbed."""
    times_us = index.times_us
    if times_us is not None and number - here > _SEEK_GAP:
        here = _seek(path, capture, times_us, index.rate_hz, number)
    failures = 0
    while here < number and failures < _MAX_FAILURES:
        if capture.grab():
            here = here + failures + 1 if times_us is None else _number_of(capture, times_us, here + 1)
            failures = 0
        else:
            failures += 1
    return here if here >= number else index.count


def _seek(path: Path, capture: cv2.VideoCapture, times_us: IntArray, rate_hz: float, number: int) -> int:
    """Grab a frame at or before ``number``; returns its number, or -1 after going back to the start."""
    for back in _SEEK_STEPS_BACK:
        target = max(number - back, 0)
        # The library seeks by time through the stated rate, which is the frame's number only at a constant rate.
        capture.set(cv2.CAP_PROP_POS_FRAMES, round(float(times_us[target]) * 1e-6 * rate_hz))
        if capture.grab():
            here = _number_of(capture, times_us, -1)
            if 0 <= here <= number:
                return here
    capture.release()
    capture.open(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return -1


def _number_of(capture: cv2.VideoCapture, times_us: IntArray, otherwise: int) -> int:
    """Number of the frame just grabbed by its presentation time; ``otherwise`` if no frame has that time."""
    time_us = _time_us(capture)
    at = int(np.searchsorted(times_us, time_us))
    return at if at < len(times_us) and int(times_us[at]) == time_us else otherwise
