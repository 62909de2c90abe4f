"""A motion board at the other end of a serial link."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from math import ceil, floor
from typing import Self

from twinline.devices.board import (
    AXES,
    DEFAULT_CART,
    DEFAULT_SLIDE,
    Axis,
    BoardEvent,
    BoardInfo,
    BoardMessage,
    BoardStatus,
    Drive,
    LaserPass,
    LinkChange,
    Telemetry,
    TofRaster,
)
from twinline.devices.serial.codec import WireEvent, WireTelemetry
from twinline.devices.serial.link import BoardLink, Hello, LinkState
from twinline.devices.serial.motions import Motions
from twinline.devices.serial.protocol_gen import (
    POSITION_FRACTION,
    PROTOCOL_HASH,
    TELEMETRY_MAX_HZ,
    AxisNumber,
    EventKind,
    Flag,
    Latch,
    Verb,
)
from twinline.devices.serial.requests import Requests
from twinline.devices.serial.streams import Connect
from twinline.devices.subscription import Broadcast
from twinline.errors import DeviceError, LinkError, RefusedError, TwinlineError

_STOP_PATIENCE_S = 1.0
_NUMBERS: Mapping[Axis, AxisNumber] = {"cart": AxisNumber.CART, "slide": AxisNumber.SLIDE}
DEFAULT_DRIVES: Mapping[Axis, Drive] = {"cart": DEFAULT_CART, "slide": DEFAULT_SLIDE}


class SerialBoard:
    """A board with the protocol of firmware/protocol; implements `Board`.

    Parameters
    ----------
    connect
        Opens a connection, such as `port`'s.
    drives
        How the axes are driven.
    baud
        Bit rate of the slowest part of the link; it only serves to know how long lines take.
    """

    def __init__(self, connect: Connect, *, drives: Mapping[Axis, Drive] | None = None, baud: int = 115200) -> None:
        self._drives = dict(DEFAULT_DRIVES if drives is None else drives)
        self._link = BoardLink(connect, self, baud)
        self._motions = Motions()
        self._broadcast: Broadcast[BoardMessage] = Broadcast()
        self._telemetry = (0, 1)
        self._info: BoardInfo | None = None

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> BoardInfo:
        """Connect; see `Board`."""
        if self._link.state is LinkState.CLOSED:
            self._broadcast.open()
            await self._link.open()
        return self.info

    @property
    def info(self) -> BoardInfo:
        """What is at the other end.

        Raises
        ------
        LinkError
            It was never connected.
        """
        if self._info is None:
            raise LinkError("The board was not connected yet; open it first.")
        return self._info

    async def close(self) -> None:
        """Switch off, stop and disconnect; see `Board`."""
        if self._link.state is LinkState.CLOSED:
            return
        with contextlib.suppress(TwinlineError, TimeoutError):
            async with asyncio.timeout(_STOP_PATIENCE_S):
                await self._link.requests.stop()
                await self._link.requests.ask(Verb.TELEM, 0, 1)
                await self._link.requests.ask(Verb.HB, 0)
        await self._link.close()
        self._motions.fail(LinkError("The movement was given up because the board was disconnected."))
        self._broadcast.publish(LinkChange(self._now(), "closed", ""))
        self._broadcast.close()

    def subscribe(self) -> AsyncIterator[BoardMessage]:
        """Everything that comes from now on; see `Board`."""
        return self._broadcast.subscribe()

    # -------------------------------------------------------------------------------------------------------- commands

    async def status(self) -> BoardStatus:
        """Ask the board how it is; see `Board`."""
        return await self._status(self._link.requests)

    async def _status(self, requests: Requests) -> BoardStatus:
        reply = await requests.ask(Verb.STATUS)
        t_us, cart, slide, adc, flags, latch = (int(word) for word in reply.words[:6])
        board_s = self._link.time.unwrap_s(t_us, reply.received_s)
        return BoardStatus(
            host_time_s=self._link.time.host_time_s(board_s),
            cart_mm=cart * self._drives["cart"].mm_per_step,
            slide_mm=slide * self._drives["slide"].mm_per_step,
            adc=adc,
            flags=Flag(flags),
            latch=Latch(latch),
        )

    async def lasers(self, on: frozenset[int]) -> None:
        """Switch lasers; see `Board`."""
        mask = _mask(on)
        async with self._link.requests.commands() as command:
            await command(Verb.LASER, mask)

    async def move(self, axis: Axis, to_mm: float, speed_mm_s: float) -> None:
        """Move an axis; see `Board`."""
        to = self._steps(axis, to_mm)
        speed = self._speed_words(axis, speed_mm_s)
        await self._move(f"The movement of the {axis} to {to_mm:g} mm", (speed,), (Verb.MOVE, _NUMBERS[axis], to))

    async def home(self, axis: Axis) -> None:
        """Find an axis's zero; see `Board`."""
        speed = self._speed_words(axis, self._drives[axis].max_speed_mm_s / 2.0)
        await self._move(f"Homing the {axis}", (speed,), (Verb.HOME, _NUMBERS[axis]))

    async def laser_pass(self, plan: LaserPass) -> None:
        """Drive along a laser pass; see `Board`."""
        if not 1 <= len(plan.phases) <= 4 or (len(plan.phases) > 1 and not plan.phases[0]):
            raise RefusedError(
                f"A laser pass takes 1 to 4 phases of which the first has light, not {len(plan.phases)} with "
                f"{sorted(plan.phases[0]) if plan.phases else 'none'} first.",
                code="out-of-range",
            )
        digits = int("".join(str(_mask(phase)) for phase in plan.phases))
        rate = self._rate("cart", plan.speed_mm_s)
        approach = self._speed_words("cart", self._drives["cart"].max_speed_mm_s)
        first, last = self._steps("cart", plan.from_mm), self._steps("cart", plan.to_mm)
        scan = (Verb.SCAN, first, last, rate, digits, round(plan.phase_s * 1e6))
        await self._move("The laser pass", (approach,), scan)

    async def raster(self, plan: TofRaster) -> None:
        """Drive along a raster; see `Board`."""
        speeds = tuple(self._speed_words(axis, self._drives[axis].max_speed_mm_s) for axis in AXES)
        raster = (
            Verb.RASTER,
            self._steps("cart", plan.cart_from_mm),
            self._steps("cart", plan.cart_to_mm),
            self._steps("cart", plan.cart_advance_mm),
            self._steps("slide", plan.slide_from_mm),
            self._steps("slide", plan.slide_to_mm),
            self._rate("slide", plan.slide_speed_mm_s),
        )
        await self._move("The ToF pass", speeds, raster)

    async def stop(self) -> None:
        """Brake everything and switch the lasers off; see `Board`."""
        await self._link.requests.stop()

    async def reset(self) -> None:
        """Release the latch; see `Board`."""
        async with self._link.requests.commands() as command:
            await command(Verb.RESET)

    async def telemetry(self, rate_hz: int, *, samples: int = 1) -> None:
        """Set the telemetry's rate; see `Board`. It holds over a lost connection."""
        async with self._link.requests.commands() as command:
            await command(Verb.TELEM, rate_hz, samples)
        self._telemetry = (rate_hz, samples)

    async def _move(self, what: str, before: tuple[tuple[int, ...], ...], motion: tuple[Verb | int, ...]) -> None:
        try:
            async with self._link.requests.commands() as command:
                for words in before:
                    await command(Verb.SPEED, *words)
                reply = await command(*motion)
            await self._motions.end(what, int(reply.words[0]))
        except asyncio.CancelledError:
            await self._stop_quietly()
            raise

    async def _stop_quietly(self) -> None:
        """Stop on behalf of a caller who was cancelled and so cannot handle an error."""
        with contextlib.suppress(TwinlineError, TimeoutError):
            async with asyncio.timeout(_STOP_PATIENCE_S):
                await self._link.requests.stop()

    # ------------------------------------------------------------------------------------------------------------ link

    async def link_up(self, hello: Hello, requests: Requests) -> None:
        """Tell the board its bounds and what it may have forgotten."""
        self._info = BoardInfo(
            name=hello.board,
            firmware=hello.firmware,
            protocol_hash=PROTOCOL_HASH,
            boot_id=hello.boot_id,
            drives=dict(self._drives),
            lasers=frozenset({1, 2}),
            has_adc=True,
            max_telemetry_hz=TELEMETRY_MAX_HZ,
        )
        for axis in AXES:
            drive = self._drives[axis]
            low, high = ceil(drive.low_mm / drive.mm_per_step), floor(drive.high_mm / drive.mm_per_step)
            await requests.ask(Verb.BOUNDS, _NUMBERS[axis], low, high)
            await requests.ask(Verb.SPEED, *self._speed_words(axis, drive.max_speed_mm_s / 2.0))
        status = await self._status(requests)
        if status.latch is Latch.HEARTBEAT:
            # That an earlier connection broke off is no reason to refuse the next one.
            await requests.ask(Verb.RESET)
        await requests.ask(Verb.TELEM, *self._telemetry)

    def link_ready(self) -> None:
        """Tell the subscribers that commands are possible."""
        self._broadcast.publish(LinkChange(self._now(), "up", ""))

    def link_down(self, error: TwinlineError) -> None:
        """Give up what was moving, and tell the subscribers."""
        self._motions.fail(error)
        self._motions.forget()
        self._broadcast.publish(LinkChange(self._now(), "down", error.detail))

    def events_lost(self, count: int) -> None:
        """Give up what was moving: its end may be among what is lost."""
        self._motions.fail(
            DeviceError(
                f"{count} events of the board were lost, so how the movement ended is not known; check the cable.",
                code="events-lost",
            )
        )

    def event(self, event: WireEvent) -> None:
        """Pass an event on."""
        if event.kind is EventKind.MOTION_END:
            self._motions.ended(event.a, event.b)
        board_s = self._link.time.unwrap_s(event.t_us, self._now())
        self._broadcast.publish(
            BoardEvent(
                n=event.n,
                host_time_s=self._link.time.host_time_s(board_s),
                board_time_s=board_s,
                kind=event.kind,
                cart_mm=event.cart * self._drives["cart"].mm_per_step,
                slide_mm=event.slide * self._drives["slide"].mm_per_step,
                a=event.a,
                b=event.b,
            )
        )

    def telemetry_line(self, sample: WireTelemetry, arrival_s: float) -> None:
        """Pass telemetry on."""
        board_s = self._link.time.unwrap_s(sample.t_us, arrival_s)
        self._broadcast.publish(
            Telemetry(
                n=sample.n,
                host_time_s=self._link.time.host_time_s(board_s),
                board_time_s=board_s,
                cart_mm=sample.cart / POSITION_FRACTION * self._drives["cart"].mm_per_step,
                slide_mm=sample.slide / POSITION_FRACTION * self._drives["slide"].mm_per_step,
                adc=sample.adc[-1],
                flags=Flag(sample.flags),
                earlier_adc=sample.adc[:-1],
            )
        )

    # ----------------------------------------------------------------------------------------------------------- units

    def _steps(self, axis: Axis, place_mm: float) -> int:
        return round(place_mm / self._drives[axis].mm_per_step)

    def _rate(self, axis: Axis, speed_mm_s: float) -> int:
        drive = self._drives[axis]
        if not 0.0 < speed_mm_s <= drive.max_speed_mm_s:
            raise RefusedError(
                f"The {axis} can move at more than 0 and up to {drive.max_speed_mm_s:g} mm/s, not at {speed_mm_s:g}.",
                code="out-of-range",
            )
        return max(1000, round(speed_mm_s / drive.mm_per_step * 1000.0))

    def _speed_words(self, axis: Axis, speed_mm_s: float) -> tuple[int, int, int]:
        drive = self._drives[axis]
        acceleration = max(100, round(drive.acceleration_mm_s2 / drive.mm_per_step))
        return _NUMBERS[axis], self._rate(axis, speed_mm_s), acceleration

    @staticmethod
    def _now() -> float:
        return asyncio.get_running_loop().time()


def _mask(lasers: frozenset[int]) -> int:
    if not lasers <= {1, 2}:
        raise RefusedError(f"The board has lasers 1 and 2, not {sorted(lasers)}.", code="out-of-range")
    return sum(lasers)
