"""From nothing to a cloud that can be turned and taken home, by pressing what the page offers."""

import gzip
import io
import json
import struct
import urllib.request
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.conftest import DEMO_S, Server
from tests.browser.picture import colourfulness, lit_share, middle, picture_of, wait_for_points

Scanned = Callable[[], dict[str, Any]]


def test_a_stranger_gets_from_the_first_page_to_points(page: Page, server: Server, output: Path) -> None:
    expect(page.get_by_text("simulated scanner", exact=True)).to_be_visible()
    expect(page.get_by_text("No points yet")).to_be_visible()
    page.screenshot(path=output / "first-visit.png")
    page.get_by_role("button", name="Run the demo scan").click()
    expect(page.locator("#job .phases")).to_contain_text("Render the simulated pass")
    expect(page.locator("#job [role=progressbar]")).to_be_visible()
    page.screenshot(path=output / "running.png")
    expect(page.locator("#job")).to_contain_text("Median sigma", timeout=DEMO_S * 1000)
    scan = server.get("/api/v1/scans")["scans"][0]
    assert scan["points"] > 1000
    shown = page.locator("#job .figure").first.inner_text().replace("\u202f", "")
    assert int(shown) == scan["points"]
    picture = wait_for_points(page)
    assert colourfulness(picture) >= 2, "points coloured by height show more than one hue"
    page.screenshot(path=output / "result.png")


def test_the_points_turn_under_the_mouse(page: Page, scanned: Scanned) -> None:
    scanned()
    before = wait_for_points(page)
    box = page.locator("#stage iframe").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 220, y + 40, steps=12)
    page.mouse.up()
    for _ in range(60):
        page.wait_for_timeout(250)
        after = middle(picture_of(page, "#stage .stage"))
        if (np.abs(after.astype(int) - before.astype(int)).max(axis=2) > 40).mean() > 0.005:
            break
    else:
        pytest.fail("dragging did not turn the points")
    assert lit_share(after) > 0.002, "the points are still in the picture"


def test_a_colour_mode_changes_the_legend_and_the_picture(page: Page, scanned: Scanned) -> None:
    scanned()
    wait_for_points(page)
    modes = page.get_by_role("group", name="Colour by")
    legend = page.locator("#stage .hud.bottom-right")
    expect(legend).to_contain_text("mm")
    modes.get_by_role("button", name="Source").click()
    expect(modes.get_by_role("button", name="Source")).to_have_attribute("aria-pressed", "true")
    expect(legend).to_contain_text("Laser 2")
    page.locator("body").press("3")
    expect(modes.get_by_role("button", name="Sigma")).to_have_attribute("aria-pressed", "true")
    expect(legend).to_contain_text("mm")
    modes.get_by_role("button", name="Height").click()
    expect(modes.get_by_role("button", name="Height")).to_have_attribute("aria-pressed", "true")


def test_the_ply_holds_every_point(page: Page, scanned: Scanned) -> None:
    scan = scanned()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download PLY").click()
    content = Path(download.value.path()).read_bytes()
    header, _, body = content.partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert f"element vertex {scan['points']}" in lines
    sizes = {"float": 4, "uchar": 1}
    properties = [line.split() for line in lines if line.startswith("property")]
    assert len(body) == scan["points"] * sum(sizes[kind] for _, kind, _ in properties)
    assert {"x", "y", "z", "source", "sigma", "intensity"} <= {name for _, _, name in properties}


def test_the_glb_holds_every_point_in_metres(page: Page, scanned: Scanned) -> None:
    scan = scanned()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download GLB").click()
    content = Path(download.value.path()).read_bytes()
    magic, version, length, json_length = struct.unpack_from("<4sIII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    document = json.loads(content[20 : 20 + json_length])
    positions = [
        document["accessors"][p["attributes"]["POSITION"]] for m in document["meshes"] for p in m["primitives"]
    ]
    assert sum(accessor["count"] for accessor in positions) == scan["points"]
    extent_m = np.ptp([[a["min"], a["max"]] for a in positions], axis=(0, 1))
    bounds_mm = scan["bounds_mm"]
    widest_mm = max(np.subtract(bounds_mm["max"], bounds_mm["min"]))
    assert max(extent_m) * 1000 == pytest.approx(widest_mm, rel=1e-3)


def test_a_zip_of_a_capture_is_uploaded_and_reconstructed(
    page: Page, server: Server, scanned: Scanned, tmp_path: Path
) -> None:
    demo = scanned()
    folder = Path(server.get(f"/api/v1/captures/{demo['capture_id']}")["path"])
    packed = tmp_path / "mine.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    page.get_by_role("button", name="Zip file").click()
    page.locator("#own-zip").set_input_files(packed)
    expect(page.locator("#own")).to_contain_text("mine.zip")
    page.get_by_text("Settings").click()
    page.get_by_label("Every n-th frame").fill("4")
    page.get_by_role("button", name="Reconstruct").click()
    expect(page.locator("#job")).to_contain_text("1 frame in 4", timeout=DEMO_S * 1000)
    scan = server.get("/api/v1/scans")["scans"][0]
    assert scan["every"] == 4
    assert 0 < scan["points"] < demo["points"]


def test_the_page_asks_nothing_of_any_other_host(context: BrowserContext, server: Server, scanned: Scanned) -> None:
    scanned()
    asked: list[str] = []
    page = context.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.goto(server.url)
    wait_for_points(page)
    assert asked
    own = (server.url, server.url.replace("http", "ws"), "data:", "blob:")
    assert [url for url in asked if not url.startswith(own)] == []


def test_the_page_is_small(server: Server) -> None:
    def content(path: str) -> bytes:
        with urllib.request.urlopen(server.url + path, timeout=30) as answer:
            body: bytes = answer.read()
            return body

    document = content("/").decode()
    parts = [part.split('"')[0] for part in document.replace('src="', 'href="').split('href="')[1:]]
    compressed = io.BytesIO()
    with gzip.GzipFile(fileobj=compressed, mode="wb") as packed:
        for part in parts:
            packed.write(content(part))
    assert compressed.tell() < 120_000
