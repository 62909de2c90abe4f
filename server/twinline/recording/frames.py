"""The frames of a pass: a list that is cheap to hand around, and pictures read when they are asked for."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from twinline.arrays import ByteArray
from twinline.errors import CaptureError, FrameError
from twinline.recording.images import PictureFile, picture_size, read_image
from twinline.recording.stored import StoredPicture
from twinline.recording.video import VideoIndex, read_video


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """One line of the frame list.

    Attributes
    ----------
    index
        Place in the pass, from 0; kept when frames are selected.
    name
        File name, or number of the frame in the video.
    time_s
        Time of exposure in seconds; NaN where the list gives none.
    cart_mm
        Commanded position of the cart.
    lasers
        Numbers of the lasers that were on; None means all.
    stored
        Where the picture lies, if in a recording; None for a file of its own or a frame of a video.
    """

    index: int
    name: str
    time_s: float
    cart_mm: float
    lasers: frozenset[int] | None = None
    stored: StoredPicture | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame as read.

    Attributes
    ----------
    image : (h, w) or (h, w, 3) uint8 array or None
        Grey, or blue, green, red; None if the frame cannot be used.
    problem
        Why there is no image.
    """

    entry: FrameEntry
    image: ByteArray | None
    problem: str | None = None


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """The frames of one pass, in a folder of pictures, in a video, or in recordings.

    Holds no picture and no open file: it can be sent to another process, which opens what it needs.

    Attributes
    ----------
    source
        The folder, the video file, or the recording (of several, the folder that they are in).
    image_size : (int, int)
        Width and height that every frame must have, in pixels.
    video
        Index of the video; None for pictures.
    share_places
        Places at which a worker's share best begins, for pictures that were made from a video; None for others.
    """

    source: Path
    frames: tuple[FrameEntry, ...]
    image_size: tuple[int, int]
    video: VideoIndex | None = None
    share_places: tuple[int, ...] | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def select(self, indices: Sequence[int]) -> "FrameSequence":
        """The frames at the given places, as a sequence of their own; what a worker needs for its share."""
        return replace(self, frames=tuple(self.frames[i] for i in indices))

    def chunks(self, size: int) -> list[range]:
        """Divide the sequence into shares of about ``size`` frames for workers.

        In a video a share starts at a key frame wherever one is near, since decoding can only start there.
        """
        if size < 1:
            raise ValueError("a chunk needs at least one frame")
        places = self.places_to_share()
        if places is None or len(places) < 2:
            step = size if places is None else max(size, -(-len(self) // 16))
            return [range(i, min(i + step, len(self))) for i in range(0, len(self), step)]
        starts = [0]
        for place in places:
            if place - starts[-1] >= size and place < len(self):
                starts.append(place)
        return [range(a, b) for a, b in zip(starts, [*starts[1:], len(self)], strict=True)]

    def places_to_share(self) -> tuple[int, ...] | None:
        """Places at which a share best begins; None if all are alike."""
        if self.video is None:
            return self.share_places
        numbers = np.array([int(entry.name) for entry in self.frames])
        return tuple(np.searchsorted(numbers, self.video.keys).tolist())

    def picture(self, entry: FrameEntry) -> PictureFile:
        """Where the picture of a frame is; not for the frames of a video."""
        return self.source / entry.name if entry.stored is None else entry.stored

    def read(self, indices: Sequence[int] | None = None) -> Iterator[Frame]:
        """Read frames, one at a time, so that memory does not grow with the number of frames.

        Parameters
        ----------
        indices
            Places in this sequence, strictly ascending; all frames where not given.

        Yields
        ------
        Frame
            One per index, in order. A frame that is broken or has another size carries the reason and no image.

        Raises
        ------
        FrameError
            If the video cannot be opened.
        """
        wanted = range(len(self)) if indices is None else indices
        if any(b <= a for a, b in pairwise(wanted)):
            raise ValueError("frames are read in strictly ascending order")
        entries = [self.frames[i] for i in wanted]
        if self.video is None:
            return (self._read_picture(entry) for entry in entries)
        return self._read_video(self.video, entries)

    def check_sizes(self) -> None:
        """Make sure that every picture has the expected size, from the files' headers alone.

        Files whose header cannot be read are left to `read`, which counts them as broken.

        Raises
        ------
        CaptureError
            If a picture has another size; names the first one and both sizes.
        """
        if self.video is not None:
            return
        for entry in self.frames:
            try:
                size = self._size(entry)
            except FrameError:
                continue
            if size not in {self.image_size, (0, 0)}:
                raise CaptureError(
                    f"The frames have mixed sizes: {self.picture(entry)} is {_pixels(size)}, where "
                    f"{_pixels(self.image_size)} is expected; use frames of one size."
                )

    def _size(self, entry: FrameEntry) -> tuple[int, int]:
        """Size of a picture as far as it is known without reading it; zeros if it is not."""
        return picture_size(self.source / entry.name) if entry.stored is None else entry.stored.at.size

    def _read_picture(self, entry: FrameEntry) -> Frame:
        try:
            return Frame(entry, read_image(self.picture(entry), self.image_size))
        except FrameError as error:
            return Frame(entry, None, error.detail.rstrip("."))

    def _read_video(self, video: VideoIndex, entries: Sequence[FrameEntry]) -> Iterator[Frame]:
        numbers = [int(entry.name) for entry in entries]
        for entry, (number, image) in zip(entries, read_video(self.source, video, numbers), strict=True):
            if image is None:
                yield Frame(entry, None, f"frame {number} of {self.source} cannot be decoded")
            elif (image.shape[1], image.shape[0]) != self.image_size:
                size = _pixels((image.shape[1], image.shape[0]))
                yield Frame(entry, None, f"frame {number} of {self.source} is {size}, not {_pixels(self.image_size)}")
            else:
                yield Frame(entry, image)


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]} px"
