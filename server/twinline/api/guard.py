"""What stands between the network and the application: whose requests are taken, and what browsers are told.

There is no login yet, so any page that a browser of this machine shows could try to give commands. Two checks stop
it: the Host header must name this machine (a foreign name that was made to resolve to 127.0.0.1 is refused), and
a request that changes something, or opens a WebSocket, must come from a page of this very server.
"""

from collections.abc import Mapping
from types import MappingProxyType
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from twinline.api.problems import problem
from twinline.settings import is_loopback

SMALL_BODY_BYTES = 8 * 2**20
"""Limit of every request body but uploads, which stream to disk under a limit of their own."""
UPLOAD_TYPES = frozenset({"application/zip", "application/x-zip-compressed", "application/octet-stream"})

_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})

_COMMON = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}
_PANEL_POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; worker-src 'self' blob:; "
    "frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'; object-src 'none'"
)
# viser's page is one file that unpacks itself: scripts, styles, fonts and workers are all inside it, and the glue of
# its WebAssembly makes functions from text.
_VIEW_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob: data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; connect-src 'self' data: blob:; worker-src blob: data:; "
    "frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)
_DOWNLOAD_POLICY = "default-src 'none'; frame-ancestors 'none'; sandbox"
HEADERS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "/api/": {"Content-Security-Policy": _DOWNLOAD_POLICY, "X-Frame-Options": "DENY"},
        "/view": {"Content-Security-Policy": _VIEW_POLICY, "X-Frame-Options": "SAMEORIGIN"},
        "/": {"Content-Security-Policy": _PANEL_POLICY, "X-Frame-Options": "DENY"},
    }
)
"""Security headers by the beginning of the path; the first that fits counts."""


class Guard:
    """ASGI middleware; the outermost one."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer what is refused; pass on the rest."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = _refusal(scope, headers)
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                await WebSocket(scope, receive, send).close(code=1008, reason=refusal[1])
            return
        guarded = _with_headers(send, _headers_of(scope["path"]))
        if refusal is not None:
            await problem(403, *refusal)(scope, receive, guarded)
            return
        content_type = headers.get("content-type", "").partition(";")[0].strip().lower()
        limited = receive if content_type in UPLOAD_TYPES else _with_limit(receive)
        await self._app(scope, limited, guarded)


def _refusal(scope: Scope, headers: Headers) -> tuple[str, str] | None:
    """Code and detail of why a request is not taken; None for one that is."""
    host = headers.get("host", "")
    if not is_loopback(_host_name(host)):
        return "foreign-host", f"This server answers to localhost and 127.0.0.1 only, not to {host[:100]!r}."
    changes = scope["type"] == "websocket" or scope["method"] not in _SAFE_METHODS
    if not changes:
        return None
    origin = headers.get("origin")
    scheme = {"ws": "http", "wss": "https"}.get(scope["scheme"], scope["scheme"])
    # Browsers always send the origin with such requests; scripts and curl send none.
    if origin is not None and origin != f"{scheme}://{host}":
        return "foreign-origin", f"A page of {origin[:100]!r} may not give commands here; use the server's own page."
    if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
        return "foreign-origin", "Another page may not give commands here; use the server's own page."
    return None


def _host_name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _headers_of(path: str) -> Mapping[str, str]:
    return _COMMON | next(dict(values) for start, values in HEADERS.items() if path.startswith(start))


def _with_headers(send: Send, extra: Mapping[str, str]) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in extra.items():
                headers.setdefault(name, value)
        await send(message)

    return sending


def _with_limit(receive: Receive) -> Receive:
    received = 0

    async def receiving() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > SMALL_BODY_BYTES:
            raise HTTPException(413, f"The request is larger than {SMALL_BODY_BYTES} bytes.")
        return message

    return receiving
