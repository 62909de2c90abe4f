"""Size and completeness of JPEG pictures, without decoding."""

import cv2
import numpy as np
import pytest

from tests.unit.devices.cameras.pictures import make_jpegs
from twinline.devices.cameras.jpeg import is_whole_jpeg, jpeg_size

(PICTURE,) = make_jpegs(1, size=(50, 34))


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
@pytest.mark.parametrize("shape", [(34, 50, 3), (34, 50)])
def test_the_size_is_that_of_the_header(shape: tuple[int, ...], options: list[int]) -> None:
    picture = cv2.imencode(".jpg", np.zeros(shape, np.uint8), options)[1].tobytes()
    assert jpeg_size(picture) == (50, 34)
    assert is_whole_jpeg(picture)


def test_a_picture_cut_anywhere_is_not_whole() -> None:
    assert not [end for end in range(len(PICTURE)) if is_whole_jpeg(PICTURE[:end])]


def test_a_picture_that_breaks_off_where_another_begins_is_not_whole() -> None:
    # A long one: its beginning could be taken for a segment of 64 kB, and its end for the end of the first.
    (other,) = make_jpegs(1, size=(640, 480))
    assert len(other) > 2**16
    assert not is_whole_jpeg(PICTURE[:-40] + other)


def test_what_a_camera_appends_does_not_matter() -> None:
    assert is_whole_jpeg(PICTURE + b"\0" * 100)


def test_a_preview_inside_the_head_is_not_taken_for_the_picture() -> None:
    (preview,) = make_jpegs(1, size=(16, 8))
    segment = b"\xff\xe1" + (len(preview) + 2).to_bytes(2, "big") + preview
    assert jpeg_size(PICTURE[:2] + segment + PICTURE[2:]) == (50, 34)
    assert not is_whole_jpeg(PICTURE[:2] + segment + PICTURE[2:-2])


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xc0\x00\x11\x08", PICTURE[2:]])
def test_other_data_have_no_size(data: bytes) -> None:
    assert jpeg_size(data) is None
    assert not is_whole_jpeg(data)
