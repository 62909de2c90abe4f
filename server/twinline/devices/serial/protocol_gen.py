"""The serial protocol's vocabulary, generated from firmware/protocol/protocol.toml; do not edit."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag, StrEnum
from types import MappingProxyType

PROTOCOL_NAME = "twinline-board"
PROTOCOL_VERSION = 1
PROTOCOL_HASH = "63BD1270"
"""Covers everything but the texts."""

LINE_BYTES = 120
"""Longest line without its newline; a longer one is a bad line. Unit: byte."""
SEQUENCE_NUMBERS = 65536
"""Requests are numbered modulo this."""
ANSWERS_KEPT = 8
"""A command that comes again within so many others gets its old answer and does not run again."""
EVENTS_KEPT = 32
"""Events that EVENTS can send again."""
HEARTBEAT_DEFAULT_MS = 500
"""Deadline that the host arms unless it is told another. Unit: ms."""
TELEMETRY_MAX_HZ = 200
"""What 115200 baud carry with 20 % to spare. Unit: Hz."""
POSITION_FRACTION = 16
"""Telemetry tells positions in this fraction of a step; events and STATUS in whole steps. Unit: 1/step."""
ADC_FULL_SCALE = 65520
"""Highest reading: the mean of a 12-bit converter times 16."""
ADC_CLIP_LOW = 2736
"""Readings below this are out of the distance sensor's range: -4.2 V before the front end."""
ADC_CLIP_HIGH = 62784
"""Readings above this are out of the distance sensor's range: +4.2 V before the front end."""
ADC_BROKEN_LOW = 480
"""Readings below this are none that the distance sensor can cause."""
ADC_BROKEN_HIGH = 65040
"""Readings above this are none that the distance sensor can cause."""
TIMER_HZ = 12000000
"""Clock in whole ticks of which every step is timed. Unit: Hz."""
HOME_CLEAR_STEPS = 200
"""Distance from the switch at which homing the slide ends. Unit: step."""
HOME_SLOW_MSTEPS_S = 800000
"""Rate at which the switch's edge is taken as zero. Unit: 1/1000 step/s."""
HOME_TRAVEL_STEPS = 100000
"""Homing that has not met the switch after so many steps has failed. Unit: step."""
DRIFT_STEPS = 3
"""A limit switch that closes further than this from where it first did since homing means lost steps. Unit: step."""
WATCHDOG_MS = 100
"""A board that hangs starts again after this. Unit: ms."""


class Verb(StrEnum):
    """What the host may ask for."""

    HELLO = "HELLO"
    """Begins a session: lasers off, axes braked, no heartbeat, old answers forgotten."""
    STATUS = "STATUS"
    """How the board is."""
    PING = "PING"
    """Tells the board's time."""
    HB = "HB"
    """Heartbeat: arms or renews the deadline. 0 disarms and switches the lasers off."""
    LASER = "LASER"
    """Switches the lasers. 0 is always possible and also ends the light of a running SCAN."""
    SPEED = "SPEED"
    """Sets rate and acceleration of the movements of an axis that begin from now on."""
    BOUNDS = "BOUNDS"
    """Sets the range that an axis may travel, unbounded at first; it holds where the position is known."""
    MOVE = "MOVE"
    """Moves an axis to a position. The event motion-end tells how it ended."""
    STOP = "STOP"
    """Brakes both axes, ends HOME, SCAN and RASTER, and switches the lasers off."""
    HOME = "HOME"
    """Finds zero. The slide seeks its low limit switch; the cart, which has none, takes its present place."""
    SCAN = "SCAN"
    """Laser pass: runs up, crosses the range at constant rate with light, brakes. Needs LASER's conditions too."""
    RASTER = "RASTER"
    """ToF pass: the slide sweeps, the cart advances, the slide sweeps back, until a row would be beyond the range."""
    TELEM = "TELEM"
    """Sets the telemetry's rate."""
    EVENTS = "EVENTS"
    """Sends kept events again, after its answer."""
    RESET = "RESET"
    """Releases the latch."""


class ErrorCode(StrEnum):
    """Why the board refuses."""

    UNKNOWN_VERB = "unknown-verb"
    """The board does not know the verb."""
    BAD_ARGUMENTS = "bad-arguments"
    """Too few or too many arguments, or one that is not a number."""
    OUT_OF_RANGE = "out-of-range"
    """An argument is outside its limits, or the movement would leave the axis's bounds."""
    NO_SESSION = "no-session"
    """The board has started again since the last HELLO."""
    LATCHED = "latched"
    """The board is latched; RESET releases it."""
    NO_HEARTBEAT = "no-heartbeat"
    """No heartbeat is armed, so no laser may shine."""
    BUSY = "busy"
    """The axis moves, or a pass is running; STOP it or wait for its end."""
    LIMIT_ACTIVE = "limit-active"
    """The movement leads into a limit switch that is pressed."""
    NOT_HOMED = "not-homed"
    """The pass needs a known position: SCAN that of the cart, RASTER of both axes; HOME them."""
    E_STOP_ACTIVE = "e-stop-active"
    """The emergency stop is still pressed."""


