"""When the simulated board's lasers may shine, and when it stops of its own accord."""

import asyncio
from collections.abc import Callable

from twinline.devices.board import Axis
from twinline.devices.serial.protocol_gen import DRIFT_STEPS, ErrorCode, EventKind, Flag, Latch, MotionEnd
from twinline.devices.simulator.board_clock import SimulatedClock
from twinline.devices.simulator.board_lasers import LaserOutputs
from twinline.devices.simulator.board_motion import BoardMotion
from twinline.devices.simulator.board_programs import Program
from twinline.devices.simulator.board_session import RefusalError


class BoardSafety:
    """Heartbeat, emergency stop, limit switches, and the latch that they set.

    Parameters
    ----------
    clock
        The board's time.
    motion
        The axes.
    outputs
        The lasers.
    event
        Tells an event: kind, two details, and when.

    Attributes
    ----------
    latch
        Why nothing shines or moves until it is released.
    known
        Axes whose positions are known.
    program
        What is running.
    e_stop
        Whether the emergency stop is pressed.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        motion: BoardMotion,
        outputs: LaserOutputs,
        event: Callable[[EventKind, int, int, int], None],
    ) -> None:
        self._clock = clock
        self._motion = motion
        self._outputs = outputs
        self._event = event
        self._heartbeat: asyncio.TimerHandle | None = None
        self._edges: dict[int, int] = {}
        self.program: Program | None = None
        self.e_stop = False
        self.latch = Latch.NONE
        self.known: set[Axis] = set()

    def restart(self) -> None:
        """Forget everything but what is pressed, as a restart of the board does."""
        self._edges.clear()
        self.known.clear()
        self.latch = Latch.NONE
        if self.e_stop:
            self._latch(Latch.E_STOP)

    def forget_edges(self) -> None:
        """Let the limit switches' places be learnt again."""
        self._edges.clear()

    def flags(self) -> Flag:
        """State of what is dealt with here."""
        low, high = self._motion.pressed
        states = {
            Flag.RUNNING: self.program is not None,
            Flag.LIMIT_LOW: low,
            Flag.LIMIT_HIGH: high,
            Flag.E_STOP: self.e_stop,
            Flag.LATCHED: self.latch is not Latch.NONE,
            Flag.HEARTBEAT: self._heartbeat is not None,
            Flag.CART_KNOWN: "cart" in self.known,
            Flag.SLIDE_KNOWN: "slide" in self.known,
        }
        flags = Flag(0)
        for flag, state in states.items():
            if state:
                flags |= flag
        return flags

    def switch(self, mask: int) -> None:
        """Switch the lasers, or refuse to.

        Raises
        ------
        RefusalError
            Latched, no heartbeat, or a program is running.
        """
        if mask == 0:
            self._dim()
            return
        if self.latch:
            raise RefusalError(ErrorCode.LATCHED)
        self.check_heartbeat()
        if self.program is not None:
            raise RefusalError(ErrorCode.BUSY)
        self._outputs.switch(mask, self._clock.now())
        self._event(EventKind.LASERS, mask, 0, self._clock.now())

    def check_heartbeat(self) -> None:
        """Refuse light that nobody watches over.

        Raises
        ------
        RefusalError
            No heartbeat is armed.
        """
        if self._heartbeat is None:
            raise RefusalError(ErrorCode.NO_HEARTBEAT)

    def _dim(self) -> None:
        """Switch off, and let what is running go on in the dark."""
        if self.program is not None:
            self.program.dimmed = True
        self.dark(self._clock.now())

    def dark(self, ticks: int) -> None:
        """Switch off, now or from a time just past."""
        if not self._outputs.dark:
            self._outputs.switch(0, ticks)
            self._event(EventKind.LASERS, 0, 0, ticks)

    def halt(self, reason: MotionEnd) -> None:
        """Switch off, brake, and end what is running."""
        self.dark(self._clock.now())
        if self.program is not None:
            self.program.halt(reason)
        self._motion.brake(reason)

    def arm(self, deadline_ms: int) -> None:
        """Arm or renew the heartbeat's deadline; 0 disarms."""
        self.disarm()
        if deadline_ms:
            loop = asyncio.get_running_loop()
            self._heartbeat = loop.call_later(deadline_ms / 1000, self._heartbeat_missed)
        else:
            self._dim()

    def disarm(self) -> None:
        """Wait for no heartbeat."""
        if self._heartbeat is not None:
            self._heartbeat.cancel()
            self._heartbeat = None

    def _heartbeat_missed(self) -> None:
        self._heartbeat = None
        self.halt(MotionEnd.HEARTBEAT)
        self._latch(Latch.HEARTBEAT)

    def _latch(self, latch: Latch) -> None:
        if self.latch is not Latch.E_STOP and self.latch is not latch:
            self.latch = latch
            self._event(EventKind.LATCH, latch, 0, self._clock.now())

    def _abort(self, reason: MotionEnd, latch: Latch) -> None:
        self.dark(self._clock.now())
        if self.program is not None:
            self.program.halt(reason)
        self.known.clear()
        self._motion.cut(reason)
        self._latch(latch)

    def release(self) -> None:
        """Release the latch.

        Raises
        ------
        RefusalError
            Its cause is still there.
        """
        if self.e_stop:
            raise RefusalError(ErrorCode.E_STOP_ACTIVE)
        if all(self._motion.pressed):
            raise RefusalError(ErrorCode.LATCHED)
        if self.latch:
            self.latch = Latch.NONE
            self._event(EventKind.LATCH, Latch.NONE, 0, self._clock.now())

    def press_e_stop(self, pressed: bool) -> None:
        """The emergency stop changes."""
        if pressed != self.e_stop:
            self.e_stop = pressed
            self._event(EventKind.E_STOP, int(pressed), 0, self._clock.now())
            if pressed:
                self._abort(MotionEnd.E_STOP, Latch.E_STOP)

    def switch_changed(self, side: int, pressed: bool, ticks: int) -> None:
        """A limit switch changes."""
        count = self._motion.count("slide", ticks)
        self._event(EventKind.LIMIT, side, int(pressed), ticks)
        if not pressed:
            return
        if all(self._motion.pressed):
            self._abort(MotionEnd.WIRING, Latch.WIRING)
            return
        if side == 0 and self.program is not None:
            self.program.low_edge = count
        if "slide" in self.known:
            drift = count - self._edges.setdefault(side, count if side else 0)
            if abs(drift) > DRIFT_STEPS:
                self._event(EventKind.DRIFT, side, drift, ticks)
        if self._motion.heading("slide") == (1 if side else -1):
            self._motion.brake(MotionEnd.LIMIT, ("slide",), ticks=ticks)
