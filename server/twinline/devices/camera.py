"""What every camera can do, whether real, simulated or replayed.

All cameras pass the same tests (tests/contracts/test_camera.py). Times are *host time*: seconds of
``asyncio.get_running_loop().time()``, on which the board's telemetry lives too. A frame carries the time of the middle
of its exposure, since that is the moment whose cart position belongs to it.

Losses are counted and never hidden: every frame that was made takes a number, ``sequence``, and so does a frame that
was lost where its loss is known (it arrived broken, or the reader was too slow). Between two frames of one iteration
``sequence`` therefore grows by 1 plus the growth of ``dropped``.
"""

from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Protocol, TypeAlias

Encoding: TypeAlias = Literal["jpeg", "gray8", "bgr8"]
"""How the bytes of a frame are to be read: a JPEG file as the camera made it, or rows of pixels without padding, one
byte (grey) or three (blue, green, red) a pixel."""


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """What is known of an open camera; valid until it is closed.

    Attributes
    ----------
    image_size : (int, int)
        Width and height of every frame in pixels.
    rate_hz
        Frames per second that the camera states; None if it states none.
    encoding
        Encoding of every frame.
    name
        What the camera calls itself, or its address without the password.
    live
        Whether frames are made whether or not anybody reads them, so that a slow reader loses some. Where not (a
        folder, a video taken frame by frame), the camera waits for the reader, and nothing is dropped.
    ends
        Whether the frames come to an end.
    """

    image_size: tuple[int, int]
    rate_hz: float | None
    encoding: Encoding
    name: str = ""
    live: bool = True
    ends: bool = False


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """A frame as the camera delivered it.

    Attributes
    ----------
    sequence
        Number of the frame since the camera was opened; strictly ascending, goes on over a lost connection.
    host_time_s
        Host time of the middle of the exposure; strictly ascending.
    exposure_s
        Length of the exposure; None if not known.
    data
        One picture in ``encoding``. For pixels ``width * height`` or ``3 * width * height`` bytes, row by row.
    image_size : (int, int)
        Width and height in pixels.
    dropped
        Frames known to be lost so far, in all iterations since the camera was opened.
    """

    sequence: int
    host_time_s: float
    exposure_s: float | None
    encoding: Encoding
    data: bytes
    image_size: tuple[int, int]
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class Control:
    """Something that can be set on a camera.

    Attributes
    ----------
    low, high
        Limits of the value, both allowed.
    value
        Present value.
    unit
        Unit of all three; empty if the camera's own numbers have none.
    """

    low: float
    high: float
    value: float
    unit: str


class CameraState(StrEnum):
    """Where a camera stands between being closed and delivering frames."""

    CLOSED = "closed"
    CONNECTING = "connecting"
    STREAMING = "streaming"
    WAITING = "waiting"
    """The connection was lost; it is tried again after a pause."""
    ENDED = "ended"
    """No frame will come any more: the end of a file, or an error that trying again does not mend."""


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """How a camera is doing.

    Attributes
    ----------
    state
        Present state.
    detail
        What is wrong, in one sentence; None if nothing is.
    delivered
        Frames handed to readers since the camera was opened.
    dropped
        Frames known to be lost since the camera was opened.
    reconnections
        How often the connection was made again since the camera was opened.
    """

    state: CameraState
    detail: str | None = None
    delivered: int = 0
    dropped: int = 0
    reconnections: int = 0


class Camera(Protocol):
    """A source of frames. All methods are called on one event loop, and none keeps it waiting."""

    async def open(self) -> CameraInfo:
        """Connect, and learn what the camera sends.

        One attempt is made; afterwards a lost connection is made again without being asked. A camera that is open
        already answers what it answered before. One that was closed can be opened again and counts from 0. When
        cancelled, nothing stays open.

        Raises
        ------
        DeviceError
            If there is no camera, or it refuses, or sends nothing that can be used.
        """
        ...

    def frames(self) -> AsyncIterator[CameraFrame]:
        """Frames from now on, in the order in which they were made.

        A live camera keeps a few for a reader that is busy, then drops the oldest and counts them. The iteration goes
        on over a lost connection (see `status`). It ends when the camera is closed, also while waiting for a frame, or
        has no more. One iteration at a time: it is over when its iterator is forgotten or the task that began it has
        ended, so ``break`` is enough. Frames made while nobody iterates are not delivered and not counted as dropped;
        a camera whose frames come to an end goes on where the last iteration stopped.

        Raises
        ------
        TransitionError
            At once, if the camera is not open, or somebody else iterates.
        DeviceError
            While iterating, if the camera failed in a way that connecting again does not mend.
        """
        ...

    async def controls(self) -> Mapping[str, Control]:
        """What can be set, by name: ``exposure`` (ms), ``gain``, ``focus`` and others; empty if nothing can.

        Raises
        ------
        TransitionError
            If the camera is not open.
        """
        ...

    async def set_control(self, name: str, value: float) -> None:
        """Set a control. The camera may round the value to its own steps.

        Raises
        ------
        ControlError
            If there is no such control on this camera, or the value is outside its limits; nothing was changed.
        DeviceError
            If the camera refused.
        TransitionError
            If the camera is not open.
        """
        ...

    def status(self) -> CameraStatus:
        """How the camera is doing; possible in every state."""
        ...

    async def close(self) -> None:
        """Stop and let go of everything, also while connecting; closing twice does nothing."""
        ...
