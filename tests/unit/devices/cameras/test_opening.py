"""Choosing the kind of camera by its address."""

import sys
from pathlib import Path

import pytest

from twinline.devices.cameras.opening import open_camera
from twinline.devices.cameras.settings import CameraSettings
from twinline.errors import CameraError, SettingsError


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("ftp://camera/stream", "no kind of camera for ftp"),
        ("uvc:", "uvc:0"),
        ("uvc:front", "uvc:0"),
        ("http:///stream", "host"),
        ("rtsp://camera:port/", "cannot be read"),
    ],
)
def test_an_address_of_no_camera_is_refused_at_once(url: str, words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        open_camera(url)


def test_without_the_package_for_rtsp_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.delitem(sys.modules, "twinline.devices.cameras.rtsp", raising=False)
    monkeypatch.delitem(sys.modules, "twinline.devices.cameras.decoding", raising=False)
    with pytest.raises(SettingsError, match=r"install twinline\[rtsp\]"):
        open_camera("rtsp://camera/live")


async def test_a_path_that_is_not_there_is_named_when_it_is_opened(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=r"nothing\.mp4 cannot be read: No such file or directory"):
        await open_camera(str(tmp_path / "nothing.mp4")).open()


async def test_a_folder_without_pictures_says_so(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("none")
    with pytest.raises(CameraError, match="holds no PNG or JPEG pictures"):
        await open_camera(str(tmp_path)).open()


def test_all_wrong_settings_are_named_together() -> None:
    with pytest.raises(SettingsError) as caught:
        CameraSettings("uvc:0", latency_s=-1.0, queue_frames=0, retry_s=(1.0, 0.5))
    assert all(name in caught.value.detail for name in ("latency_s is -1 s", "queue_frames is 0", "retry_s is 0.5 s"))


def test_settings_do_not_show_the_password() -> None:
    assert "secret" not in repr(CameraSettings("rtsp://user:secret@camera/"))
