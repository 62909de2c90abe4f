"""What a motion board is: two axes, lasers, one distance sensor, and the guarantees that go with them.

Lengths here are millimetres of the drives, steps times millimetres per step, from the place that homing made zero. What
the cart truly travels per commanded millimetre is for the rig to say.
"""

from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from twinline.devices.serial.protocol_gen import EventKind, Flag, Latch

Axis: TypeAlias = Literal["cart", "slide"]
AXES: tuple[Axis, ...] = ("cart", "slide")


@dataclass(frozen=True)
class Drive:
    """How an axis is driven, and how far it may go.

    Attributes
    ----------
    mm_per_step
        Travel per motor step; calibrated, so a setting.
    low_mm, high_mm
        Bounds of the travel; the board refuses to go beyond.
    max_speed_mm_s
        Highest speed.
    acceleration_mm_s2
        Acceleration and deceleration of all its movements.
    """

    mm_per_step: float
    low_mm: float
    high_mm: float
    max_speed_mm_s: float
    acceleration_mm_s2: float


DEFAULT_CART = Drive(mm_per_step=0.10053, low_mm=-100.0, high_mm=1000.0, max_speed_mm_s=100.0, acceleration_mm_s2=200.0)
DEFAULT_SLIDE = Drive(mm_per_step=0.005, low_mm=0.0, high_mm=200.0, max_speed_mm_s=40.0, acceleration_mm_s2=200.0)


@dataclass(frozen=True)
class BoardInfo:
    """What is at the other end.

    Attributes
    ----------
    name
        Which board, such as ``simulated`` or ``nucleo_f746zg``.
    firmware
        Version of its software.
    protocol_hash
        Digest of the protocol that it was built with; empty where it has another kind of protocol.
    boot_id
        Changes whenever the board starts again.
    drives
        Its axes, with the settings in use.
    lasers
        Numbers of the lasers that it switches.
    has_adc
        Whether it samples the distance sensor.
    max_telemetry_hz
        Highest telemetry rate; 0 where there is none.
    """

    name: str
    firmware: str
    protocol_hash: str
    boot_id: int
    drives: dict[Axis, Drive]
    lasers: frozenset[int]
    has_adc: bool
    max_telemetry_hz: int


@dataclass(frozen=True)
class BoardStatus:
    """One look at the board.

    Attributes
    ----------
    host_time_s
        When it was so, in host time.
    cart_mm, slide_mm
        Counted positions.
    adc
        Distance sensor, 0 to `protocol_gen.ADC_FULL_SCALE`: 16 per count of a 12-bit converter.
    flags
        Lasers, movement, switches, latch and knowledge of position, as in telemetry.
    latch
        Why the board is latched; a latched board lights nothing and moves nothing until `Board.reset`.
    """

    host_time_s: float
    cart_mm: float
    slide_mm: float
    adc: int
    flags: Flag
    latch: Latch

    @property
    def lasers(self) -> frozenset[int]:
        """Lasers that are switched on."""
        return lasers_of(self.flags)


@dataclass(frozen=True)
class Telemetry:
    """A regular sample; one may be lost, which a jump of ``n`` shows.

    Attributes
    ----------
    n
        Counts up by one from line to line, and begins anew when the board starts again.
    host_time_s
        When it was sampled, in host time.
    board_time_s
        The same by the board's own clock, since its start.
    cart_mm, slide_mm
        Counted positions, with the fraction of the present step.
    adc
        Distance sensor, 0 to `protocol_gen.ADC_FULL_SCALE`.
    flags
        Lasers, movement, switches, latch and knowledge of position.
    earlier_adc
        Further samples that came with the line, oldest first, equally spaced between the line before and this one.
    """

    n: int
    host_time_s: float
    board_time_s: float
    cart_mm: float
    slide_mm: float
    adc: int
    flags: Flag
    earlier_adc: tuple[int, ...] = ()

    @property
    def lasers(self) -> frozenset[int]:
        """Lasers that are switched on."""
        return lasers_of(self.flags)


@dataclass(frozen=True)
class BoardEvent:
    """Something that happened; none is lost and each comes once, in order.

    Attributes
    ----------
    n
        Number since the board's start.
    host_time_s, board_time_s
        When it happened, in host time and by the board's own clock.
    kind
        What happened; PROTOCOL.md says what ``a`` and ``b`` mean for each.
    cart_mm, slide_mm
        Counted positions at that moment.
    a, b
        Details.
    """

    n: int
    host_time_s: float
    board_time_s: float
    kind: EventKind
    cart_mm: float
    slide_mm: float
    a: int
    b: int


@dataclass(frozen=True)
class LinkChange:
    """The connection came up or went down.

    Attributes
    ----------
    host_time_s
        When.
    state
        ``up``: commands are possible. ``down``: it is being tried again. ``closed``: it is over.
    reason
        One sentence; empty when it came up as expected.
    """

    host_time_s: float
    state: Literal["up", "down", "closed"]
    reason: str


