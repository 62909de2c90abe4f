"""What lines say: requests of the host, messages of the board."""

import re
from dataclasses import dataclass
from typing import TypeAlias

from twinline.devices.serial.protocol_gen import SEQUENCE_NUMBERS, VERBS, BadLine, ErrorCode, EventKind, Verb

_INTEGER = re.compile(r"0|-?[1-9][0-9]*")
_REQUEST = re.compile(r"#(0|[1-9][0-9]{0,4})((?: [A-Za-z0-9._+-]+)+)")
_ANSWER = re.compile(r"=(0|[1-9][0-9]{0,4}) (ok|err)((?: [A-Za-z0-9._-]+)*)")
_EVENT = re.compile(r"!([0-9]+) ([0-9]+) ([a-z-]+)" + r" (-?[0-9]+)" * 4)
_TELEMETRY = re.compile(r"~([0-9]+) ([0-9]+) (-?[0-9]+) (-?[0-9]+) ([0-9]+(?: [0-9]+ [0-9]+ [0-9]+)?) ([0-9]+)")
_EVENT_KINDS = {kind.value: kind for kind in EventKind}
_BAD_LINES = {why.name.lower(): why for why in BadLine}
TIME_WRAP_US = 2**32
"""The board's microseconds are counted modulo this."""


@dataclass(frozen=True)
class Request:
    """A request that is well-formed and within its limits."""

    sequence: int
    verb: Verb
    arguments: tuple[int, ...]


@dataclass(frozen=True)
class BadRequest:
    """A line with a sequence number that cannot be done as it stands; the error is its answer."""

    sequence: int
    error: ErrorCode


@dataclass(frozen=True)
class Answer:
    """The board's answer to a request.

    Attributes
    ----------
    sequence
        Number of the request.
    ok
        Whether it was done.
    words
        Fields of a positive answer, or the one error.
    """

    sequence: int
    ok: bool
    words: tuple[str, ...]


@dataclass(frozen=True)
class WireEvent:
    """An event; times in microseconds modulo 2^32, positions in steps."""

    n: int
    t_us: int
    kind: EventKind
    cart: int
    slide: int
    a: int
    b: int


@dataclass(frozen=True)
class WireTelemetry:
    """A line of telemetry; times in microseconds modulo 2^32, positions in sixteenths of a step."""

    n: int
    t_us: int
    cart: int
    slide: int
    adc: tuple[int, ...]
    flags: int


@dataclass(frozen=True)
class BadLineNotice:
    """The board could not take a line."""

    why: BadLine


Message: TypeAlias = Answer | WireEvent | WireTelemetry | BadLineNotice


def request_body(request: Request) -> str:
    """A request's line, without checksum."""
    return " ".join([f"#{request.sequence}", request.verb.value, *map(str, request.arguments)])


def parse_request(body: str) -> Request | BadRequest | None:
    """What the host asks for.

    Parameters
    ----------
    body
        A line without checksum.

    Returns
    -------
    Request, BadRequest or None
        None where it is no request at all and so has nothing that an answer could refer to.
    """
    match = _REQUEST.fullmatch(body)
    if match is None or int(match[1]) >= SEQUENCE_NUMBERS:
        return None
    sequence = int(match[1])
    name, *words = match[2].split()
    if name not in Verb.__members__:
        return BadRequest(sequence, ErrorCode.UNKNOWN_VERB)
    verb = Verb[name]
    wanted = VERBS[verb].arguments
    if len(words) != len(wanted) or not all(_INTEGER.fullmatch(word) for word in words):
        return BadRequest(sequence, ErrorCode.BAD_ARGUMENTS)
    values = tuple(int(word) for word in words)
    if not all(argument.low <= value <= argument.high for argument, value in zip(wanted, values, strict=True)):
        return BadRequest(sequence, ErrorCode.OUT_OF_RANGE)
    return Request(sequence, verb, values)


def answer_body(answer: Answer) -> str:
    """An answer's line, without checksum."""
    return " ".join([f"={answer.sequence}", "ok" if answer.ok else "err", *answer.words])


def event_body(event: WireEvent) -> str:
    """An event's line, without checksum."""
    return f"!{event.n} {event.t_us} {event.kind.value} {event.cart} {event.slide} {event.a} {event.b}"


def telemetry_body(sample: WireTelemetry) -> str:
    """A telemetry line, without checksum."""
    adc = " ".join(map(str, sample.adc))
    return f"~{sample.n} {sample.t_us} {sample.cart} {sample.slide} {adc} {sample.flags}"


def parse_message(body: str) -> Message | None:
    """What the board says.

    Parameters
    ----------
    body
        A line without checksum.

    Returns
    -------
    Message or None
        None where it says nothing that this protocol knows.
    """
    match body[:1]:
        case "~":
            return _telemetry(body)
        case "=":
            return _answer(body)
        case "!":
            return _event(body)
        case "?":
            why = _BAD_LINES.get(body[1:])
            return None if why is None else BadLineNotice(why)
        case _:
            return None


def _telemetry(body: str) -> WireTelemetry | None:
    match = _TELEMETRY.fullmatch(body)
    if match is None or int(match[2]) >= TIME_WRAP_US:
        return None
    adc = tuple(int(word) for word in match[5].split())
    return WireTelemetry(int(match[1]), int(match[2]), int(match[3]), int(match[4]), adc, int(match[6]))


def _answer(body: str) -> Answer | None:
    match = _ANSWER.fullmatch(body)
    if match is None:
        return None
    ok, words = match[2] == "ok", tuple(match[3].split())
    if not ok and len(words) != 1:
        return None
    return Answer(int(match[1]), ok, words)


def _event(body: str) -> WireEvent | None:
    match = _EVENT.fullmatch(body)
    if match is None or match[3] not in _EVENT_KINDS or int(match[2]) >= TIME_WRAP_US:
        return None
    cart, slide, a, b = (int(match[group]) for group in (4, 5, 6, 7))
    return WireEvent(int(match[1]), int(match[2]), _EVENT_KINDS[match[3]], cart, slide, a, b)
