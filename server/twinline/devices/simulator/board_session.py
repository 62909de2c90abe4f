"""The simulated board's side of the wire: lines in, answers once, events kept, telemetry when it is due."""

import asyncio
from collections import deque
from collections.abc import Callable

from twinline.devices.serial import codec
from twinline.devices.serial.framing import LineReader, Noise, framed
from twinline.devices.serial.protocol_gen import (
    ANSWERS_KEPT,
    EVENTS_KEPT,
    TELEMETRY_MAX_HZ,
    TIMER_HZ,
    VERBS,
    BadLine,
    ErrorCode,
    EventKind,
    Verb,
)
from twinline.devices.simulator.board_clock import SimulatedClock


class RefusalError(Exception):
    """The board will not do it.

    Parameters
    ----------
    error
        What it answers.
    """

    def __init__(self, error: ErrorCode) -> None:
        super().__init__(error.value)
        self.error = error


class BoardSession:
    """What the board keeps of its talk with a host.

    Parameters
    ----------
    clock
        The board's time.
    execute
        Does a request and gives the words of its answer, or raises `RefusalError`.
    positions
        Counts of cart and slide at a time, for events.
    sample
        Positions, readings and flags of a telemetry line at a time; its second argument is how many readings, its third
        the ticks since the line before.
    transmit
        Takes the bytes that go to the host.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        *,
        execute: Callable[[codec.Request], tuple[int | str, ...]],
        positions: Callable[[int], tuple[int, int]],
        sample: Callable[[int, int, int], tuple[int, int, tuple[int, ...], int]],
        transmit: Callable[[bytes], None],
    ) -> None:
        self._clock = clock
        self._execute = execute
        self._positions = positions
        self._sample = sample
        self._transmit = transmit
        self._timer: asyncio.TimerHandle | None = None
        self.restart()

    def restart(self) -> None:
        """Forget everything, as a restart of the board does."""
        self._reader = LineReader()
        self._answers: dict[int, tuple[str, bytes]] = {}
        self._events: deque[codec.WireEvent] = deque(maxlen=EVENTS_KEPT)
        self.next_event = 0
        self._greeted = False
        self._lines = 0
        self.set_telemetry(0, 1)

    def feed(self, data: bytes) -> None:
        """Take bytes from the host."""
        for line in self._reader.feed(data):
            if isinstance(line, Noise):
                self._complain(line.why)
            else:
                self._take(line)

    def event(self, kind: EventKind, a: int = 0, b: int = 0, *, ticks: int | None = None) -> None:
        """Tell that something happened, now or at a time just past."""
        ticks = self._clock.now() if ticks is None else ticks
        cart, slide = self._positions(ticks)
        event = codec.WireEvent(self.next_event, self._clock.shown_us(ticks), kind, cart, slide, a, b)
        self.next_event += 1
        self._events.append(event)
        self._send(codec.event_body(event))

    def set_telemetry(self, rate_hz: int, samples: int) -> None:
        """Begin or end telemetry."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._samples = samples
        if rate_hz:
            self._period_ticks = TIMER_HZ // rate_hz
            self._due_ticks = self._clock.now() + self._period_ticks
            self._timer = self._clock.call_at(self._due_ticks, self._telemetry_due)

    def _telemetry_due(self) -> None:
        now = self._clock.now()
        # A host that was busy elsewhere gets what the board would have sent meanwhile, up to a second of it.
        late = (now - self._due_ticks) // self._period_ticks
        if late > TELEMETRY_MAX_HZ:
            self._lines += late
            self._due_ticks += late * self._period_ticks
        while self._due_ticks <= now:
            ticks = self._due_ticks
            cart, slide, adc, flags = self._sample(ticks, self._samples, self._period_ticks)
            line = codec.WireTelemetry(self._lines, self._clock.shown_us(ticks), cart, slide, adc, flags)
            self._lines += 1
            self._send(codec.telemetry_body(line))
            self._due_ticks += self._period_ticks
        self._timer = self._clock.call_at(self._due_ticks, self._telemetry_due)

    def _take(self, body: str) -> None:
        request = codec.parse_request(body)
        if request is None:
            self._complain(BadLine.FORM)
            return
        before = self._answers.get(request.sequence)
        if before is not None and before[0] == body:
            self._transmit(before[1])
            return
        answer = self._answer(request)
        line = framed(codec.answer_body(answer))
        if isinstance(request, codec.Request) and not VERBS[request.verb].again:
            self._keep(request.sequence, body, line)
        self._transmit(line)
        if isinstance(request, codec.Request) and request.verb is Verb.EVENTS and answer.ok:
            self._send_again(request.arguments[0])

    def _keep(self, sequence: int, body: str, line: bytes) -> None:
        self._answers.pop(sequence, None)
        self._answers[sequence] = (body, line)
        if len(self._answers) > ANSWERS_KEPT:
            del self._answers[next(iter(self._answers))]

    def _answer(self, request: codec.Request | codec.BadRequest) -> codec.Answer:
        if isinstance(request, codec.BadRequest):
            return codec.Answer(request.sequence, False, (request.error.value,))
        if VERBS[request.verb].session and not self._greeted:
            return codec.Answer(request.sequence, False, (ErrorCode.NO_SESSION.value,))
        if request.verb is Verb.HELLO:
            self._greeted = True
            self._answers.clear()
        try:
            words = self._events_answer(request) if request.verb is Verb.EVENTS else self._execute(request)
        except RefusalError as refusal:
            return codec.Answer(request.sequence, False, (refusal.error.value,))
        return codec.Answer(request.sequence, True, tuple(map(str, words)))

    def _events_answer(self, request: codec.Request) -> tuple[int, int]:
        oldest = self.next_event - len(self._events)
        return max(oldest, min(request.arguments[0], self.next_event)), self.next_event

    def _send_again(self, first: int) -> None:
        for event in self._events:
            if event.n >= first:
                self._send(codec.event_body(event))

    def _complain(self, why: BadLine) -> None:
        self._send(f"?{why.name.lower()}")

    def _send(self, body: str) -> None:
        self._transmit(framed(body))