BoardMessage: TypeAlias = Telemetry | BoardEvent | LinkChange


@dataclass(frozen=True)
class LaserPass:
    """A movement of the cart at constant speed with light.

    Attributes
    ----------
    from_mm, to_mm
        Constant speed is reached before the first and kept beyond the second; the board adds the run-up itself.
    speed_mm_s
        Speed, positive.
    phases
        Sets of lasers that take turns, 1 to 4 of them; one for steady light, an empty set for a background frame.
    phase_s
        Length of each turn; without meaning for steady light.
    """

    from_mm: float
    to_mm: float
    speed_mm_s: float
    phases: tuple[frozenset[int], ...] = (frozenset({1, 2}),)
    phase_s: float = 0.0


@dataclass(frozen=True)
class TofRaster:
    """A boustrophedon of the distance sensor: the slide sweeps, the cart advances, the slide sweeps back.

    Attributes
    ----------
    cart_from_mm, cart_to_mm
        First row, and the place that no row is beyond.
    cart_advance_mm
        Distance of rows, positive.
    slide_from_mm, slide_to_mm
        Ends of the first sweep; every second one goes the other way.
    slide_speed_mm_s
        Speed of the sweeps, positive.
    """

    cart_from_mm: float
    cart_to_mm: float
    cart_advance_mm: float
    slide_from_mm: float
    slide_to_mm: float
    slide_speed_mm_s: float


class Board(Protocol):
    """A motion board, real, simulated or replayed.

    After any error, after `close`, and when a waiting caller is cancelled, the lasers are off. All methods but `open`
    raise `LinkError` while there is no connection, at once and not after a time-out, `DeviceTimeoutError` when the
    board does not answer, and `RefusedError` with the board's reason as its code when it refuses.
    """

    async def open(self) -> BoardInfo:
        """Connect, agree on the protocol, stop whatever moves or shines, and keep the connection up from then on.

        Raises
        ------
        LinkError
            There is no connection to be had; it is not tried again.
        DeviceError
            Something answers that is not a board of this protocol.
        """
        ...

    async def close(self) -> None:
        """Switch the lasers off, stop the axes and disconnect; never raises, and may be called again."""
        ...

    async def status(self) -> BoardStatus:
        """Ask the board how it is."""
        ...

    async def lasers(self, on: frozenset[int]) -> None:
        """Switch lasers: those named on, the others off.

        Raises
        ------
        RefusedError
            ``latched``, ``no-heartbeat``, or ``busy`` while a pass switches them itself.
        """
        ...

    async def move(self, axis: Axis, to_mm: float, speed_mm_s: float) -> None:
        """Move an axis to the step nearest to a place; returns when the board reports the end.

        Cancelling the caller brakes the axes.

        Raises
        ------
        RefusedError
            ``latched``, ``busy``, ``out-of-range``, ``limit-active``.
        MotionError
            The movement ended early: stopped, limit, emergency stop, lost heartbeat, board reset.
        """
        ...

    async def home(self, axis: Axis) -> None:
        """Find an axis's zero: the slide drives to its low limit switch, the cart takes its present place.

        Raises
        ------
        MotionError
            Also ``home-failed``: the switch was never reached.
        """
        ...

    async def laser_pass(self, plan: LaserPass) -> None:
        """Drive the cart along a laser pass; returns when it stands again and the lasers are off.

        The events ``scan-start`` and ``scan-end`` tell when the cart passed both ends of the plan.

        Raises
        ------
        RefusedError
            As for `move`, and ``not-homed``.
        MotionError
            As for `move`.
        """
        ...

    async def raster(self, plan: TofRaster) -> None:
        """Drive both axes along a raster; the events ``row-start`` and ``row-end`` frame its rows.

        Raises
        ------
        RefusedError
            As for `laser_pass`.
        MotionError
            As for `move`.
        """
        ...

    async def stop(self) -> None:
        """Brake both axes, end any pass and switch the lasers off; goes ahead of waiting commands."""
        ...

    async def reset(self) -> None:
        """Release the latch of an emergency stop, a lost heartbeat or a wiring fault.

        Raises
        ------
        RefusedError
            ``e-stop-active``: the button is still pressed.
        """
        ...

    async def telemetry(self, rate_hz: int, *, samples: int = 1) -> None:
        """Set the telemetry's rate, 0 for none, and 1 or 4 samples of the distance sensor in each line."""
        ...

    def subscribe(self) -> AsyncIterator[BoardMessage]:
        """Everything that comes from the call on; ends when the board is closed. Nothing is thrown away."""
        ...


def lasers_of(flags: Flag) -> frozenset[int]:
    """Numbers of the lasers whose flags are set."""
    return frozenset(number for number, flag in ((1, Flag.LASER_1), (2, Flag.LASER_2)) if flag in flags)
