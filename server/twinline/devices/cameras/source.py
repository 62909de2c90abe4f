"""What a kind of camera has to bring along: everything that blocks, one frame at a time.

The thread of a `twinline.devices.cameras.threaded.ThreadedCamera` calls it, and does the rest: reconnection, time
stamps, counting, the queue.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from twinline.devices.camera import CameraInfo, Control


@dataclass(frozen=True, slots=True)
class Picture:
    """A frame as it came in.

    Attributes
    ----------
    data
        The picture in the encoding that connecting announced.
    arrival_s
        Host time at which it came.
    camera_time_s
        Time on the camera's own clock, from any zero; None if it tells none.
    exposure_s
        Length of its exposure; None if the camera does not tell.
    """

    data: bytes
    arrival_s: float
    camera_time_s: float | None = None
    exposure_s: float | None = None


@dataclass(frozen=True, slots=True)
class Lost:
    """A frame that was made and cannot be used.

    Attributes
    ----------
    reason
        Why, as the rest of a sentence.
    count
        How many frames.
    """

    reason: str
    count: int = 1


class FrameSource(Protocol):
    """One connection at a time to one camera. All but ``interrupt`` and the controls run in the camera's thread."""

    def connect(self) -> CameraInfo:
        """Connect, and wait for whatever tells the size of the frames.

        Raises
        ------
        CameraError
            If that is not possible, with cause and next step.
        """
        ...

    def read(self) -> Picture | Lost | None:
        """Wait for the next frame; None after the last one.

        Raises
        ------
        CameraError
            If the connection is lost, or nothing comes for too long.
        """
        ...

    def interrupt(self) -> None:
        """Make a waiting ``connect`` or ``read`` fail soon, if there is a way; called from another thread, any time."""
        ...

    def disconnect(self) -> None:
        """Let go of everything; also after a failure, and more than once."""
        ...

    def controls(self) -> Mapping[str, Control]:
        """What can be set; called from another thread while connected."""
        ...

    def set_control(self, name: str, value: float) -> None:
        """Set a control whose name and limits were checked; called from another thread while connected.

        Raises
        ------
        CameraError
            If the camera refuses.
        """
        ...


class NoControls:
    """Part of the sources on which nothing can be set."""

    def controls(self) -> Mapping[str, Control]:
        """Nothing."""
        return {}

    def set_control(self, name: str, value: float) -> None:
        """Never called, since there is no name that passes."""
        raise AssertionError(f"{name} = {value:g} on a camera without controls")
