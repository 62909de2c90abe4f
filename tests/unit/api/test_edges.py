"""What every request meets: the guard, problems, methods, the panel's files."""

from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from tests.unit.api.conftest import HOST
from tests.unit.api.steps import assert_problem
from twinline import errors
from twinline.api.panel_files import PanelFiles
from twinline.api.problems import STATUS, status_of


@pytest.mark.parametrize("host", ["scanner.example", "127.0.0.1.example:8080", "192.168.1.20:8080", "", "[::1"])
async def test_a_foreign_host_name_is_refused(client: httpx.AsyncClient, host: str) -> None:
    for path in ("/api/v1/system", "/", "/view/"):
        assert_problem(await client.get(path, headers={"Host": host}), 403, "foreign-host")


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1", "[::1]:8080", "127.0.0.2:1"])
async def test_every_name_of_this_machine_is_taken(client: httpx.AsyncClient, host: str) -> None:
    assert (await client.get("/api/v1/system", headers={"Host": host})).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:9999"},
        {"Origin": f"https://{HOST}"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
async def test_another_page_cannot_change_anything(client: httpx.AsyncClient, headers: dict[str, str]) -> None:
    response = await client.post("/api/v1/jobs", json={"kind": "demo"}, headers=headers)
    assert_problem(response, 403, "foreign-origin")
    assert (await client.get("/api/v1/jobs")).json() == {"jobs": []}


async def test_the_servers_own_page_and_scripts_may(client: httpx.AsyncClient) -> None:
    own = {"Origin": f"http://{HOST}", "Sec-Fetch-Site": "same-origin"}
    assert (await client.put("/api/v1/view", json={"colour": "source"}, headers=own)).status_code == 200
    assert (await client.put("/api/v1/view", json={"colour": "height"})).status_code == 200


async def test_unknown_paths_below_api_are_problems_for_every_method(client: httpx.AsyncClient) -> None:
    for method in ("GET", "POST", "PUT", "DELETE", "PATCH"):
        for path in ("/api", "/api/", "/api/v1/nothing", "/api/v2/system"):
            assert_problem(await client.request(method, path), 404, "not-found")


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PATCH", "/api/v1/jobs", {"GET", "POST"}),
        ("POST", "/api/v1/system", {"GET"}),
        ("PUT", "/api/v1/captures/c-1", {"GET", "DELETE"}),
        ("POST", "/api/v1/scans/s-1/exports/cloud.ply", {"GET", "HEAD"}),
        ("POST", "/", {"GET", "HEAD"}),
    ],
)
async def test_a_wrong_method_is_told_all_right_ones(
    client: httpx.AsyncClient, method: str, path: str, allowed: set[str]
) -> None:
    response = await client.request(method, path)
    assert_problem(response, 405, "method-not-allowed")
    assert set(response.headers["allow"].split(", ")) == allowed


async def test_a_body_that_is_not_json_is_a_problem(client: httpx.AsyncClient) -> None:
    response = await client.post("/api/v1/jobs", content=b"{", headers={"Content-Type": "application/json"})
    assert_problem(response, 422, "bad-request")


async def test_a_huge_json_body_is_refused(client: httpx.AsyncClient) -> None:
    response = await client.post("/api/v1/jobs", json={"kind": "demo", "scene": "x" * 9_000_000})
    assert_problem(response, 413, "too-large")


async def test_an_unexpected_error_gives_no_detail_away(app: FastAPI, client: httpx.AsyncClient) -> None:
    async def broken() -> None:
        raise ZeroDivisionError("secret")

    app.router.add_api_route("/api/v1/broken", broken)
    app.router.routes.insert(0, app.router.routes.pop())
    body = assert_problem(await client.get("/api/v1/broken"), 500, "internal")
    assert "secret" not in body["detail"]


def test_every_error_of_the_package_has_a_status() -> None:
    kinds = [
        kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.TwinlineError)
    ]
    assert len(kinds) > 10
    assert {status_of(kind("detail")) for kind in kinds} == set(STATUS.values())
    assert status_of(errors.RigError("detail")) == 422


@pytest.mark.parametrize("path", ["/", "/view/", "/api/v1/system"])
async def test_browsers_are_told_to_be_careful(client: httpx.AsyncClient, path: str) -> None:
    response = await client.get(path)
    assert response.status_code == 200
    assert response.headers["x-content-type-options"] == "nosniff"
    assert response.headers["referrer-policy"] == "no-referrer"
    policy = response.headers["content-security-policy"]
    assert "frame-ancestors" in policy
    assert "http:" not in policy
    assert response.headers["x-frame-options"] == ("SAMEORIGIN" if path == "/view/" else "DENY")


async def test_the_view_has_one_address(client: httpx.AsyncClient) -> None:
    response = await client.get("/view")
    assert (response.status_code, response.headers["location"]) == (307, "/view/")
    assert_problem(await client.get("/view/other"), 404, "not-found")


class TestPanelFiles:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        folder = tmp_path / "panel"
        (folder / "assets").mkdir(parents=True)
        (folder / "index.html").write_text("<title>panel</title>")
        (folder / "assets" / "main-1a2b.js").write_text("1")
        (tmp_path / "secret.txt").write_text("secret")
        return folder

    @pytest.fixture
    def files(self, app: FastAPI, folder: Path) -> FastAPI:
        app.router.routes[-1].app = PanelFiles(folder)  # type: ignore[attr-defined]
        return app

    async def test_the_document_is_asked_for_again_and_hashed_files_are_kept(
        self, files: FastAPI, client: httpx.AsyncClient
    ) -> None:
        document, script = await client.get("/"), await client.get("/assets/main-1a2b.js")
        assert (document.text, document.headers["cache-control"]) == ("<title>panel</title>", "no-cache")
        assert "immutable" in script.headers["cache-control"]

    async def test_pages_of_the_panel_are_the_one_document(self, files: FastAPI, client: httpx.AsyncClient) -> None:
        assert (await client.get("/library/s-1")).text == "<title>panel</title>"

    @pytest.mark.parametrize("path", ["/assets/none.js", "/../secret.txt", "/%2e%2e/secret.txt"])
    async def test_files_that_are_not_part_of_it_are_problems(
        self, files: FastAPI, client: httpx.AsyncClient, path: str
    ) -> None:
        assert_problem(await client.get(path), 404, "not-found")

    async def test_without_a_built_panel_a_page_says_how_to_build_it(
        self, app: FastAPI, client: httpx.AsyncClient, tmp_path: Path
    ) -> None:
        app.router.routes[-1].app = PanelFiles(tmp_path / "none")  # type: ignore[attr-defined]
        assert "./dev web" in (await client.get("/")).text
        assert_problem(await client.get("/library"), 404, "not-found")
