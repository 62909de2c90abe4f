"""What a pass hands to the recorder, described by shape: a device's own classes fit without knowing these."""

from enum import Enum
from typing import Protocol

from twinline.recording.stored import StoredEncoding


class DeliveredFrame(Protocol):
    """A frame as a camera delivers it; a camera's own class fits without knowing this one."""

    @property
    def sequence(self) -> int:
        """Number of the frame since the camera was opened."""
        ...

    @property
    def host_time_s(self) -> float:
        """When, in host time."""
        ...

    @property
    def exposure_s(self) -> float | None:
        """Length of the exposure; None if unknown."""
        ...

    @property
    def encoding(self) -> StoredEncoding:
        """How the data are to be read."""
        ...

    @property
    def data(self) -> bytes:
        """The picture as it was delivered."""
        ...

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        ...

    @property
    def dropped(self) -> int:
        """Frames known to be lost so far."""
        ...


class BoardSample(Protocol):
    """A line of telemetry; a board's own class fits without knowing this one."""

    @property
    def n(self) -> int:
        """Number of the line, or of the event, since the board's start."""
        ...

    @property
    def host_time_s(self) -> float:
        """When, in host time."""
        ...

    @property
    def board_time_s(self) -> float:
        """The same moment by the board's own clock."""
        ...

    @property
    def cart_mm(self) -> float:
        """Counted position of the cart."""
        ...

    @property
    def slide_mm(self) -> float:
        """Counted position of the slide."""
        ...

    @property
    def adc(self) -> int:
        """Distance sensor, as the board sent it."""
        ...

    @property
    def flags(self) -> int:
        """Lasers, movement, switches, latch."""
        ...

    @property
    def earlier_adc(self) -> tuple[int, ...]:
        """Samples between the line before and this one, oldest first."""
        ...


class BoardHappening(Protocol):
    """An event of the board; a board's own class fits without knowing this one."""

    @property
    def n(self) -> int:
        """Number of the line, or of the event, since the board's start."""
        ...

    @property
    def host_time_s(self) -> float:
        """When, in host time."""
        ...

    @property
    def board_time_s(self) -> float:
        """The same moment by the board's own clock."""
        ...

    @property
    def kind(self) -> Enum:
        """What happened; the value is recorded."""
        ...

    @property
    def cart_mm(self) -> float:
        """Counted position of the cart."""
        ...

    @property
    def slide_mm(self) -> float:
        """Counted position of the slide."""
        ...

    @property
    def a(self) -> int:
        """First detail, by kind."""
        ...

    @property
    def b(self) -> int:
        """Second detail, by kind."""
        ...


class LinkReport(Protocol):
    """The connection to the board came up or went down."""

    @property
    def host_time_s(self) -> float:
        """When, in host time."""
        ...

    @property
    def state(self) -> str:
        """``up``, ``down`` or ``closed``."""
        ...

    @property
    def reason(self) -> str:
        """One sentence, or empty."""
        ...
