import stat
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from twinline.errors import CaptureError, OutputError
from twinline.recording.capture import open_capture
from twinline.recording.zip_file import unpack_capture


@pytest.fixture
def target(tmp_path: Path) -> Path:
    return tmp_path / "unpacked"


def make_zip(folder: Path, entries: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> Path:
    path = folder / "upload.zip"
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("inside", ["", "scan/", "a/b/"])
def test_a_capture_is_found_in_the_zip_or_in_its_folder(
    tmp_path: Path, target: Path, write_capture: Callable[..., Path], inside: str
) -> None:
    folder = write_capture(frames=3)
    files = {inside + str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    found = unpack_capture(make_zip(tmp_path, files | {"__MACOSX/._scan": b"x"}), target)
    assert found == (target / inside if inside else target)
    capture = open_capture(found)
    assert len(capture.laser or ()) == 3
    assert not (target / "__MACOSX").exists()


@pytest.mark.parametrize(
    "name",
    ["../evil.txt", "/evil.txt", "a/../../evil.txt", "C:/evil.txt", "..\\evil.txt", "a\nb", "/".join("abcdefghij")],
)
def test_names_that_lead_outside_are_refused(tmp_path: Path, target: Path, name: str) -> None:
    path = make_zip(tmp_path, {"capture.json": b"{}", name: b"x"})
    with pytest.raises(CaptureError, match=r"upload\.zip holds a file with the unsafe name"):
        unpack_capture(path, target)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["upload.zip"]


def test_links_are_refused(tmp_path: Path, target: Path) -> None:
    path = tmp_path / "upload.zip"
    with zipfile.ZipFile(path, "w") as archive:
        link = zipfile.ZipInfo("laser")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc")
        archive.writestr("laser/frames.csv", "x")
    with pytest.raises(CaptureError, match="'laser' is a link"):
        unpack_capture(path, target)
    assert not target.exists()


def test_the_size_limit_holds_for_what_comes_out(tmp_path: Path, target: Path) -> None:
    path = make_zip(tmp_path, {"capture.json": b"{}", "laser/bomb.png": bytes(5_000_000)})
    assert path.stat().st_size < 10_000
    with pytest.raises(CaptureError, match="unpacks to more than 1000000 bytes"):
        unpack_capture(path, target, max_bytes=1_000_000)
    assert not target.exists()


def test_an_archive_that_lies_about_its_sizes_is_damaged(tmp_path: Path, target: Path) -> None:
    path = make_zip(tmp_path, {"capture.json": bytes(5_000_000)})
    data = bytearray(path.read_bytes())
    directory = data.rfind(b"PK\x01\x02")
    struct.pack_into("<L", data, directory + 24, 10)
    path.write_bytes(data)
    with pytest.raises(CaptureError, match="damaged"):
        unpack_capture(path, target, max_bytes=1_000_000)
    assert not target.exists()


def test_the_number_of_files_is_limited(tmp_path: Path, target: Path) -> None:
    path = make_zip(tmp_path, {"capture.json": b"{}"} | {f"{i}.png": b"" for i in range(20)})
    with pytest.raises(CaptureError, match="more than 20 files"):
        unpack_capture(path, target, max_files=20)
    assert unpack_capture(path, target, max_files=21) == target


def test_a_huge_directory_is_refused_before_it_is_loaded(
    tmp_path: Path, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_zip(tmp_path, {"capture.json": b"{}"} | {f"{i:05d}.png": b"" for i in range(2000)})
    monkeypatch.setattr(zipfile, "ZipFile", lambda *_: pytest.fail("the directory was loaded"))
    with pytest.raises(CaptureError, match="more than 20 files"):
        unpack_capture(path, target, max_files=20)


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_damaged_data_are_an_error_and_leave_nothing(tmp_path: Path, target: Path, compression: int) -> None:
    path = make_zip(tmp_path, {"capture.json": bytes(range(256)) * 20}, compression)
    data = bytearray(path.read_bytes())
    data[60:80] = bytes(20)
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=r"upload\.zip is damaged: capture\.json"):
        unpack_capture(path, target)
    assert not target.exists()


def test_an_encrypted_archive_is_an_error(tmp_path: Path, target: Path) -> None:
    path = make_zip(tmp_path, {"capture.json": b"{}"})
    data = bytearray(path.read_bytes())
    for start, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.rfind(start) + offset] |= 1
    path.write_bytes(data)
    with pytest.raises(CaptureError, match="is encrypted"):
        unpack_capture(path, target)


@pytest.mark.parametrize("data", [b"", b"not a zip", b"PK\x05\x06", b"PK\x05\x06" + b"\xff" * 18])
def test_what_is_no_zip_is_an_error(tmp_path: Path, target: Path, data: bytes) -> None:
    (tmp_path / "upload.zip").write_bytes(data)
    with pytest.raises(CaptureError, match=r"upload\.zip"):
        unpack_capture(tmp_path / "upload.zip", target)
    assert not target.exists()


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"laser/0.png": b""}, r"holds no capture\.json"),
        ({"a/capture.json": b"{}", "b/capture.json": b"{}"}, "several captures"),
        ({"capture.json": b"{}", "./capture.json": b"{}"}, "twice"),
    ],
)
def test_there_must_be_one_capture(tmp_path: Path, target: Path, entries: dict[str, bytes], words: str) -> None:
    with pytest.raises(CaptureError, match=words):
        unpack_capture(make_zip(tmp_path, entries), target)
    assert not target.exists()


def test_a_folder_in_use_is_left_alone(tmp_path: Path, target: Path) -> None:
    target.mkdir()
    (target / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match="is not empty"):
        unpack_capture(make_zip(tmp_path, {"capture.json": b"{}"}), target)
    assert (target / "mine.txt").read_text() == "keep"
