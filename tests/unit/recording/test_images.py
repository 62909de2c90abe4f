from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

from twinline.errors import FrameError
from twinline.recording.images import picture_size, read_image

NOISE = np.random.default_rng(20240607).integers(0, 256, (48, 64, 3)).astype(np.uint8)


def encoded(suffix: str, image: np.ndarray = NOISE) -> bytes:
    done, data = cv2.imencode(suffix, image)
    assert done
    return data.tobytes()


def exif(orientation: int) -> bytes:
    directory = (
        b"II*\0\x08\0\0\0" + b"\x01\0" + b"\x12\x01\x03\0\x01\0\0\0" + bytes([orientation, 0, 0, 0]) + b"\0\0\0\0"
    )
    body = b"Exif\0\0" + directory
    return b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body


class TestReadImage:
    def test_a_colour_picture_comes_as_blue_green_red(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(encoded(".png"))
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), NOISE)

    @pytest.mark.parametrize("suffix", [".png", ".jpg"])
    def test_a_grey_picture_stays_grey(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"a{suffix}"
        path.write_bytes(encoded(suffix, NOISE[:, :, 0]))
        assert read_image(path).shape == (48, 64)

    def test_transparency_is_dropped(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(encoded(".png", np.dstack([NOISE, NOISE[:, :, :1]])))
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), NOISE)

    def test_sixteen_bits_are_reduced_by_full_scale(self, tmp_path: Path) -> None:
        deep = np.array([[0, 257, 65535], [128, 129, 32768]], np.uint16)
        (tmp_path / "a.png").write_bytes(encoded(".png", deep))
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), [[0, 1, 255], [0, 1, 128]])

    def test_a_rotation_hint_is_not_applied(self, tmp_path: Path) -> None:
        data = encoded(".jpg")
        (tmp_path / "a.jpg").write_bytes(data[:2] + exif(6) + data[2:])
        assert read_image(tmp_path / "a.jpg").shape == (48, 64, 3)

    @pytest.mark.parametrize("suffix", [".png", ".jpg"])
    @pytest.mark.parametrize("left", [0.1, 0.5, 0.9, 0.999])
    def test_a_truncated_picture_is_an_error_that_says_so(self, tmp_path: Path, suffix: str, left: float) -> None:
        path = tmp_path / f"a{suffix}"
        data = encoded(suffix)
        path.write_bytes(data[: int(len(data) * left)])
        with pytest.raises(FrameError, match=rf"a{suffix} is truncated"):
            read_image(path)

    def test_a_preview_inside_a_truncated_jpeg_does_not_make_it_whole(self, tmp_path: Path) -> None:
        data, preview = encoded(".jpg"), encoded(".jpg", NOISE[:8, :8])
        segment = b"\xff\xe1" + (len(preview) + 2).to_bytes(2, "big") + preview
        (tmp_path / "a.jpg").write_bytes(data[:2] + segment + data[2:-200])
        with pytest.raises(FrameError, match="truncated"):
            read_image(tmp_path / "a.jpg")

    def test_bytes_after_the_end_of_a_jpeg_do_no_harm(self, tmp_path: Path) -> None:
        (tmp_path / "a.jpg").write_bytes(encoded(".jpg") + bytes(100))
        assert read_image(tmp_path / "a.jpg").shape == (48, 64, 3)

    @pytest.mark.parametrize(
        ("data", "words"),
        [
            (b"", "is empty"),
            (b"hello, this is text", "not a picture"),
            (b"\x89PNG\r\n\x1a\n" + b"IEND\xaeB`\x82", "not"),
        ],
    )
    def test_what_is_no_picture_is_an_error(self, tmp_path: Path, data: bytes, words: str) -> None:
        (tmp_path / "a.png").write_bytes(data)
        with pytest.raises(FrameError, match=words):
            read_image(tmp_path / "a.png")

    def test_a_missing_file_is_an_error_that_names_it(self, tmp_path: Path) -> None:
        with pytest.raises(FrameError, match=r"absent\.png cannot be read: No such file"):
            read_image(tmp_path / "absent.png")

    def test_floating_point_pictures_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "a.tif").write_bytes(encoded(".tif", NOISE.astype(np.float32)))
        with pytest.raises(FrameError, match="float32"):
            read_image(tmp_path / "a.tif")

    def test_a_header_that_claims_another_size_is_refused_before_decoding(self, tmp_path: Path) -> None:
        data = bytearray(encoded(".png"))
        data[16:24] = (1 << 20).to_bytes(4, "big") * 2
        (tmp_path / "a.png").write_bytes(data)
        with pytest.raises(FrameError, match="1048576 x 1048576 px, not 64 x 48 px"):
            read_image(tmp_path / "a.png", (64, 48))

    @pytest.mark.parametrize("where", range(2, 600, 37))
    def test_any_damage_gives_a_picture_or_a_frame_error(self, tmp_path: Path, where: int) -> None:
        for suffix in (".png", ".jpg"):
            data = bytearray(encoded(suffix))
            data[where : where + 8] = bytes(range(0xF8, 0x100))
            path = tmp_path / f"a{suffix}"
            path.write_bytes(data)
            with suppress(FrameError):
                assert read_image(path).dtype == np.uint8


class TestPictureSize:
    @pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp"])
    def test_it_is_that_of_the_picture(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"a{suffix}"
        path.write_bytes(encoded(suffix))
        assert picture_size(path) == (64, 48)

    def test_it_is_found_behind_a_long_profile(self, tmp_path: Path) -> None:
        data = encoded(".jpg")
        profile = b"\xff\xe2" + (60000).to_bytes(2, "big") + b"\xff\xc0" * 29999
        (tmp_path / "a.jpg").write_bytes(data[:2] + profile + data[2:])
        assert picture_size(tmp_path / "a.jpg") == (64, 48)

    def test_a_file_that_ends_before_its_size_is_an_error(self, tmp_path: Path) -> None:
        for suffix, length in ((".jpg", 20), (".png", 12)):
            path = tmp_path / f"a{suffix}"
            path.write_bytes(encoded(suffix)[:length])
            with pytest.raises(FrameError, match="truncated"):
                picture_size(path)

    def test_progressive_pictures_are_complete_and_sized(self, tmp_path: Path) -> None:
        done, data = cv2.imencode(".jpg", NOISE, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
        assert done
        (tmp_path / "a.jpg").write_bytes(data.tobytes() + b"\0")
        assert picture_size(tmp_path / "a.jpg") == (64, 48)
        assert read_image(tmp_path / "a.jpg").shape == (48, 64, 3)
