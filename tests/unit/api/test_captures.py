import io
import json
import os
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from tests.unit.api.steps import assert_problem, until_ended, upload, zip_of
from tests.unit.operations.fakes import FakeReconstruct, Hold, write_capture
from twinline.geometry.rig import Rig
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import write_rig
from twinline.settings import Settings


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "bust")


def rig_of(capture: Path) -> Rig:
    return open_capture(capture).rig()


async def test_an_uploaded_zip_becomes_a_capture(client: httpx.AsyncClient, capture: Path) -> None:
    response = await upload(client, zip_of(capture))
    assert response.status_code == 201, response.text
    body = response.json()
    assert response.headers["location"] == f"/api/v1/captures/{body['id']}"
    assert (body["name"], body["origin"], body["laser_frames"]) == ("two frames", "upload", 2)
    assert (body["image_size"], body["lasers"], body["has_rig"]) == ([64, 48], 1, False)
    assert (await client.get(response.headers["location"])).json() == body
    assert (await client.get("/api/v1/captures")).json() == {"captures": [body]}


async def test_a_zip_with_the_folder_inside_becomes_a_capture(client: httpx.AsyncClient, tmp_path: Path) -> None:
    write_capture(tmp_path / "outer" / "bust")
    assert (await upload(client, zip_of(tmp_path / "outer"))).status_code == 201


async def test_nothing_of_an_upload_is_left_beside_the_capture(
    client: httpx.AsyncClient, capture: Path, settings: Settings
) -> None:
    await upload(client, zip_of(capture))
    await upload(client, b"no zip")
    assert list((settings.data_dir / "incoming").iterdir()) == []
    assert len(list((settings.data_dir / "captures").iterdir())) == 1


async def test_a_zip_that_leaves_its_folder_is_refused_by_its_name(
    client: httpx.AsyncClient, settings: Settings, tmp_path: Path
) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("capture.json", "{}")
        archive.writestr("../../escaped.txt", "out")
    body = assert_problem(await upload(client, packed.getvalue(), "evil.zip"), 422, "bad-capture")
    assert "evil.zip" in body["detail"]
    assert "escaped.txt" in body["detail"]
    assert str(settings.data_dir) not in body["detail"]
    assert not [name for _, _, names in os.walk(tmp_path) for name in names if name == "escaped.txt"]


async def test_a_zip_of_a_malformed_capture_names_the_field_and_no_folder_of_the_server(
    client: httpx.AsyncClient, capture: Path, settings: Settings
) -> None:
    description = json.loads((capture / "capture.json").read_text())
    description["stripe_runs"] = "sideways"
    (capture / "capture.json").write_text(json.dumps(description))
    body = assert_problem(await upload(client, zip_of(capture)), 422, "bad-capture")
    assert "stripe_runs" in body["detail"]
    assert str(settings.data_dir) not in body["detail"]
    assert (await client.get("/api/v1/captures")).json() == {"captures": []}


async def test_an_upload_over_the_limit_is_refused_whether_it_says_so_or_not(
    client: httpx.AsyncClient, settings: Settings
) -> None:
    big = b"0" * (settings.upload_max_bytes + 1)
    assert_problem(await upload(client, big), 413, "too-large")

    async def blocks() -> AsyncIterator[bytes]:
        for start in range(0, len(big), 4096):
            yield big[start : start + 4096]

    response = await client.post(
        "/api/v1/captures",
        content=blocks(),
        headers={"Content-Type": "application/zip"},
    )
    assert_problem(response, 413, "too-large")
    assert list((settings.data_dir / "incoming").iterdir()) == []


async def test_an_empty_upload_and_other_types_are_refused(client: httpx.AsyncClient) -> None:
    assert_problem(await upload(client, b""), 422, "bad-request")
    response = await client.post("/api/v1/captures", content=b"x", headers={"Content-Type": "image/png"})
    assert_problem(response, 415, "unsupported-media-type")


async def test_a_local_folder_is_used_in_place_and_only_forgotten(client: httpx.AsyncClient, capture: Path) -> None:
    response = await client.post("/api/v1/captures", json={"path": str(capture)})
    body = response.json()
    assert (response.status_code, body["origin"], body["path"]) == (201, "folder", str(capture))
    assert (await client.delete(f"/api/v1/captures/{body['id']}")).status_code == 204
    assert (capture / "capture.json").is_file()
    assert_problem(await client.get(f"/api/v1/captures/{body['id']}"), 404, "not-found")


@pytest.mark.parametrize(
    ("body", "field"),
    [({"path": ""}, "path"), ({}, "path"), ({"path": "/a", "colour": 1}, "colour"), ([], "body")],
)
async def test_a_body_that_does_not_fit_names_the_field(client: httpx.AsyncClient, body: object, field: str) -> None:
    problem = assert_problem(await client.post("/api/v1/captures", json=body), 422, "bad-request")
    assert problem["fields"][0]["field"] == field


async def test_folders_that_are_no_captures_are_refused(client: httpx.AsyncClient, tmp_path: Path) -> None:
    for path in ("relative/folder", str(tmp_path / "missing"), str(tmp_path)):
        body = assert_problem(await client.post("/api/v1/captures", json={"path": path}), 422, "bad-capture")
        assert path in body["detail"]


async def test_a_given_rig_is_used_before_the_captures_own(
    client: httpx.AsyncClient, capture: Path, tmp_path: Path, reconstruct: FakeReconstruct
) -> None:
    rig = rig_of(capture)
    write_rig(capture / "rig.json", rig)
    body = (await client.post("/api/v1/captures", json={"path": str(capture)})).json()
    assert body["has_rig"]
    write_rig(tmp_path / "given.json", rig)
    data = (tmp_path / "given.json").read_text().replace(rig.name, "given rig").encode()
    headers = {"Content-Type": "application/json"}
    response = await client.put(f"/api/v1/captures/{body['id']}/rig", content=data, headers=headers)
    assert response.status_code == 200, response.text
    refused = await client.put(f"/api/v1/captures/{body['id']}/rig", content=b"{}", headers=headers)
    assert "The given rig.json" in assert_problem(refused, 422, "bad-rig")["detail"]
    started = await client.post("/api/v1/jobs", json={"kind": "reconstruct", "capture_id": body["id"]})
    await until_ended(client, started.json()["id"])
    scan = (await client.get("/api/v1/scans")).json()["scans"][0]
    assert scan["rig"] == {"id": "given rig", "origin": "uploaded"}
    assert reconstruct.rig is not None
    assert reconstruct.rig.name == "given rig"


async def test_a_capture_in_use_cannot_be_deleted(
    client: httpx.AsyncClient, capture: Path, reconstruct: FakeReconstruct
) -> None:
    hold = reconstruct.at_chunk = Hold(1)
    capture_id = (await client.post("/api/v1/captures", json={"path": str(capture)})).json()["id"]
    job = (await client.post("/api/v1/jobs", json={"kind": "reconstruct", "capture_id": capture_id})).json()
    assert_problem(await client.delete(f"/api/v1/captures/{capture_id}"), 409, "not-possible-now")
    hold.released.set()
    await until_ended(client, job["id"])
    assert (await client.delete(f"/api/v1/captures/{capture_id}")).status_code == 204