class EventKind(StrEnum):
    """What the board tells of its own accord."""

    BOOT = "boot"
    """The board has started."""
    MOTION_END = "motion-end"
    """A movement, HOME, SCAN or RASTER has ended."""
    SCAN_START = "scan-start"
    """The cart crosses the beginning of the range; the first phase of light begins now."""
    SCAN_END = "scan-end"
    """The cart crosses the end of the range; the light goes off."""
    ROW_START = "row-start"
    """A sweep of the slide begins."""
    ROW_END = "row-end"
    """The sweep has ended."""
    LASERS = "lasers"
    """The lasers were switched; the phases of a SCAN are not told one by one."""
    LIMIT = "limit"
    """A limit switch of the slide changed."""
    DRIFT = "drift"
    """A limit switch closed elsewhere than before: steps were lost."""
    E_STOP = "e-stop"
    """The emergency stop changed."""
    LATCH = "latch"
    """The board has latched (lasers off, axes stopped), or was released (0)."""


class Flag(IntFlag):
    """State of the board, as bits."""

    LASER_1 = 1 << 0
    """Laser 1 is switched on."""
    LASER_2 = 1 << 1
    """Laser 2 is switched on."""
    CART_MOVING = 1 << 2
    """The cart moves."""
    SLIDE_MOVING = 1 << 3
    """The slide moves."""
    RUNNING = 1 << 4
    """HOME, SCAN or RASTER is running."""
    LIMIT_LOW = 1 << 5
    """The slide's low limit switch is pressed."""
    LIMIT_HIGH = 1 << 6
    """The slide's high limit switch is pressed."""
    E_STOP = 1 << 7
    """The emergency stop is pressed."""
    LATCHED = 1 << 8
    """The board is latched."""
    HEARTBEAT = 1 << 9
    """A heartbeat is armed."""
    CART_KNOWN = 1 << 10
    """The cart's position is known: homed, and not aborted since."""
    SLIDE_KNOWN = 1 << 11
    """The slide's position is known: homed, and not aborted since."""
    ADC_CLIPPED = 1 << 12
    """The distance sensor's voltage is outside what its front end passes on, so the distance is out of range."""
    ADC_BROKEN = 1 << 13
    """The distance sensor's wire is broken."""


class AxisNumber(IntEnum):
    """Axes."""

    CART = 0
    """The cart."""
    SLIDE = 1
    """The slide."""


class MotionEnd(IntEnum):
    """How a movement ended."""

    DONE = 0
    """Complete."""
    STOPPED = 1
    """Braked by STOP or HELLO."""
    LIMIT = 2
    """Braked at a limit switch."""
    E_STOP = 3
    """Cut off by the emergency stop."""
    HEARTBEAT = 4
    """Braked because no heartbeat came."""
    WIRING = 5
    """Cut off because both limit switches were pressed."""
    HOME_FAILED = 6
    """The limit switch was never met."""


class Latch(IntEnum):
    """Why the board is latched."""

    NONE = 0
    """It is not."""
    E_STOP = 1
    """Emergency stop."""
    HEARTBEAT = 2
    """No heartbeat came in time."""
    WIRING = 3
    """Both limit switches at once."""


class ResetCause(IntEnum):
    """Why the board started."""

    POWER = 0
    """Power came."""
    BUTTON = 1
    """Reset button."""
    WATCHDOG = 2
    """The program hung."""
    SOFTWARE = 3
    """The program asked for it."""


class BadLine(IntEnum):
    """Why a line was not taken, as a word."""

    FORM = 0
    """Not a line of this protocol."""
    LONG = 1
    """Longer than line_bytes."""
    CRC = 2
    """The checksum is wrong."""


@dataclass(frozen=True)
class Argument:
    """An argument of a verb: a decimal integer within limits.

    Attributes
    ----------
    name
        What it is.
    unit
        Its unit; empty for a plain number.
    low, high
        Lowest and highest permitted value.
    """

    name: str
    unit: str
    low: int
    high: int


