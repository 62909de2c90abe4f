"""The connection to a board, kept up: handshake, heartbeat, lost events, a restarted board, a pulled cable."""

import asyncio
import contextlib
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import Protocol

from twinline.devices.serial.board_time import BoardTime
from twinline.devices.serial.codec import (
    Answer,
    BadLineNotice,
    WireEvent,
    WireTelemetry,
    parse_message,
)
from twinline.devices.serial.event_order import EventOrder
from twinline.devices.serial.framing import LineReader, Noise, framed
from twinline.devices.serial.protocol_gen import (
    HEARTBEAT_DEFAULT_MS,
    PROTOCOL_HASH,
    PROTOCOL_VERSION,
    VERBS,
    ErrorCode,
    EventKind,
    Verb,
)
from twinline.devices.serial.requests import Reply, Requests
from twinline.devices.serial.streams import ByteStream, Connect
from twinline.errors import DeviceError, DeviceTimeoutError, LinkError, RefusedError, TwinlineError

HEARTBEAT_S = 0.1
SILENCE_S = 0.55
"""A board that has said nothing for so long is given up, and with it its heartbeat: light needs somebody who sees.

A little longer than the heartbeat's deadline, so that a board that hears nothing gets to say so.
"""
_PINGS = 8
_EVENT_BYTES = 45
_BACK_OFF_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


class LinkState(StrEnum):
    """Where a link stands.

    ``closed`` -> ``connecting`` -> ``up`` -> ``down`` -> ``connecting`` ..., and from each of them to ``closed``.
    """

    CLOSED = "closed"
    CONNECTING = "connecting"
    UP = "up"
    DOWN = "down"


TRANSITIONS: dict[LinkState, frozenset[LinkState]] = {
    LinkState.CLOSED: frozenset({LinkState.CONNECTING}),
    LinkState.CONNECTING: frozenset({LinkState.UP, LinkState.DOWN, LinkState.CLOSED}),
    LinkState.UP: frozenset({LinkState.DOWN, LinkState.CLOSED}),
    LinkState.DOWN: frozenset({LinkState.CONNECTING, LinkState.CLOSED}),
}


@dataclass(frozen=True)
class Hello:
    """What the board says of itself."""

    boot_id: int
    firmware: str
    board: str


class LinkUser(Protocol):
    """Who is told what comes over a link."""

    async def link_up(self, hello: Hello, requests: Requests) -> None:
        """Connected and agreed; nobody else can give commands yet. May raise to refuse."""
        ...

    def link_ready(self) -> None:
        """The connection is in use."""
        ...

    def link_down(self, error: TwinlineError) -> None:
        """The connection is lost; it is being tried again."""
        ...

    def event(self, event: WireEvent) -> None:
        """An event, each once and in order."""
        ...

    def events_lost(self, count: int) -> None:
        """So many events came and went while the link was down or disturbed."""
        ...

    def telemetry_line(self, sample: WireTelemetry, arrival_s: float) -> None:
        """A line of telemetry."""
        ...


