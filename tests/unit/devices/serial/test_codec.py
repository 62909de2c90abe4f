"""What lines say, both ways."""

from dataclasses import asdict
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.devices.serial.protocol_vectors import vectors
from twinline.devices.serial import codec
from twinline.devices.serial.framing import framed
from twinline.devices.serial.protocol_gen import VERBS, EventKind, Verb


@pytest.mark.parametrize("vector", vectors("request"), ids=lambda vector: repr(vector["body"]))
def test_requests_are_read_as_the_shared_vectors_say(vector: dict[str, Any]) -> None:
    request = codec.parse_request(vector["body"])
    match request:
        case None:
            assert vector["seq"] is None
        case codec.BadRequest():
            assert (request.sequence, request.error.value) == (vector["seq"], vector["error"])
        case codec.Request():
            assert [request.sequence, request.verb.value] == [vector["seq"], vector["verb"]]
            assert list(request.arguments) == vector["arguments"]


@pytest.mark.parametrize("vector", vectors("message"), ids=lambda vector: repr(vector["body"]))
def test_messages_are_read_as_the_shared_vectors_say(vector: dict[str, Any]) -> None:
    message, expected = codec.parse_message(vector["body"]), vector["expected"]
    if expected is None:
        assert message is None
        return
    kind = expected.pop("kind")
    match message:
        case codec.Answer():
            assert kind == "answer"
            assert (message.sequence, message.ok, list(message.words)) == tuple(expected.values())
        case codec.WireEvent():
            assert kind == "event"
            assert list(asdict(message).values()) == list(expected.values())
        case codec.WireTelemetry():
            assert kind == "telemetry"
            assert [list(v) if isinstance(v, tuple) else v for v in asdict(message).values()] == list(expected.values())
        case codec.BadLineNotice():
            assert kind == "bad-line"
            assert message.why.name.lower() == expected["why"]
        case None:
            pytest.fail("nothing was read")


@given(st.integers(0, 65535), st.sampled_from(list(Verb)), st.data())
def test_requests_come_out_as_they_went_in(sequence: int, verb: Verb, data: st.DataObject) -> None:
    limits = VERBS[verb].arguments
    arguments = tuple(data.draw(st.integers(argument.low, argument.high)) for argument in limits)
    request = codec.Request(sequence, verb, arguments)
    assert codec.parse_request(codec.request_body(request)) == request


STEPS = st.integers(-(10**7), 10**7)
UNSIGNED = st.integers(0, 2**32 - 1)


@given(UNSIGNED, UNSIGNED, st.sampled_from(list(EventKind)), STEPS, STEPS, STEPS, STEPS)
def test_events_come_out_as_they_went_in(
    n: int, t_us: int, kind: EventKind, cart: int, slide: int, a: int, b: int
) -> None:
    event = codec.WireEvent(n, t_us, kind, cart, slide, a, b)
    assert codec.parse_message(codec.event_body(event)) == event


@given(UNSIGNED, UNSIGNED, STEPS, STEPS, st.sampled_from([1, 4]), st.integers(0, 65520), st.integers(0, 2**14 - 1))
def test_telemetry_comes_out_as_it_went_in(
    n: int, t_us: int, cart: int, slide: int, samples: int, adc: int, flags: int
) -> None:
    sample = codec.WireTelemetry(n, t_us, 16 * cart, 16 * slide, (adc,) * samples, flags)
    assert codec.parse_message(codec.telemetry_body(sample)) == sample


def test_the_longest_message_fits_into_a_line() -> None:
    longest = codec.WireTelemetry(2**32 - 1, 2**32 - 1, -16 * 10**7, -16 * 10**7, (65520,) * 4, 2**14 - 1)
    framed(codec.telemetry_body(longest))
    framed(
        codec.event_body(codec.WireEvent(2**32 - 1, 2**32 - 1, EventKind.SCAN_START, -(10**7), -(10**7), 65535, 2**32))
    )


@given(st.text(max_size=60))
def test_no_text_makes_parsing_fail(text: str) -> None:
    codec.parse_request(text)
    codec.parse_message(text)