@dataclass(frozen=True)
class VerbSpecification:
    """What belongs to a verb.

    Attributes
    ----------
    session
        Whether HELLO must have come before.
    again
        Whether it runs each time it comes, rather than once for each sequence number.
    arguments
        What follows the verb.
    words
        For each field of a positive answer its name and whether it is a word rather than an integer.
    """

    session: bool
    again: bool
    arguments: tuple[Argument, ...]
    words: tuple[tuple[str, bool], ...]


VERBS: Mapping[Verb, VerbSpecification] = MappingProxyType(
    {
        Verb.HELLO: VerbSpecification(
            session=False,
            again=True,
            arguments=(),
            words=(
                ("version", False),
                ("hash", True),
                ("boot_id", False),
                ("next_event", False),
                ("firmware", True),
                ("board", True),
            ),
        ),
        Verb.STATUS: VerbSpecification(
            session=False,
            again=True,
            arguments=(),
            words=(
                ("t_us", False),
                ("cart", False),
                ("slide", False),
                ("adc", False),
                ("flags", False),
                ("latch", False),
                ("motion", False),
                ("boot_id", False),
                ("next_event", False),
            ),
        ),
        Verb.PING: VerbSpecification(
            session=False,
            again=True,
            arguments=(),
            words=(("t_us", False),),
        ),
        Verb.HB: VerbSpecification(
            session=True,
            again=True,
            arguments=(Argument("deadline", "ms", 0, 2000),),
            words=(
                ("t_us", False),
                ("next_event", False),
            ),
        ),
        Verb.LASER: VerbSpecification(
            session=True,
            again=False,
            arguments=(Argument("mask", "", 0, 3),),
            words=(),
        ),
        Verb.SPEED: VerbSpecification(
            session=True,
            again=False,
            arguments=(
                Argument("axis", "", 0, 1),
                Argument("rate", "1/1000 step/s", 1000, 20000000),
                Argument("acceleration", "step/s^2", 100, 1000000),
            ),
            words=(),
        ),
        Verb.BOUNDS: VerbSpecification(
            session=True,
            again=False,
            arguments=(
                Argument("axis", "", 0, 1),
                Argument("lowest", "step", -10000000, 10000000),
                Argument("highest", "step", -10000000, 10000000),
            ),
            words=(),
        ),
        Verb.MOVE: VerbSpecification(
            session=True,
            again=False,
            arguments=(
                Argument("axis", "", 0, 1),
                Argument("to", "step", -10000000, 10000000),
            ),
            words=(("motion", False),),
        ),
        Verb.STOP: VerbSpecification(
            session=True,
            again=False,
            arguments=(),
            words=(),
        ),
        Verb.HOME: VerbSpecification(
            session=True,
            again=False,
            arguments=(Argument("axis", "", 0, 1),),
            words=(("motion", False),),
        ),
        Verb.SCAN: VerbSpecification(
            session=True,
            again=False,
            arguments=(
                Argument("from", "step", -10000000, 10000000),
                Argument("to", "step", -10000000, 10000000),
                Argument("rate", "1/1000 step/s", 1000, 20000000),
                Argument("phases", "", 0, 3333),
                Argument("phase", "us", 0, 10000000),
            ),
            words=(("motion", False),),
        ),
        Verb.RASTER: VerbSpecification(
            session=True,
            again=False,
            arguments=(
                Argument("cart_from", "step", -10000000, 10000000),
                Argument("cart_to", "step", -10000000, 10000000),
                Argument("advance", "step", 1, 10000000),
                Argument("slide_from", "step", -10000000, 10000000),
                Argument("slide_to", "step", -10000000, 10000000),
                Argument("rate", "1/1000 step/s", 1000, 20000000),
            ),
            words=(("motion", False),),
        ),
        Verb.TELEM: VerbSpecification(
            session=True,
            again=False,
            arguments=(
                Argument("rate", "Hz", 0, 200),
                Argument("samples", "", 1, 4),
            ),
            words=(),
        ),
        Verb.EVENTS: VerbSpecification(
            session=True,
            again=True,
            arguments=(Argument("from", "", 0, 4294967295),),
            words=(
                ("first", False),
                ("next_event", False),
            ),
        ),
        Verb.RESET: VerbSpecification(
            session=True,
            again=False,
            arguments=(),
            words=(),
        ),
    }
)
DEFAULT_RATE_MSTEPS_S: Mapping[AxisNumber, int] = MappingProxyType(
    {
        AxisNumber.CART: 500000,
        AxisNumber.SLIDE: 4000000,
    }
)
"""Rate of each axis until SPEED sets another."""
DEFAULT_ACCELERATION_STEPS_S2: Mapping[AxisNumber, int] = MappingProxyType(
    {
        AxisNumber.CART: 2000,
        AxisNumber.SLIDE: 40000,
    }
)
"""Acceleration of each axis until SPEED sets another."""