class BoardLink:
    """Keeps the connection to a board up.

    Parameters
    ----------
    connect
        Opens a connection.
    user
        Who is told.
    baud
        Bit rate of the slowest part of the link.
    """

    def __init__(self, connect: Connect, user: LinkUser, baud: int) -> None:
        self._connect = connect
        self._user = user
        self._baud = baud
        self._state = LinkState.CLOSED
        self._task: asyncio.Task[None] | None = None
        self._requests: Requests | None = None
        self._why_down: TwinlineError = LinkError("The board is not connected; open it first.")
        self._boot_id: int | None = None
        self._order = EventOrder()
        self._event_s = _EVENT_BYTES * 10 / baud
        self._gap = asyncio.Event()
        self._heard_s = inf
        self.time = BoardTime(baud)

    @property
    def state(self) -> LinkState:
        """Where it stands."""
        return self._state

    @property
    def requests(self) -> Requests:
        """Requests over the present connection.

        Raises
        ------
        DeviceError
            There is none; the error tells why.
        """
        if self._requests is None:
            raise type(self._why_down)(self._why_down.detail, code=self._why_down.code)
        return self._requests

    async def open(self) -> None:
        """Connect; from then on the connection is kept up.

        Raises
        ------
        DeviceError
            It cannot be made, or something else than a board of this protocol answers. It is not tried again.
        """
        first: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._task = asyncio.get_running_loop().create_task(self._keep_up(first), name="board link")
        try:
            await asyncio.wait({first, self._task}, return_when=asyncio.FIRST_COMPLETED)
            if first.done():
                first.result()
            else:
                self._task.result()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Stop the board and disconnect."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.wait({task})
        if self._state is not LinkState.CLOSED:
            self._go(LinkState.CLOSED)
        self._why_down = LinkError("The board is not connected; open it first.")

    # ------------------------------------------------------------------------------------------------------ connection

    async def _keep_up(self, first: "asyncio.Future[None]") -> None:
        failures = 0
        while True:
            self._go(LinkState.CONNECTING)
            try:
                await self._stay_connected(first)
            except DeviceError as error:
                was_up = self._state is LinkState.UP
                self._why_down = error
                self._go(LinkState.DOWN)
                if not first.done():
                    first.set_exception(error)
                    return
                if was_up:
                    self._user.link_down(error)
                    failures = 0
                await asyncio.sleep(_BACK_OFF_S[min(failures, len(_BACK_OFF_S) - 1)])
                failures += 1

    async def _stay_connected(self, first: "asyncio.Future[None]") -> None:
        stream = await self._connect()
        requests = Requests(stream.write)
        loop = asyncio.get_running_loop()
        tasks = {
            loop.create_task(self._read(stream, requests), name="board reader"),
            loop.create_task(self._live(requests, first), name="board heartbeat"),
            loop.create_task(self._listen(), name="board silence"),
        }
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except DeviceError as error:
            self._why_down = error
            raise
        finally:
            self._requests = None
            requests.fail(self._why_down)
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            # If bytes still get through, this is quicker than waiting for the heartbeat's deadline.
            with contextlib.suppress(TwinlineError, OSError):
                requests.stop_unheard()
            await stream.close()

    async def _live(self, requests: Requests, first: "asyncio.Future[None]") -> None:
        hello = await self._handshake(requests)
        await self._user.link_up(hello, requests)
        # Armed only now: on a slow machine what is told before may take longer than the deadline.
        await self._beat(requests)
        self._requests = requests
        self._go(LinkState.UP)
        self._heard_s = asyncio.get_running_loop().time()
        self._user.link_ready()
        if not first.done():
            first.set_result(None)
        while True:
            self._gap.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(HEARTBEAT_S):
                    await self._gap.wait()
            await self._beat(requests)

    async def _handshake(self, requests: Requests) -> Hello:
        reply = await requests.ask(Verb.HELLO)
        version, code, boot_id, next_event, firmware, board = _words(reply, Verb.HELLO)
        if (version, code) != (str(PROTOCOL_VERSION), PROTOCOL_HASH):
            raise DeviceError(
                f"The board {board} with firmware {firmware} speaks version {version} ({code}) of the protocol, this "
                f"program version {PROTOCOL_VERSION} ({PROTOCOL_HASH}); flash the firmware that belongs to it.",
                code="firmware-mismatch",
            )
        if self._boot_id is None:
            self._order.begin(int(next_event))
        elif self._boot_id != int(boot_id):
            self._order.begin(0)
            self.time.restart()
        self._boot_id = int(boot_id)
        for _ in range(_PINGS):
            self._learn_time(await requests.ask(Verb.PING))
        return Hello(int(boot_id), firmware, board)

    async def _beat(self, requests: Requests) -> None:
        try:
            reply = await requests.ask(Verb.HB, HEARTBEAT_DEFAULT_MS)
        except RefusedError as error:
            raise _restarted() if error.code == ErrorCode.NO_SESSION else error from None
        next_event = int(_words(reply, Verb.HB)[1])
        self._learn_time(reply)
        if next_event > self._order.expected:
            reply = await requests.ask(Verb.EVENTS, self._order.expected)
            first = int(reply.words[0])
            if first > self._order.expected:
                early, lost = self._order.skip_to(first)
                for event in early:
                    self._user.event(event)
                if lost:
                    self._user.events_lost(lost)
            # They come one after another; asking again before the last has come would only delay it.
            await asyncio.sleep((next_event - first) * self._event_s)

    def _learn_time(self, reply: Reply) -> None:
        # The answer to a question that went out twice may belong to either.
        if reply.once:
            received = len(framed(" ".join(("=12345 ok", *reply.words))))
            self.time.add(
                int(reply.words[0]),
                reply.sent_s,
                reply.received_s,
                sent_bytes=reply.sent_bytes,
                received_bytes=received,
            )

    async def _listen(self) -> None:
        now_s, self._heard_s = asyncio.get_running_loop().time, inf
        while (left_s := self._heard_s + SILENCE_S - now_s()) > 0.0:  # noqa: ASYNC110  (time is what is awaited)
            await asyncio.sleep(min(left_s, SILENCE_S))
        raise DeviceTimeoutError(
            f"The board has been silent for {SILENCE_S:g} s. Check its power and the wire from board to computer."
        )

    async def _read(self, stream: ByteStream, requests: Requests) -> None:
        reader = LineReader()
        while True:
            chunk = await stream.read()
            for line in reader.feed(chunk.data):
                if not isinstance(line, Noise):
                    if self._state is LinkState.UP:
                        self._heard_s = chunk.host_time_s
                    self._take(line, chunk.host_time_s, requests)

    def _take(self, line: str, arrival_s: float, requests: Requests) -> None:
        match parse_message(line):
            case Answer() as answer:
                requests.answered(answer, arrival_s)
            case WireTelemetry() as sample:
                if self.time.known and self._state is LinkState.UP:
                    self._user.telemetry_line(sample, arrival_s)
            case WireEvent() as event:
                self._take_event(event)
            case BadLineNotice():
                requests.complained()
            case None:
                pass

    def _take_event(self, event: WireEvent) -> None:
        if event.kind is EventKind.BOOT and self._boot_id is not None and event.b != self._boot_id:
            raise _restarted()
        if self.time.known:
            for ready in self._order.take(event):
                self._user.event(ready)
            if self._order.waiting:
                self._gap.set()

    def _go(self, state: LinkState) -> None:
        if state not in TRANSITIONS[self._state]:
            raise RuntimeError(f"a board link cannot go from {self._state} to {state}")
        self._state = state


def _words(reply: Reply, verb: Verb) -> tuple[str, ...]:
    """Fields of an answer as the protocol has them; only another protocol has others."""
    wanted = VERBS[verb].words
    if len(reply.words) != len(wanted) or not all(
        is_word or word.isdecimal() for word, (_, is_word) in zip(reply.words, wanted, strict=True)
    ):
        raise DeviceError(
            f"The board answers {verb.value} with {' '.join(reply.words)!r}, which is not of version "
            f"{PROTOCOL_VERSION} of the protocol; flash the firmware that belongs to this program.",
            code="firmware-mismatch",
        )
    return reply.words


def _restarted() -> LinkError:
    return LinkError(
        "The board has started again on its own; its positions are lost. Check its supply, then home both axes.",
        code="board-restarted",
    )
