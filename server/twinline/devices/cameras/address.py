"""A network camera's address: its parts, its password kept out of sight, and what a failed connection means."""

import socket
import ssl
from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit

from twinline.errors import CameraError, SettingsError

_DEFAULT_PORTS = {"http": 80, "https": 443, "rtsp": 554, "rtsps": 322}


@dataclass(frozen=True, slots=True)
class Address:
    """The parts of a camera's address.

    Attributes
    ----------
    scheme, host, port
        Where it is.
    target
        Path and query, as sent to the camera.
    user, password
        As given in the address, decoded; empty if there are none.
    """

    scheme: str
    host: str
    port: int
    target: str
    user: str = ""
    password: str = field(default="", repr=False)

    @property
    def place(self) -> str:
        """``host:port``, as one writes it."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def __str__(self) -> str:
        """The address without user and password, for messages."""
        return f"{self.scheme}://{self.place}{self.target}"


def parse_address(url: str) -> Address:
    """Take an address apart.

    Raises
    ------
    SettingsError
        If it has no host or an impossible port; the message does not repeat the address, which may hold a password.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
        host = parts.hostname
    except ValueError as error:
        raise SettingsError(
            f"The camera's address cannot be read ({error}): write it as http://host:port/path."
        ) from None
    if not host or parts.scheme not in _DEFAULT_PORTS:
        raise SettingsError(
            f"The camera's address needs {', '.join(sorted(_DEFAULT_PORTS))} and a host: write it as rtsp://host/path."
        )
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    if not target.isascii() or not target.isprintable() or " " in target:
        raise SettingsError("The path in the camera's address holds blanks or special letters: write them as %20 etc.")
    return Address(
        scheme=parts.scheme,
        host=host,
        port=port or _DEFAULT_PORTS[parts.scheme],
        target=target,
        user=unquote(parts.username or ""),
        password=unquote(parts.password or ""),
    )


def explain(error: OSError, address: Address, patience_s: float) -> CameraError:
    """Say what a failed connection means, and what to do.

    Parameters
    ----------
    patience_s
        How long was waited.
    """
    if isinstance(error, socket.gaierror):
        cause = f"the name {address.host} cannot be resolved; check the address, or use the camera's IP number"
    elif isinstance(error, ConnectionRefusedError):
        cause = f"nothing listens at {address.place}; check the port, and that the camera's stream is switched on"
    elif isinstance(error, TimeoutError):
        cause = f"it did not answer within {patience_s:g} s; check its power, the cable and the address"
    elif isinstance(error, ssl.SSLCertVerificationError):
        cause = f"its certificate is not trusted ({error.verify_message}); use http, or add it to SSL_CERT_FILE"
    elif isinstance(error, ssl.SSLError):
        cause = "it does not speak TLS properly; use http instead of https, or check the port"
    elif isinstance(error, ConnectionError):
        cause = "it closed the connection; see whether it allows another viewer, or restart it"
    else:
        cause = f"{(error.strerror or str(error) or type(error).__name__).lower()}; check the network and the address"
    code = "camera-timeout" if isinstance(error, TimeoutError) else "camera-disconnected"
    return CameraError(f"No pictures from {address}: {cause}.", code=code)
