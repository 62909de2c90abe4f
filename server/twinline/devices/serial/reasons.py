"""What the board's refusals and ends of movements mean to a reader."""

from collections.abc import Mapping
from types import MappingProxyType

from twinline.devices.serial.protocol_gen import ErrorCode, MotionEnd
from twinline.errors import MotionError, RefusedError

REFUSALS: Mapping[ErrorCode, str] = MappingProxyType(
    {
        ErrorCode.UNKNOWN_VERB: "it does not know the command; flash the firmware that belongs to this version",
        ErrorCode.BAD_ARGUMENTS: "it takes other arguments; flash the firmware that belongs to this version",
        ErrorCode.OUT_OF_RANGE: "a value is outside its limits or the movement would leave the axis's travel; "
        "choose a place inside, with room for the run-up of a pass",
        ErrorCode.NO_SESSION: "it has started again meanwhile; home both axes and repeat",
        ErrorCode.LATCHED: "it is latched after an emergency stop, a lost heartbeat or a wiring fault; "
        "remove the cause and reset it",
        ErrorCode.NO_HEARTBEAT: "no heartbeat is armed, and without one no laser may shine; connect again",
        ErrorCode.BUSY: "a movement or a pass is running; wait for its end or stop it",
        ErrorCode.LIMIT_ACTIVE: "that way the slide is at its limit switch; move it the other way",
        ErrorCode.NOT_HOMED: "the position is not known; home the axes first",
        ErrorCode.E_STOP_ACTIVE: "the emergency stop is still pressed; release it first",
    }
)
ENDS: Mapping[MotionEnd, str] = MappingProxyType(
    {
        MotionEnd.DONE: "it is complete",
        MotionEnd.STOPPED: "it was told to stop",
        MotionEnd.LIMIT: "the slide met a limit switch; move it away from there",
        MotionEnd.E_STOP: "the emergency stop was pressed; release it, reset the board and home both axes",
        MotionEnd.HEARTBEAT: "no heartbeat reached the board in time; check cable and load, then reset the board",
        MotionEnd.WIRING: "both limit switches were pressed at once; check their wires, then reset the board",
        MotionEnd.HOME_FAILED: "the low limit switch was never met, or never released; check the switch, the slide's "
        "motor and their wires",
    }
)
STOPPED_CODE = "stopped"


def refused(what: str, error: ErrorCode) -> RefusedError:
    """The error for a refused command; its code is the board's."""
    return RefusedError(f"The board refuses {what}: {REFUSALS[error]}.", code=error.value)


def stopped(what: str) -> RefusedError:
    """The error for a command that a stop overtook."""
    return RefusedError(f"{what} was not done because everything was told to stop.", code=STOPPED_CODE)


def ended(what: str, end: MotionEnd) -> MotionError:
    """The error for a movement that ended early."""
    return MotionError(f"{what} ended before it was complete: {ENDS[end]}.", code=end.name.lower().replace("_", "-"))
