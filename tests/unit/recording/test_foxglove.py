"""The pictures' wire format, against bytes that protobuf's own implementation gave for the published schemas."""

import pytest

from twinline.recording import foxglove

COMPRESSED = bytes.fromhex("0a0908b96010f2eb9cc30312066162636162631a046a706567220663616d657261")
RAW = bytes.fromhex("0a02100515020000001d020000002204626772382d06000000320c0101010101010101010101013a0663616d657261")


def test_a_compressed_image_is_what_the_official_implementation_writes() -> None:
    assert foxglove.compressed_image(12345_946_288_114, b"abcabc", "jpeg", "camera") == COMPRESSED


def test_a_raw_image_is_what_the_official_implementation_writes() -> None:
    assert foxglove.raw_image(5, b"\1" * 12, (2, 2), "bgr8", "camera") == RAW


@pytest.mark.parametrize(("schema", "message"), [(foxglove.COMPRESSED, COMPRESSED), (foxglove.RAW, RAW)])
def test_the_data_are_found_in_a_message(schema: str, message: bytes) -> None:
    extent = foxglove.find_data(schema, message)
    assert extent is not None
    data = message[extent.offset : extent.offset + extent.length]
    assert data == (b"abcabc" if schema == foxglove.COMPRESSED else b"\1" * 12)


@pytest.mark.parametrize("length", [0, 1, 127, 128, 20_000, 3_000_000])
def test_the_data_are_found_from_the_head_alone(length: int) -> None:
    message = foxglove.compressed_image(10**18, bytes(length), "jpeg", "camera")
    extent = foxglove.find_data(foxglove.COMPRESSED, message[: foxglove.HEAD_BYTES])
    assert extent is not None
    assert extent.length == length
    assert message[extent.offset : extent.offset + length] == bytes(length)


@pytest.mark.parametrize("head", [b"", b"\xff" * 40, b"\x0a\x05abc", b"\x08", b"\x0b\x00"])
def test_a_head_that_makes_no_sense_has_no_data(head: bytes) -> None:
    assert foxglove.find_data(foxglove.COMPRESSED, head) is None


def test_the_schema_names_its_message_and_what_it_needs() -> None:
    schema = foxglove.schema_of(foxglove.COMPRESSED)
    for word in (
        b"foxglove",
        b"CompressedImage",
        b"google/protobuf/timestamp.proto",
        b"Timestamp",
        b"proto3",
        b"frame_id",
    ):
        assert word in schema
