"""Addresses of network cameras, and what is said when they do not answer."""

import socket
import ssl

import pytest

from twinline.devices.cameras.address import explain, parse_address
from twinline.errors import SettingsError, TwinlineError

CAMERA = parse_address("rtsp://camera.local/live?channel=1")


def test_user_and_password_are_decoded_and_never_shown() -> None:
    address = parse_address("rtsp://ad%40min:p%3Ass@camera:8554/live")
    assert (address.user, address.password) == ("ad@min", "p:ss")
    assert (address.host, address.port, address.target) == ("camera", 8554, "/live")
    assert str(address) == "rtsp://camera:8554/live"
    assert "p:ss" not in repr(address)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("http://camera", "http://camera:80/"),
        ("https://camera/x?y=1", "https://camera:443/x?y=1"),
        ("rtsp://[fe80::1]/live", "rtsp://[fe80::1]:554/live"),
    ],
)
def test_what_is_left_out_is_filled_in(url: str, shown: str) -> None:
    assert str(parse_address(url)) == shown


@pytest.mark.parametrize(
    "url", ["http://", "http://user:secret@", "ftp://user:secret@camera/", "http://user:secret@camera:99999/",
            "http://user:secret@camera/a b", "http://user:secret@camera/a\r\nX-Evil: 1", "http://user:secret@[::1/"]
)  # fmt: skip
def test_an_address_that_cannot_be_used_is_refused_without_repeating_the_password(url: str) -> None:
    with pytest.raises(SettingsError) as caught:
        parse_address(url)
    assert "secret" not in caught.value.detail
    assert caught.value.detail.endswith(".")


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (socket.gaierror(-2, "Name or service not known"), "camera-disconnected", "cannot be resolved"),
        (ConnectionRefusedError(111, "Connection refused"), "camera-disconnected", "nothing listens"),
        (TimeoutError(), "camera-timeout", "within 5 s"),
        (ssl.SSLError(1, "wrong version number"), "camera-disconnected", "TLS"),
        (ConnectionResetError(104, "Connection reset by peer"), "camera-disconnected", "closed the connection"),
        (OSError(113, "No route to host"), "camera-disconnected", "no route to host"),
    ],
)
def test_each_failure_names_camera_cause_and_next_step(error: OSError, code: str, words: str) -> None:
    explained: TwinlineError = explain(error, CAMERA, 5.0)
    assert explained.code == code
    assert "rtsp://camera.local:554/live?channel=1" in explained.detail
    assert words in explained.detail
