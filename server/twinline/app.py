"""The composition root: the only place that picks implementations, and the server around them."""

import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

import anyio
import structlog
import uvicorn
from anyio import CapacityLimiter, to_thread
from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from twinline.api.application import build_api
from twinline.api.context import ApiContext
from twinline.api.panel_files import PanelMount
from twinline.errors import SettingsError
from twinline.operations.clock import Clock, SystemClock
from twinline.operations.toolbox import Toolbox
from twinline.operations.workers import WorkerPool
from twinline.operations.workshop import Workshop
from twinline.settings import Settings
from twinline.view.bridge import ViewBridge
from twinline.view.stage import Stage

GRACE_S = 5
"""Requests that still run so many seconds after Ctrl-C are cut off."""
MAX_WEBSOCKET_BYTES = 2**20
"""Viewers send camera poses only."""
PRELOAD = ("twinline.reconstruction.offline", "twinline.devices.simulator.capture")
"""Modules that worker processes share from their start."""


def real_toolbox(settings: Settings) -> Toolbox:
    """The implementations that a server works with."""
    from twinline.devices.simulator.capture import render_capture
    from twinline.operations.exports.glb import write_glb
    from twinline.operations.exports.ply import write_ply
    from twinline.operations.scans import GLB_FILE, PLY_FILE
    from twinline.reconstruction.offline import reconstruct
    from twinline.reconstruction.result import ReconstructionOptions
    from twinline.recording.capture import open_capture
    from twinline.recording.rig_file import read_rig
    from twinline.recording.zip_file import unpack_capture
    from twinline.stripe import METHODS

    return Toolbox(
        open_capture=open_capture,
        read_rig=read_rig,
        unpack=partial(unpack_capture, max_bytes=settings.unpacked_max_bytes, max_files=settings.unpacked_max_files),
        reconstruct=reconstruct,
        render=render_capture,
        writers={PLY_FILE: write_ply, GLB_FILE: write_glb},
        methods=tuple(METHODS),
        default_method=ReconstructionOptions().method,
        scenes={
            "three-objects": "prism, sphere and cylinder",
            "five-pieces": "five wooden pieces",
            "steps": "blocks of five heights",
            "sphere": "sphere",
            "relief": "face in low relief",
            "board": "calibration board",
        },
    )


def create_app(settings: Settings, *, toolbox: Toolbox | None = None, clock: Clock | None = None) -> FastAPI:
    """Put the server together; nothing runs before its lifespan begins.

    Parameters
    ----------
    toolbox, clock
        The real ones unless given.
    """
    time = clock or SystemClock()
    tools = toolbox or real_toolbox(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        bridge = await to_thread.run_sync(ViewBridge)
        workers = WorkerPool(settings.worker_count, PRELOAD)
        try:
            stage = Stage(bridge.server, time, max_points=settings.view_max_points)
            workshop = Workshop(settings.data_dir, tools, workers, stage, time)
            await to_thread.run_sync(workshop.restore)
            app.state.bridge = bridge
            app.state.context = ApiContext(workshop, settings.upload_max_bytes, settings.data_dir, time.now())
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(partial(to_thread.run_sync, workshop.run, limiter=CapacityLimiter(1)))
                try:
                    yield
                finally:
                    workshop.close()
        finally:
            workers.shutdown(wait=False)
            await to_thread.run_sync(bridge.close)

    app = build_api(lifespan)
    app.router.routes += [
        Route("/view", _to_view_page),
        Route("/view/", _view_page),
        WebSocketRoute("/view", _view_websocket),
        PanelMount(),
    ]
    return app


def serve(settings: Settings) -> None:
    """Run the server until Ctrl-C or a termination signal.

    Raises
    ------
    SettingsError
        If its address cannot be used.
    OutputError
        If its data folder cannot be made.
    """
    _log_plainly()
    listener = _listen(settings)
    app = create_app(settings)
    config = uvicorn.Config(
        app,
        log_level="warning",
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=GRACE_S,
        ws_max_size=MAX_WEBSOCKET_BYTES,
        ws_per_message_deflate=False,
    )
    try:
        _Server(config, app).run(sockets=[listener])
    except KeyboardInterrupt:
        pass
    finally:
        listener.close()


def _log_plainly() -> None:
    """Log to stderr; a traceback shows code, never values: these hold paths and whole arrays."""
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
            ),
        ],
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )


class _Server(uvicorn.Server):
    """Says where it is once it answers, and ends event streams before it waits for them."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started and sockets:
            host, port = sockets[0].getsockname()[:2]
            sys.stdout.write(f"Twinline is ready: http://{f'[{host}]' if ':' in host else host}:{port}\n")
            sys.stdout.flush()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        context = getattr(self._app.state, "context", None)
        if isinstance(context, ApiContext):
            context.workshop.feed.close()
        await super().shutdown(sockets)


def _listen(settings: Settings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family, backlog=128)
    except OSError as error:
        raise SettingsError(
            f"The server cannot listen on {settings.host} port {settings.port}: {error.strerror or error}; "
            "stop the other program or choose another port (TWINLINE_PORT)."
        ) from error


async def _to_view_page(_: Request) -> Response:
    return RedirectResponse("/view/")


async def _view_page(request: Request) -> Response:
    return await _bridge_of(request.app).page(request)


async def _view_websocket(socket: WebSocket) -> None:
    await _bridge_of(socket.app).websocket(socket)


def _bridge_of(app: FastAPI) -> ViewBridge:
    bridge = app.state.bridge
    assert isinstance(bridge, ViewBridge)
    return bridge
