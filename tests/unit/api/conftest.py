"""The whole application with made-up points, and a client of it."""

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from tests.unit.operations.fakes import FakeReconstruct, fake_toolbox
from twinline.app import create_app
from twinline.settings import Settings

HOST = "127.0.0.1:8080"


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(data_dir=tmp_path / "data", workers=1, upload_max_bytes=100_000)


@pytest.fixture
def reconstruct() -> FakeReconstruct:
    return FakeReconstruct()


@pytest.fixture
async def app(settings: Settings, reconstruct: FakeReconstruct) -> AsyncIterator[FastAPI]:
    app = create_app(settings, toolbox=fake_toolbox(reconstruct))
    async with app.router.lifespan_context(app):
        yield app


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}") as client:
        yield client
