"""A simulated motion board that speaks the real wire protocol, and the machine that it moves."""

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

from twinline.devices.board import Axis
from twinline.devices.serial.codec import Request
from twinline.devices.serial.protocol_gen import PROTOCOL_HASH, WATCHDOG_MS, EventKind, ResetCause
from twinline.devices.simulator.axis import Mechanics, SimulatedAxis
from twinline.devices.simulator.board_adc import BoardAdc
from twinline.devices.simulator.board_clock import SimulatedClock
from twinline.devices.simulator.board_controller import BoardController
from twinline.devices.simulator.board_lasers import LaserOutputs
from twinline.devices.simulator.board_motion import BoardMotion
from twinline.devices.simulator.board_session import BoardSession
from twinline.devices.simulator.faults import Faults
from twinline.devices.simulator.machine_state import AdcModel

_BOOT_S = 0.02
_TICKS_PER_MS = 12_000


@dataclass(frozen=True)
class MachineSettings:
    """A simulated machine as it truly is, from the board down.

    Attributes
    ----------
    cart, slide
        The drives.
    clock_drift_ppm
        How much faster than the host's clock the board's runs, in parts per million.
    clock_start_us
        What the board's clock shows when it starts; near 2^32 its wrap comes soon.
    seed
        For boot ids.
    protocol_hash
        The protocol that the board was built with.
    """

    cart: Mechanics = field(default_factory=lambda: Mechanics(mm_per_step=0.10053))
    slide: Mechanics = field(
        default_factory=lambda: Mechanics(0.005, switches_mm=(0.0, 210.0), stops_mm=(-6.0, 216.0), start_mm=30.0)
    )
    clock_drift_ppm: float = 0.0
    clock_start_us: int = 0
    seed: int = 0
    protocol_hash: str = PROTOCOL_HASH


class SimulatedBoard:
    """A board with its machine: bytes in, bytes out, and motion that can be looked at.

    Make it under a running event loop: all its time is the loop's, so it runs in real time, or as fast as it can under
    a `VirtualTimeLoop`. It implements `MachineState`.

    Parameters
    ----------
    settings
        The machine.
    adc
        The distance sensor.
    """

    def __init__(self, settings: MachineSettings | None = None, *, adc: AdcModel | None = None) -> None:
        settings = settings or MachineSettings()
        self._random = Random(settings.seed)
        self._clock = SimulatedClock(settings.clock_drift_ppm, settings.clock_start_us)
        now = self._clock.now()
        self._axes: dict[Axis, SimulatedAxis] = {
            "cart": SimulatedAxis(settings.cart, now),
            "slide": SimulatedAxis(settings.slide, now),
        }
        self._faults = Faults()
        self._fault_listeners: list[Callable[[], None]] = []
        self._transmit: Callable[[bytes], None] | None = None
        self._alive = True
        self._outputs = LaserOutputs()
        self._adc = BoardAdc(self._clock, self._axes["cart"], self._axes["slide"], adc)
        self._motion = BoardMotion(self._clock, self._axes, self._switch_changed)
        self._session = BoardSession(
            self._clock,
            execute=self._execute,
            positions=lambda ticks: (self._motion.count("cart", ticks), self._motion.count("slide", ticks)),
            sample=self._sample,
            transmit=self._send,
        )
        self._controller = BoardController(
            self._clock,
            self._motion,
            self._outputs,
            lambda kind, a, b, ticks: self._session.event(kind, a, b, ticks=ticks),
            (settings.protocol_hash, "simulated-1", "simulated"),
        )
        self._controller.next_event = lambda: self._session.next_event
        self._controller.reading = self._adc.now
        self._controller.set_telemetry = self._session.set_telemetry
        self._start(ResetCause.POWER)

    # --------------------------------------------------------------------------------------------------------- machine

    def cart_mm(self, host_time_s: float) -> float:
        """True position of the cart, mm, now or in the last 10 s."""
        return self._axes["cart"].place_mm(self._clock.ticks_at(host_time_s))

    def slide_mm(self, host_time_s: float) -> float:
        """True position of the slide, mm, now or in the last 10 s."""
        return self._axes["slide"].place_mm(self._clock.ticks_at(host_time_s))

    def lasers(self, host_time_s: float) -> frozenset[int]:
        """Lasers that truly shine, now or in the last 10 s."""
        mask = self._outputs.mask(self._clock.ticks_at(host_time_s))
        return frozenset(number for number in (1, 2) if mask & number) - self._faults.dead_lasers

    def counts(self) -> tuple[int, int]:
        """What the board counts for cart and slide at present, in steps."""
        return self._motion.count("cart"), self._motion.count("slide")

    @property
    def moving(self) -> bool:
        """Whether any axis moves."""
        return self._motion.moving("cart") or self._motion.moving("slide")

    # ---------------------------------------------------------------------------------------------------------- faults

    @property
    def faults(self) -> Faults:
        """What is wrong now; assign another value to change it."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        self._motion.stall(faults.stalled)
        self._motion.force_switches(faults.low_switch, faults.high_switch)
        self._controller.safety.press_e_stop(faults.e_stop)
        for listener in list(self._fault_listeners):
            listener()

    def on_faults(self, listener: Callable[[], None]) -> None:
        """Have something called after each change of the faults; for cables."""
        self._fault_listeners.append(listener)

    def reset(self, cause: ResetCause = ResetCause.BUTTON) -> None:
        """Start the board again."""
        self._alive = False
        self._controller.shut_down()
        self._motion.restart()
        self._session.restart()
        self._clock.restart()
        self._clock.call_at(self._clock.now() + round(_BOOT_S * 1000) * _TICKS_PER_MS, lambda: self._start(cause))

    def hang(self) -> None:
        """Let the board's program hang: it answers nothing, until its watchdog starts it again."""
        self._alive = False
        self._session.set_telemetry(0, 1)
        self._clock.call_at(self._clock.now() + WATCHDOG_MS * _TICKS_PER_MS, lambda: self.reset(ResetCause.WATCHDOG))

    def close(self) -> None:
        """Power off: no timer of it remains."""
        self._alive = False
        self._controller.shut_down()
        self._motion.restart()
        self._session.restart()
        self._fault_listeners.clear()
        self._transmit = None

    # ------------------------------------------------------------------------------------------------------------ wire

    def attach(self, transmit: Callable[[bytes], None]) -> None:
        """Have the board's bytes handed over."""
        self._transmit = transmit

    def detach(self) -> None:
        """Let the board's bytes go nowhere."""
        self._transmit = None

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        if self._alive:
            self._session.feed(data)

    def _start(self, cause: ResetCause) -> None:
        self._alive = True
        boot_id = self._random.getrandbits(31)
        self._controller.restart(boot_id)
        self._session.event(EventKind.BOOT, cause, boot_id)

    def _switch_changed(self, side: int, pressed: bool, ticks: int) -> None:
        self._controller.safety.switch_changed(side, pressed, ticks)

    def _execute(self, request: Request) -> tuple[int | str, ...]:
        return self._controller.execute(request)

    def _send(self, data: bytes) -> None:
        if self._transmit is not None and self._alive:
            self._transmit(data)

    def _sample(self, ticks: int, samples: int, period_ticks: int) -> tuple[int, int, tuple[int, ...], int]:
        readings = self._adc.readings(ticks, samples, period_ticks)
        flags = self._controller.flags(ticks) | self._adc.flags()
        return self._axes["cart"].reported(ticks), self._axes["slide"].reported(ticks), readings, int(flags)
