import asyncio
import json
from typing import Any

import httpx
from fastapi import FastAPI

from tests.unit.api.steps import until_ended
from twinline.api.events import events


def parsed(text: str) -> tuple[str, dict[str, Any]]:
    lines = dict(line.split(": ", 1) for line in text.strip().splitlines())
    data = json.loads(lines["data"])
    assert int(lines["id"]) == data["seq"]
    return lines["event"], data


async def test_a_stream_begins_with_everything_and_goes_on_with_every_change(
    app: FastAPI, client: httpx.AsyncClient
) -> None:
    stream = events(app.state.context)
    kind, snapshot = parsed(await asyncio.wait_for(anext(stream), 10))
    assert kind == "snapshot"
    assert snapshot["system"] == (await client.get("/api/v1/system")).json()
    assert (snapshot["jobs"], snapshot["captures"], snapshot["scans"]) == ([], [], [])
    job = (await client.post("/api/v1/jobs", json={"kind": "demo"})).json()
    ended = await until_ended(client, job["id"])
    changes: list[dict[str, Any]] = []
    while not changes or changes[-1]["topic"] != "job" or changes[-1]["item"]["state"] != "done":
        kind, change = parsed(await asyncio.wait_for(anext(stream), 10))
        assert kind == "change"
        changes.append(change)
    assert [change["seq"] for change in changes] == list(range(snapshot["seq"] + 1, snapshot["seq"] + 1 + len(changes)))
    assert changes[0]["item"]["state"] == "queued"
    assert changes[-1]["item"] == ended
    assert {change["topic"] for change in changes} == {"job", "capture", "scan", "view"}
    phases = [change["item"]["progress"]["phase"] for change in changes if change["topic"] == "job"]
    assert [phase for i, phase in enumerate(phases) if phase and phase not in phases[:i]] == [
        "Rendering",
        "Opening",
        "Reconstructing",
        "Writing",
    ]
    await stream.aclose()  # type: ignore[attr-defined]


async def test_what_is_deleted_is_null(app: FastAPI, client: httpx.AsyncClient) -> None:
    job = (await client.post("/api/v1/jobs", json={"kind": "demo"})).json()
    await until_ended(client, job["id"])
    stream = events(app.state.context)
    await anext(stream)
    await client.delete(f"/api/v1/jobs/{job['id']}")
    _, change = parsed(await asyncio.wait_for(anext(stream), 10))
    while change["topic"] != "job":
        _, change = parsed(await asyncio.wait_for(anext(stream), 10))
    assert (change["action"], change["id"], change["item"]) == ("delete", job["id"], None)
    await stream.aclose()  # type: ignore[attr-defined]
