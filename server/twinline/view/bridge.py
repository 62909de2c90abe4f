"""viser behind our own port: its server without a socket, fed from Starlette WebSockets.

viser is no ASGI application: it opens a port of its own, without login, and lets any client ask for a public tunnel.
Here it is constructed with the function that would open that port replaced, so nothing is bound; its WebSocket handler
then serves connections that this module hands to it. Viewers are read-only: of what they send, only the
pose of their camera reaches viser.

This uses viser's internals. Its version is pinned, and `tests/integration/test_view.py` speaks its protocol.
"""

import asyncio
import contextlib
import threading
from collections.abc import Awaitable, Callable, Iterator
from importlib.resources import files
from types import SimpleNamespace
from typing import Any, Self

import msgspec
import rich
import viser
import websockets.asyncio.server
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState
from websockets.exceptions import ConnectionClosedOK

SUBPROTOCOL = f"viser-v{viser.__version__}"
ALLOWED_MESSAGES = frozenset({"ViewerCameraMessage"})
"""What a viewer may send; everything else is dropped, `ShareUrlRequest` above all."""

INCOMING_BACKLOG = 64
"""Messages of one viewer that wait for viser; a newer camera pose makes older ones worthless."""

# viser's own page, in the colours of the panel's stage and without viser's control panel and logo.
_STYLE = """<style>
html, body, #root { background: #0b0e13 !important; height: 100%; margin: 0; }
#root div:has(> * canvas), #root div:has(> canvas) { background-color: #0b0e13 !important; }
#root .mantine-Paper-root, .mantine-Notifications-root { display: none !important; }
</style>"""

Handler = Callable[["_Connection"], Awaitable[None]]


class ViewBridge:
    """A viser server that has no port.

    Attributes
    ----------
    server
        The viser server; its scene may be changed from any thread.
    """

    def __init__(self) -> None:
        with _quiet_console(), _without_socket() as captured:
            self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self._handler: Handler = captured["handler"]
        self._loop = self.server.get_event_loop()
        self._connections: set[_Connection] = set()
        self._page = _page()
        # Both the message that asks for it and the function behind it are out of reach.
        self.server.request_share_url = _no_share_url  # type: ignore[method-assign]

    def close(self) -> None:
        """End all connections and viser's threads."""
        for connection in tuple(self._connections):
            connection.end()
        with _quiet_console():
            self.server.stop()

    async def page(self, _: Request) -> Response:
        """viser's page."""
        return HTMLResponse(self._page)

    async def websocket(self, socket: WebSocket) -> None:
        """Serve one viewer until it leaves."""
        if SUBPROTOCOL not in socket.scope.get("subprotocols", []):
            # The viewer's page is of another version of viser: a reload brings the right one.
            await socket.close(code=1002, reason=f"Reload the page: this server speaks {SUBPROTOCOL}.")
            return
        await socket.accept(subprotocol=SUBPROTOCOL)
        connection = _Connection(socket, asyncio.get_running_loop(), self._loop)
        self._connections.add(connection)
        serving = asyncio.wrap_future(asyncio.run_coroutine_threadsafe(_serve(self._handler, connection), self._loop))
        reading = asyncio.create_task(connection.read())
        try:
            await asyncio.wait({serving, reading}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._connections.discard(connection)
            connection.end()
            reading.cancel()
            await asyncio.gather(serving, reading, return_exceptions=True)
        if socket.client_state is WebSocketState.CONNECTED and socket.application_state is WebSocketState.CONNECTED:
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await socket.close(code=1001)


class _Connection:
    """What viser's handler needs of a ``websockets`` connection; its methods run in viser's loop, except `read`."""

    subprotocol = SUBPROTOCOL

    def __init__(
        self, socket: WebSocket, app_loop: asyncio.AbstractEventLoop, viser_loop: asyncio.AbstractEventLoop
    ) -> None:
        self._socket = socket
        self._app_loop = app_loop
        self._viser_loop = viser_loop
        self._incoming: asyncio.Queue[bytes] = asyncio.Queue(INCOMING_BACKLOG)
        self._ended = asyncio.Event()

    async def send(self, data: bytes) -> None:
        """Send, and wait until the viewer has room: viser then merges what piles up."""
        sending = asyncio.run_coroutine_threadsafe(self._socket.send_bytes(data), self._app_loop)
        try:
            await asyncio.wrap_future(sending)
        except (WebSocketDisconnect, RuntimeError, OSError):
            raise ConnectionClosedOK(None, None) from None

    async def recv(self) -> bytes:
        """The next message of the viewer."""
        getting = asyncio.create_task(self._incoming.get())
        ending = asyncio.create_task(self._ended.wait())
        try:
            await asyncio.wait({getting, ending}, return_when=asyncio.FIRST_COMPLETED)
            if not self._ended.is_set():
                return getting.result()
        finally:
            getting.cancel()
            ending.cancel()
        raise ConnectionClosedOK(None, None)

    async def close(self, code: int = 1000, reason: str = "") -> None:
        """End the connection."""
        self._ended.set()

    def end(self) -> None:
        """End the connection, from any thread."""
        with contextlib.suppress(RuntimeError):  # viser's loop may be closed already
            self._viser_loop.call_soon_threadsafe(self._ended.set)

    async def read(self) -> None:
        """Pass on what the viewer may say until it leaves; runs in the application's loop."""
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("bytes")
            if data is not None and _is_allowed(data):
                self._viser_loop.call_soon_threadsafe(self._take, data)

    def _take(self, data: bytes) -> None:
        if self._incoming.full():
            self._incoming.get_nowait()
        self._incoming.put_nowait(data)


class _NoSocket:
    """Stands for ``websockets.asyncio.server.serve`` while viser starts: keeps the handler and binds nothing."""

    def __init__(self, captured: dict[str, Any], handler: Handler) -> None:
        captured["handler"] = handler
        self.server = SimpleNamespace(sockets=())

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        return None


_patching = threading.Lock()


@contextlib.contextmanager
def _without_socket() -> Iterator[dict[str, Any]]:
    captured: dict[str, Any] = {}
    with _patching:
        original = websockets.asyncio.server.serve
        replacement: Any = lambda handler, *_, **__: _NoSocket(captured, handler)  # noqa: E731
        websockets.asyncio.server.serve = replacement  # type: ignore[misc]
        try:
            yield captured
        finally:
            websockets.asyncio.server.serve = original  # type: ignore[misc]


@contextlib.contextmanager
def _quiet_console() -> Iterator[None]:
    # viser announces ports on standard output that do not exist here.
    console = rich.get_console()
    before = console.quiet
    console.quiet = True
    try:
        yield
    finally:
        console.quiet = before


async def _serve(handler: Handler, connection: _Connection) -> None:
    await handler(connection)


def _is_allowed(data: bytes) -> bool:
    try:
        message = msgspec.msgpack.decode(data)
    except msgspec.DecodeError:
        return False
    return isinstance(message, dict) and message.get("type") in ALLOWED_MESSAGES


def _no_share_url(verbose: bool = True) -> str | None:
    return None


def _page() -> str:
    page = files("viser").joinpath("client/build/index.html").read_text(encoding="utf-8")
    return page.replace("</head>", f"{_STYLE}</head>", 1).replace("<title>Viser</title>", "<title>3-D view</title>")
