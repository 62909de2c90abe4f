"""viser behind our port, spoken to in its own protocol: what the pinned version promises, the bridge relies on."""

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import msgspec
import numpy as np
import psutil
import pytest
import uvicorn
import zstandard
from fastapi import FastAPI
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Subprotocol

from tests.unit.operations.fakes import fake_toolbox, some_points
from twinline.app import create_app
from twinline.settings import Settings
from twinline.view.bridge import SUBPROTOCOL, ViewBridge


async def until(condition: Callable[[], object]) -> None:
    """Wait for something that tells nobody when it happens."""
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.01)


@asynccontextmanager
async def served(app: FastAPI) -> AsyncIterator[str]:
    """The address at which an application is served on a free port."""
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws_per_message_deflate=False))
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    await until(lambda: server.started)
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        app.state.context.workshop.feed.close()
        server.should_exit = True
        await serving
        listener.close()


@pytest.fixture
async def app(tmp_path: Path) -> FastAPI:
    return create_app(Settings(data_dir=tmp_path, workers=1), toolbox=fake_toolbox())


@pytest.fixture
async def address(app: FastAPI) -> AsyncIterator[str]:
    async with served(app) as address:
        yield address


def viewer(address: str, subprotocol: str = SUBPROTOCOL, **options: Any) -> connect:
    """A connection as viser's page opens it."""
    options = {"origin": f"http://{address}", "max_size": None} | options
    return connect(f"ws://{address}/view", subprotocols=[Subprotocol(subprotocol)], **options)


def decoded(data: str | bytes) -> tuple[list[dict[str, Any]], list[bytes]]:
    """Messages of one window and the buffers that they refer to."""
    assert isinstance(data, bytes)
    size, packed_size = (int.from_bytes(data[start : start + 8], "little") for start in (0, 8))
    inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed_size], max_output_size=size)
    window = msgspec.msgpack.decode(inner)
    buffers, offset = [], 16 + packed_size
    for length in window["binaryBufferLengths"]:
        offset += -offset % 8
        buffers.append(data[offset : offset + length])
        offset += length
    return window["messages"], buffers


def points_of(messages: list[dict[str, Any]], buffers: list[bytes]) -> list[np.ndarray]:
    """Point clouds among the messages, in the bed frame; viser sends the origin as a message of its own."""
    origins = {m["name"]: np.array(m["position"]) for m in messages if m["type"] == "SetPositionMessage"}
    clouds = []
    for message in messages:
        if message["type"] == "PointCloudMessage":
            place = message["props"]["points"]
            points = np.frombuffer(buffers[place["__binary_index"]], place["dtype"]).reshape(-1, 3)
            clouds.append(points.astype(float) + origins[message["name"]])
    return clouds


async def receive_cloud(connection: ClientConnection) -> list[np.ndarray]:
    while True:
        clouds = points_of(*decoded(await asyncio.wait_for(connection.recv(), 20)))
        if clouds:
            return clouds


def camera_pose() -> bytes:
    """What viser's page sends when the camera moves."""
    message = {
        "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 500], "fov": 0.8, "near": 1.0,
        "far": 1000.0, "image_height": 400, "image_width": 600, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
    }  # fmt: skip
    return msgspec.msgpack.encode(message)


async def test_a_viewer_receives_the_points_that_were_measured(app: FastAPI, address: str) -> None:
    cloud = some_points(500)
    async with viewer(address) as connection:
        assert connection.subprotocol == SUBPROTOCOL
        await connection.send(camera_pose())
        display = app.state.context.workshop
        await asyncio.to_thread(display._display.append, cloud)
        (points,) = await receive_cloud(connection)
    np.testing.assert_allclose(points, cloud.points_mm, atol=2e-5)


async def test_who_comes_later_receives_the_whole_cloud(app: FastAPI, address: str) -> None:
    async with httpx.AsyncClient(base_url=f"http://{address}") as client:
        await client.post("/api/v1/jobs", json={"kind": "demo"})
        await until(lambda: app.state.context.workshop.view().scan_id)
    async with viewer(address) as first, viewer(address) as second:
        for connection in (first, second):
            assert sum(len(points) for points in await receive_cloud(connection)) == 200


async def test_what_viewers_must_not_do_is_dropped_and_they_stay_connected(app: FastAPI, address: str) -> None:
    bridge: ViewBridge = app.state.bridge
    reached: list[str] = []
    handlers = bridge.server._websock_server._incoming_handlers
    for kind in list(handlers):
        handlers[kind] = [lambda _, message: reached.append(type(message).__name__)]
    forbidden: list[dict[str, Any]] = [
        {"type": "ShareUrlRequest"},
        {"type": "ShareUrlDisconnect"},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {}},
        {"type": "NoSuchMessage"},
    ]
    async with viewer(address) as connection:
        for message in forbidden:
            await connection.send(msgspec.msgpack.encode(message))
        await connection.send(b"\xc1 no msgpack")
        await connection.send("text")
        await connection.send(camera_pose())
        await until(bridge.server.get_clients)
        await connection.send(camera_pose())
    assert not reached
    assert bridge.server.request_share_url() is None


async def test_another_version_of_the_page_and_other_pages_are_refused(address: str) -> None:
    with pytest.raises((InvalidStatus, ConnectionClosed)):
        async with viewer(address, "viser-v0.0.1") as connection:
            await connection.recv()
    with pytest.raises(InvalidStatus):
        async with viewer(address, origin="http://evil.example"):
            pass


async def test_a_viewer_that_lost_the_cloud_is_brought_back_on_request(app: FastAPI, address: str) -> None:
    async with viewer(address) as connection, httpx.AsyncClient(base_url=f"http://{address}") as client:
        await connection.send(camera_pose())
        await until(app.state.bridge.server.get_clients)
        messages: list[dict[str, Any]] = []
        assert (await client.put("/api/v1/view", json={"reset_cameras": True})).status_code == 200
        while not [m for m in messages if m["type"] == "SetCameraPositionMessage" and not m["initial"]]:
            messages, _ = decoded(await asyncio.wait_for(connection.recv(), 20))


async def test_leaving_viewers_are_forgotten(app: FastAPI, address: str) -> None:
    bridge: ViewBridge = app.state.bridge
    for _ in range(3):
        async with viewer(address) as connection:
            await connection.send(camera_pose())
            await connection.recv()
    await until(lambda: not bridge.server._websock_server._client_state_from_id and not bridge._connections)
    assert not bridge.server.get_clients()


async def test_the_view_opens_no_port_of_its_own(address: str) -> None:
    listening = [c.laddr.port for c in psutil.Process().net_connections() if c.status == psutil.CONN_LISTEN]
    assert listening == [int(address.rpartition(":")[2])]


async def test_its_page_is_served_with_nothing_from_elsewhere(address: str) -> None:
    async with httpx.AsyncClient(base_url=f"http://{address}") as client:
        page = await client.get("/view/")
    assert page.status_code == 200
    assert "text/html" in page.headers["content-type"]
    assert 'src="http' not in page.text
