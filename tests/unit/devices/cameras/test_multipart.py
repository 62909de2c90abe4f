"""The stream of an MJPEG camera, taken apart."""

from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.devices.cameras.pictures import make_jpegs
from twinline.devices.cameras.multipart import BrokenPart, MultipartParser, Part

PICTURES = make_jpegs(4, size=(48, 32))


def part(body: bytes, *, boundary: bytes = b"--frame", length: int | None = None, newline: bytes = b"\r\n") -> bytes:
    head = [boundary, b"Content-Type: image/jpeg"]
    if length is not None:
        head.append(b"Content-Length: %d" % length)
    return newline.join([*head, b"", body, b""])


def parse(pieces: Iterable[bytes], announced: str | None = "frame") -> list[Part | BrokenPart]:
    parser = MultipartParser(announced)
    return [found for number, piece in enumerate(pieces) for found in parser.feed(piece, float(number))]


def bodies(found: list[Part | BrokenPart]) -> list[bytes | None]:
    """The pictures; None where one was broken."""
    return [item.body if isinstance(item, Part) else None for item in found]


@pytest.mark.parametrize("newline", [b"\r\n", b"\n"])
@pytest.mark.parametrize("with_length", [True, False])
@pytest.mark.parametrize(
    ("announced", "sent"),
    [
        ("frame", b"--frame"),
        ("--frame", b"--frame"),
        ('"frame"', b"--frame"),
        ("frame", b"frame"),
        ("frame", b"--another"),
        (None, b"--another"),
        ("", b"----=_Part_7"),
    ],
)
def test_pictures_come_out_as_they_went_in(
    announced: str | None, sent: bytes, with_length: bool, newline: bytes
) -> None:
    stream = b"".join(
        part(picture, boundary=sent, length=len(picture) if with_length else None, newline=newline)
        for picture in PICTURES
    )
    assert bodies(parse([stream], announced)) == PICTURES


@given(
    cuts=st.lists(st.integers(0, sum(map(len, PICTURES)) + 400), max_size=30),
    lengths=st.lists(st.sampled_from(["right", "none", "short", "long"]), min_size=4, max_size=4),
)
def test_where_the_stream_is_cut_makes_no_difference(cuts: list[int], lengths: list[str]) -> None:
    stream = b"".join(
        part(
            picture,
            length={"right": len(picture), "none": None, "short": len(picture) // 2, "long": len(picture) + 200}[kind],
        )
        for picture, kind in zip(PICTURES, lengths, strict=True)
    )
    stream += b"--frame\r\n"
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    pieces = [stream[a:b] for a, b in pairwise(edges)]
    assert bodies(parse(pieces)) == PICTURES


def test_byte_by_byte_gives_the_same() -> None:
    stream = b"".join(part(picture, length=len(picture)) for picture in PICTURES)
    assert bodies(parse(bytes([byte]) for byte in stream)) == PICTURES


def test_a_picture_without_length_does_not_wait_for_the_next_one() -> None:
    assert bodies(parse([part(PICTURES[0])])) == [PICTURES[0]]


def test_a_truncated_picture_is_counted_and_the_rest_is_kept() -> None:
    cut = PICTURES[1][:-50]
    stream = part(PICTURES[0], length=len(PICTURES[0])) + part(cut, length=len(cut)) + part(PICTURES[2])
    found = parse([stream])
    assert bodies(found) == [PICTURES[0], None, PICTURES[2]]
    assert isinstance(found[1], BrokenPart)
    assert "truncated" in found[1].reason


def test_an_empty_part_and_text_in_place_of_a_picture_are_counted() -> None:
    stream = part(b"", length=0) + part(b"camera is busy") + part(PICTURES[0]) + b"--frame\r\n"
    assert bodies(parse([stream])) == [None, None, PICTURES[0]]


def test_rubbish_between_two_parts_is_counted_once() -> None:
    rubbish = bytes(range(200)) * 3
    stream = part(PICTURES[0], length=len(PICTURES[0])) + rubbish + b"\r\n" + part(PICTURES[1], length=len(PICTURES[1]))
    assert bodies(parse([stream])) == [PICTURES[0], None, PICTURES[1]]


def test_a_boundary_that_changes_on_the_way_loses_that_picture_only() -> None:
    stream = part(PICTURES[0], length=len(PICTURES[0])) + part(PICTURES[1], boundary=b"--other") + part(PICTURES[2])
    assert bodies(parse([stream])) == [PICTURES[0], None, PICTURES[2]]


def test_a_preview_inside_the_picture_is_not_its_end() -> None:
    preview = PICTURES[1]
    exif = b"\xff\xe1" + (len(preview) + 2).to_bytes(2, "big") + preview
    picture = PICTURES[0][:2] + exif + PICTURES[0][2:]
    stream = part(picture) + b"--frame\r\n"
    inside = stream.index(preview) + len(preview)
    assert bodies(parse([stream[:inside], stream[inside:]])) == [picture]


def test_the_boundary_inside_a_picture_does_not_end_it() -> None:
    comment = b"\xff\xfe" + (22).to_bytes(2, "big") + b" --frame\r\n\n--frames\n"
    picture = PICTURES[0][:2] + comment + PICTURES[0][2:]
    assert bodies(parse([part(picture, length=len(picture)) + part(picture) + b"--frame\r\n"])) == [picture, picture]


def test_a_head_without_an_end_is_given_up_and_counted() -> None:
    stream = b"--frame\r\n" + b"X-Nonsense: 1\r\n" * 2000 + part(PICTURES[0], length=len(PICTURES[0]))
    found = parse([stream[at : at + 4096] for at in range(0, len(stream), 4096)])
    assert bodies(found)[-1] == PICTURES[0]
    assert len(found) < 4


def test_a_part_arrives_with_the_first_byte_of_its_picture() -> None:
    head, body = part(PICTURES[0], length=len(PICTURES[0])).split(b"\r\n\r\n", 1)
    found = parse([head + b"\r\n", b"\r\n", body[:10], body[10:100], body[100:]])
    assert [item.arrival_s for item in found if isinstance(item, Part)] == [2.0]


def test_the_head_is_read_without_regard_to_capitals() -> None:
    stream = b"--frame\r\ncontent-LENGTH: %d\r\nX-TimeStamp: 12.500\r\n\r\n" % len(PICTURES[0]) + PICTURES[0]
    (found,) = parse([stream])
    assert isinstance(found, Part)
    assert found.headers == {"content-length": str(len(PICTURES[0])), "x-timestamp": "12.500"}


def test_a_stream_without_any_boundary_shows_in_the_bytes_that_wait() -> None:
    parser = MultipartParser("frame")
    assert parser.feed(b"\0" * 100_000, 0.0) == []
    assert parser.waiting_bytes == 100_000
