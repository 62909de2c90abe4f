"""Bodies out of bytes, whatever happens to the bytes."""

from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.devices.serial.protocol_vectors import vectors
from twinline.devices.serial.framing import LineReader, Noise, checksum, framed
from twinline.devices.serial.protocol_gen import LINE_BYTES

BODIES = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters="*"), max_size=LINE_BYTES - 5)


def bodies(found: list[str | Noise]) -> list[str]:
    return [item for item in found if isinstance(item, str)]


@pytest.mark.parametrize("vector", vectors("crc"), ids=lambda vector: vector["body"])
def test_checksums_are_those_of_the_shared_vectors(vector: dict[str, Any]) -> None:
    assert checksum(vector["body"].encode()).decode() == vector["crc"]


def test_the_checksum_is_the_published_one() -> None:
    # The check value of CRC-16/CCITT-FALSE in every catalogue of such codes.
    assert checksum(b"123456789") == b"29B1"


@pytest.mark.parametrize("size", [1, 2, 7, 10_000])
@pytest.mark.parametrize("vector", vectors("stream"), ids=lambda vector: vector["name"])
def test_streams_are_cut_as_the_shared_vectors_say(vector: dict[str, Any], size: int) -> None:
    reader, data = LineReader(), bytes.fromhex(vector["hex"])
    found = [item for start in range(0, len(data), size) for item in reader.feed(data[start : start + size])]
    assert bodies(found) == vector["bodies"]
    assert [item.why.name.lower() for item in found if isinstance(item, Noise)] == vector["bad"]


@given(st.lists(BODIES, max_size=8), st.data())
def test_lines_come_out_as_they_went_in_however_the_stream_is_chopped(sent: list[str], data: st.DataObject) -> None:
    stream = b"".join(framed(body) for body in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    reader = LineReader()
    found: list[str | Noise] = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += reader.feed(stream[start:end])
    assert found == sent


@given(st.binary(max_size=400), BODIES)
def test_after_any_noise_the_next_line_is_read(noise: bytes, body: str) -> None:
    reader = LineReader()
    reader.feed(noise + b"\n")
    assert reader.feed(framed(body)) == [body]


def test_every_line_with_one_changed_byte_is_noticed() -> None:
    random = Random(20261122)
    line = framed("#17 MOVE 0 -12345")
    for position in range(len(line) - 1):
        for value in random.sample(range(256), 40):
            changed = line[:position] + bytes([value]) + line[position + 1 :]
            if changed != line:
                assert bodies(LineReader().feed(changed)) == [], changed


def test_memory_stays_small_when_no_newline_ever_comes() -> None:
    reader = LineReader()
    for _ in range(1000):
        assert reader.feed(b"x" * 1000) == []
    assert reader.feed(b"\n" + framed("#1 PING"))[1:] == ["#1 PING"]


@pytest.mark.parametrize("body", ["a*b", "tab\t", "newline\n", "é", "x" * LINE_BYTES])
def test_what_cannot_be_a_line_is_not_sent(body: str) -> None:
    with pytest.raises(ValueError, match=r"codec|cannot be a line"):
        framed(body)
