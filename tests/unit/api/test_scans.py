from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from tests.unit.api.conftest import HOST
from tests.unit.api.steps import assert_problem, until_ended
from tests.unit.operations.fakes import fake_toolbox
from twinline.app import create_app
from twinline.settings import Settings


@pytest.fixture
async def scan(client: httpx.AsyncClient) -> dict[str, Any]:
    job = (await client.post("/api/v1/jobs", json={"kind": "demo"})).json()
    scan_id = (await until_ended(client, job["id"]))["outcome"]["scan_id"]
    found: dict[str, Any] = (await client.get(f"/api/v1/scans/{scan_id}")).json()
    return found


async def test_parts_of_a_file_can_be_asked_for(client: httpx.AsyncClient, scan: dict[str, Any]) -> None:
    url = scan["files"][0]["url"]
    whole = (await client.get(url)).content
    part = await client.get(url, headers={"Range": "bytes=10-19"})
    assert (part.status_code, part.content) == (206, whole[10:20])
    assert part.headers["content-range"] == f"bytes 10-19/{len(whole)}"
    beyond = await client.get(url, headers={"Range": f"bytes={len(whole)}-"})
    assert beyond.status_code == 416


async def test_a_file_that_is_known_already_is_not_sent_again(client: httpx.AsyncClient, scan: dict[str, Any]) -> None:
    url = scan["files"][0]["url"]
    etag = (await client.get(url)).headers["etag"]
    again = await client.get(url, headers={"If-None-Match": etag})
    assert (again.status_code, again.content) == (304, b"")
    assert (await client.get(url, headers={"If-None-Match": '"other"'})).status_code == 200


async def test_head_gives_the_size_without_the_file(client: httpx.AsyncClient, scan: dict[str, Any]) -> None:
    file = scan["files"][1]
    head = await client.head(file["url"])
    assert (head.status_code, head.content, head.headers["content-length"]) == (200, b"", str(file["bytes"]))


@pytest.mark.parametrize("name", ["scan.json", "..%2Fscan.json", "cloud.stl"])
async def test_other_files_of_a_scan_are_not_served(client: httpx.AsyncClient, scan: dict[str, Any], name: str) -> None:
    assert_problem(await client.get(f"/api/v1/scans/{scan['id']}/exports/{name}"), 404, "not-found")


async def test_a_deleted_scan_leaves_the_view_and_the_disk(
    client: httpx.AsyncClient, scan: dict[str, Any], settings: Settings
) -> None:
    assert (await client.get("/api/v1/view")).json()["scan_id"] == scan["id"]
    assert (await client.delete(f"/api/v1/scans/{scan['id']}")).status_code == 204
    view = (await client.get("/api/v1/view")).json()
    assert (view["scan_id"], view["points"]) == (None, 0)
    assert_problem(await client.get(f"/api/v1/scans/{scan['id']}"), 404, "not-found")
    assert list((settings.data_dir / "scans").iterdir()) == []


async def test_another_server_on_the_same_folder_knows_the_scan_and_can_show_it(
    app: FastAPI, settings: Settings, scan: dict[str, Any]
) -> None:
    second = create_app(settings, toolbox=fake_toolbox())
    async with second.router.lifespan_context(second):
        transport = httpx.ASGITransport(app=second)
        async with httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}") as client:
            assert (await client.get("/api/v1/scans")).json() == {"scans": [scan]}
            assert (await client.get("/api/v1/view")).json()["points"] == 0
            shown = (await client.put("/api/v1/view", json={"scan_id": scan["id"], "colour": "sigma"})).json()
            assert (shown["scan_id"], shown["points"], shown["shown"]) == (scan["id"], 200, 200)
            assert (shown["colour"], shown["legend"]["unit"]) == ("sigma", "mm")
            missing = await client.put("/api/v1/view", json={"scan_id": "s-none"})
            assert_problem(missing, 404, "not-found")
