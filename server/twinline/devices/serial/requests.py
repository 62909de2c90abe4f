"""Requests under way: numbered, sent again until answered, failing together."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from random import SystemRandom

from twinline.devices.serial.codec import Answer, Request, request_body
from twinline.devices.serial.framing import framed
from twinline.devices.serial.protocol_gen import SEQUENCE_NUMBERS, ErrorCode, Verb
from twinline.devices.serial.reasons import refused, stopped
from twinline.errors import DeviceError, DeviceTimeoutError, TwinlineError

ATTEMPTS = 20
PATIENCE_S = 0.05
_NUMBERS = range(10_000, SEQUENCE_NUMBERS)
"""Those with five digits: equal questions take equal time on the line, which the clocks' comparison relies on."""


@dataclass(frozen=True)
class Reply:
    """A positive answer.

    Attributes
    ----------
    words
        Its fields.
    sent_s, received_s
        Host times of the question and the answer.
    sent_bytes
        Length of the question's line.
    once
        Whether the question was sent a single time, so that both belong together for certain.
    """

    words: tuple[str, ...]
    sent_s: float
    received_s: float
    sent_bytes: int
    once: bool


@dataclass
class _Pending:
    line: bytes
    verb: Verb
    ordered: bool
    answer: "asyncio.Future[tuple[Answer, float]]"
    sent_s: float = 0.0
    times: int = 0


class Requests:
    """Requests over one connection.

    A request goes out again when no answer comes for a while, or at once when the board complains of a bad line, always
    with its number, so that a command is done once. Commands, whose order matters, go one after another, so the board
    need remember few answers; questions pass them.

    Parameters
    ----------
    write
        Sends bytes.
    """

    def __init__(self, write: Callable[[bytes], None]) -> None:
        self._write = write
        self._loop = asyncio.get_running_loop()
        # Not the numbers of an earlier connection, whose late answers may still come.
        self._sequence = SystemRandom().randrange(_NUMBERS.start, _NUMBERS.stop)
        self._pending: dict[int, _Pending] = {}
        self._order = asyncio.Lock()
        self._stops = 0
        self._failure: TwinlineError | None = None

    async def ask(self, verb: Verb, *arguments: int) -> Reply:
        """Ask something whose order among other requests does not matter.

        Raises
        ------
        RefusedError
            The board refuses.
        DeviceTimeoutError
            No answer came, although it was sent `ATTEMPTS` times.
        DeviceError
            What `fail` was called with.
        """
        return await self._exchange(verb, arguments, ordered=False)

    @asynccontextmanager
    async def commands(self) -> AsyncIterator[Callable[..., Awaitable[Reply]]]:
        """Several commands that no others come between; a stop prevents the rest of them.

        Yields
        ------
        callable
            ``await command(verb, *arguments)``, raising like `ask`, and `RefusedError` with the code ``stopped``.
        """
        stops = self._stops

        async def command(verb: Verb, *arguments: int) -> Reply:
            if self._stops != stops:
                raise stopped(verb.value)
            return await self._exchange(verb, arguments, ordered=True)

        async with self._order:
            yield command

    async def stop(self) -> None:
        """Send STOP ahead of everything; commands under way or waiting fail instead of being sent again after it."""
        self._stops += 1
        for pending in list(self._pending.values()):
            if pending.ordered and not pending.answer.done():
                pending.answer.set_exception(stopped(pending.verb.value))
        await self._exchange(Verb.STOP, (), ordered=False)

    def stop_unheard(self) -> None:
        """Send STOP twice without waiting for an answer: the last thing before a connection is given up."""
        for _ in range(2):
            self._write(framed(request_body(Request(self._next(), Verb.STOP, ()))))

    def answered(self, answer: Answer, received_s: float) -> None:
        """An answer has come."""
        pending = self._pending.get(answer.sequence)
        if pending is not None and not pending.answer.done():
            pending.answer.set_result((answer, received_s))

    def complained(self) -> None:
        """The board has seen a bad line, which may be any of those under way."""
        for pending in self._pending.values():
            self._send(pending)

    def fail(self, error: TwinlineError) -> None:
        """Let all requests fail, those under way and those to come."""
        self._failure = error
        for pending in list(self._pending.values()):
            if not pending.answer.done():
                pending.answer.set_exception(again(error))

    async def _exchange(self, verb: Verb, arguments: tuple[int, ...], *, ordered: bool) -> Reply:
        if self._failure is not None:
            raise again(self._failure)
        sequence = self._next()
        line = framed(request_body(Request(sequence, verb, arguments)))
        pending = _Pending(line, verb, ordered, self._loop.create_future())
        self._pending[sequence] = pending
        try:
            for _ in range(ATTEMPTS):
                self._send(pending)
                await asyncio.wait({pending.answer}, timeout=PATIENCE_S)
                if pending.answer.done():
                    return self._reply(pending)
            raise DeviceTimeoutError(
                f"The board did not answer {verb.value}, sent {ATTEMPTS} times within {ATTEMPTS * PATIENCE_S:.1f} s. "
                "Check that it runs and that nothing else uses the port."
            )
        finally:
            del self._pending[sequence]
            # A failure that nobody waited for any more is no news.
            if pending.answer.done() and not pending.answer.cancelled():
                pending.answer.exception()

    def _reply(self, pending: _Pending) -> Reply:
        answer, received_s = pending.answer.result()
        if answer.ok:
            return Reply(answer.words, pending.sent_s, received_s, len(pending.line), pending.times == 1)
        try:
            error = ErrorCode(answer.words[0])
        except ValueError:
            raise DeviceError(
                f"The board answers {pending.verb.value} with the unknown error {answer.words[0]!r}; flash the "
                "firmware that belongs to this version."
            ) from None
        raise refused(pending.verb.value, error)

    def _send(self, pending: _Pending) -> None:
        pending.times += 1
        pending.sent_s = self._loop.time()
        self._write(pending.line)

    def _next(self) -> int:
        self._sequence = self._sequence + 1 if self._sequence + 1 in _NUMBERS else _NUMBERS.start
        return self._sequence


def again(error: TwinlineError) -> TwinlineError:
    """The same error as a new object: raised in several places, one object would gather all their tracebacks."""
    return type(error)(error.detail, code=error.code)
