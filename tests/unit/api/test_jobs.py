import asyncio
import io
from pathlib import Path
from typing import Any

import httpx
import pytest
import trimesh

from tests.unit.api.steps import assert_problem, until_ended
from tests.unit.operations.fakes import FakeReconstruct, Hold, write_capture
from twinline.errors import WorkerError
from twinline.settings import Settings


@pytest.fixture
async def capture_id(client: httpx.AsyncClient, tmp_path: Path) -> str:
    path = write_capture(tmp_path / "bust")
    return str((await client.post("/api/v1/captures", json={"path": str(path)})).json()["id"])


async def start(client: httpx.AsyncClient, **request: Any) -> dict[str, Any]:
    response = await client.post("/api/v1/jobs", json=request)
    assert response.status_code == 202, response.text
    job: dict[str, Any] = response.json()
    assert response.headers["location"] == f"/api/v1/jobs/{job['id']}"
    return job


async def test_a_reconstruction_ends_in_a_scan_with_its_files(client: httpx.AsyncClient, capture_id: str) -> None:
    job = await start(client, kind="reconstruct", capture_id=capture_id, every=2)
    assert (job["state"], job["title"]) == ("queued", "Reconstruct two frames")
    ended = await until_ended(client, job["id"])
    assert (ended["state"], ended["allowed"], ended["error"]) == ("done", ["delete"], None)
    assert ended["request"]["every"] == 2
    scan = (await client.get(f"/api/v1/scans/{ended['outcome']['scan_id']}")).json()
    assert (scan["points"], scan["frames"], scan["frames_used"], scan["every"]) == (200, 4, 3, 2)
    assert scan["problems"] == [{"frame": "000003.png", "reason": "it ends early"}]
    assert scan["rig"]["origin"] == "nominal"
    assert scan["bounds_mm"]["min"][0] >= 0
    assert scan["bounds_mm"]["max"][2] <= 20
    assert [file["name"] for file in scan["files"]] == ["cloud.ply", "cloud.glb"]
    for file in scan["files"]:
        download = await client.get(file["url"])
        assert (download.status_code, len(download.content)) == (200, file["bytes"])
        assert download.headers["content-type"] == file["media_type"]
        assert "attachment" in download.headers["content-disposition"]
        scene = trimesh.load_scene(io.BytesIO(download.content), file_type=file["name"].rpartition(".")[2])
        assert [len(getattr(cloud, "vertices", ())) for cloud in scene.geometry.values()] == [200]


async def test_a_demo_renders_a_capture_and_scans_it(client: httpx.AsyncClient) -> None:
    ended = await until_ended(client, (await start(client, kind="demo", scene="ball"))["id"])
    assert ended["state"] == "done"
    capture = (await client.get("/api/v1/captures")).json()["captures"][0]
    assert (capture["name"], capture["origin"]) == ("ball", "demo")
    scan = (await client.get(f"/api/v1/scans/{ended['outcome']['scan_id']}")).json()
    assert scan["capture_id"] == capture["id"]


@pytest.mark.parametrize(
    ("change", "status", "code", "word"),
    [
        ({"capture_id": "c-none"}, 404, "not-found", "c-none"),
        ({"method": "guess"}, 422, "bad-request", "maximum-likelihood"),
        ({"method": "steger"}, 422, "bad-input", "brightest-pixel"),
        ({"sources": []}, 422, "bad-input", "sources"),
        ({"sources": ["tof"]}, 422, "bad-request", "sources"),
        ({"every": 0}, 422, "bad-input", "every"),
        ({"every": "often"}, 422, "bad-request", "every"),
        ({"speed": 3}, 422, "bad-request", "speed"),
        ({"rig": "nominal", "rig_path": "/a/rig.json"}, 422, "bad-input", "rig_path"),
        ({"kind": "sing"}, 422, "bad-request", "kind"),
    ],
)
async def test_requests_that_make_no_sense_are_refused_by_name(
    client: httpx.AsyncClient, capture_id: str, change: dict[str, Any], status: int, code: str, word: str
) -> None:
    response = await client.post("/api/v1/jobs", json={"kind": "reconstruct", "capture_id": capture_id} | change)
    body = assert_problem(response, status, code)
    assert word in body["detail"]
    assert (await client.get("/api/v1/jobs")).json() == {"jobs": []}


async def test_an_unknown_scene_is_refused(client: httpx.AsyncClient) -> None:
    response = await client.post("/api/v1/jobs", json={"kind": "demo", "scene": "castle"})
    assert "blocks, ball" in assert_problem(response, 422, "bad-input")["detail"]


async def test_cancelling_keeps_nothing_and_the_next_job_runs(
    client: httpx.AsyncClient, capture_id: str, reconstruct: FakeReconstruct, settings: Settings
) -> None:
    hold = reconstruct.at_chunk = Hold(1)
    job = await start(client, kind="reconstruct", capture_id=capture_id)
    assert await asyncio.to_thread(hold.reached.wait, 10)
    running = (await client.get(f"/api/v1/jobs/{job['id']}")).json()
    assert (running["state"], running["allowed"]) == ("running", ["cancel", "pause"])
    assert running["progress"] == {"phase": "Reconstructing", "done": 1, "total": 4, "unit": "frames"}
    response = await client.post(f"/api/v1/jobs/{job['id']}/commands", json={"command": "cancel"})
    assert (response.status_code, response.json()["state"]) == (202, "cancelling")
    again = await client.post(f"/api/v1/jobs/{job['id']}/commands", json={"command": "cancel"})
    assert_problem(again, 409, "not-possible-now")
    hold.released.set()
    assert (await until_ended(client, job["id"]))["state"] == "cancelled"
    assert list((settings.data_dir / "scans").iterdir()) == []
    assert (await client.get("/api/v1/view")).json()["job_id"] is None
    next_job = await start(client, kind="reconstruct", capture_id=capture_id)
    assert (await until_ended(client, next_job["id"]))["state"] == "done"


async def test_a_failed_job_says_why_in_the_words_of_the_error(
    client: httpx.AsyncClient, capture_id: str, reconstruct: FakeReconstruct, settings: Settings
) -> None:
    def die(_: int) -> None:
        raise WorkerError("A worker process was killed by SIGKILL.")

    reconstruct.at_chunk = die
    ended = await until_ended(client, (await start(client, kind="reconstruct", capture_id=capture_id))["id"])
    assert ended["state"] == "failed"
    assert ended["error"] == {"code": "worker-died", "detail": "A worker process was killed by SIGKILL."}
    assert list((settings.data_dir / "scans").iterdir()) == []


async def test_an_ended_job_can_be_deleted_and_its_scan_stays(client: httpx.AsyncClient, capture_id: str) -> None:
    ended = await until_ended(client, (await start(client, kind="reconstruct", capture_id=capture_id))["id"])
    assert (await client.delete(f"/api/v1/jobs/{ended['id']}")).status_code == 204
    assert_problem(await client.get(f"/api/v1/jobs/{ended['id']}"), 404, "not-found")
    assert (await client.get(f"/api/v1/scans/{ended['outcome']['scan_id']}")).status_code == 200
