"""What several tests of the API do."""

import asyncio
import io
import zipfile
from pathlib import Path
from typing import Any

import httpx

ENDED = {"done", "failed", "cancelled", "interrupted"}


def zip_of(folder: Path) -> bytes:
    """A zip of a folder's contents."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return packed.getvalue()


async def upload(client: httpx.AsyncClient, data: bytes, name: str = "scan.zip") -> httpx.Response:
    return await client.post(
        "/api/v1/captures", params={"name": name}, content=data, headers={"Content-Type": "application/zip"}
    )


async def until_ended(client: httpx.AsyncClient, job_id: str) -> dict[str, Any]:
    """The job once it has ended."""
    while True:
        job: dict[str, Any] = (await client.get(f"/api/v1/jobs/{job_id}")).json()
        if job["state"] in ENDED:
            return job
        await asyncio.sleep(0.01)


def assert_problem(response: httpx.Response, status: int, code: str) -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    body: dict[str, Any] = response.json()
    assert (body["status"], body["code"]) == (status, code)
    assert body["detail"].endswith(".")
    return body
