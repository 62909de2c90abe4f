"""What the page says when something is wrong."""

import json
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import Server


def refusal(server: Server, path: str) -> dict[str, str]:
    """The server's own words about a folder."""
    request = urllib.request.Request(
        server.url + "/api/v1/captures",
        data=json.dumps({"path": path}).encode(),
        headers={"Content-Type": "application/json"},
    )
    with pytest.raises(urllib.error.HTTPError) as raised:
        urllib.request.urlopen(request, timeout=30)
    with raised.value as answer:
        body: dict[str, str] = json.loads(answer.read())
        return body


def start(page: Page, path: Path) -> None:
    page.get_by_role("textbox", name="Folder").fill(str(path))
    page.get_by_role("button", name="Reconstruct").click()


def test_a_bad_folder_is_told_in_the_servers_words(page: Page, server: Server, tmp_path: Path, output: Path) -> None:
    path = tmp_path / "nowhere"
    told = refusal(server, str(path))
    start(page, path)
    note = page.locator("#own .problem")
    expect(note).to_contain_text(told["detail"])
    expect(note).to_contain_text(told["code"])
    expect(page.get_by_role("textbox", name="Folder")).to_have_attribute("aria-invalid", "true")
    page.screenshot(path=output / "bad-folder.png")


def test_a_field_of_capture_json_that_is_wrong_is_named(page: Page, server: Server, tmp_path: Path) -> None:
    (tmp_path / "capture.json").write_text('{"name": "bad", "image_size": [0, 720]}')
    told = refusal(server, str(tmp_path))
    start(page, tmp_path)
    expect(page.locator("#own .problem")).to_contain_text(told["detail"])
    assert "image_size" in told["detail"]


def test_a_mended_field_takes_the_error_away(page: Page, tmp_path: Path) -> None:
    start(page, tmp_path / "nowhere")
    expect(page.locator("#own .problem")).to_be_visible()
    page.get_by_role("textbox", name="Folder").fill("/elsewhere")
    expect(page.locator("#own .problem")).to_have_count(0)


def test_a_file_that_is_no_zip_is_refused_before_it_is_sent(page: Page, tmp_path: Path) -> None:
    (tmp_path / "bust.rar").write_bytes(b"Rar!")
    page.get_by_role("button", name="Zip file").click()
    page.locator("#own-zip").set_input_files(tmp_path / "bust.rar")
    expect(page.locator("#own")).to_contain_text("bust.rar is not a zip file")
    expect(page.get_by_role("button", name="Reconstruct")).to_have_attribute("aria-disabled", "true")


def test_a_zip_without_a_capture_is_told_in_the_servers_words(page: Page, tmp_path: Path) -> None:
    (tmp_path / "broken.zip").write_bytes(b"PK\x03\x04 but no more")
    page.get_by_role("button", name="Zip file").click()
    page.locator("#own-zip").set_input_files(tmp_path / "broken.zip")
    page.get_by_role("button", name="Reconstruct").click()
    expect(page.locator("#own .problem .code")).to_have_text("bad-capture")


def test_a_start_that_is_not_possible_says_why(page: Page) -> None:
    start_button = page.get_by_role("button", name="Reconstruct")
    expect(start_button).to_have_attribute("aria-disabled", "true")
    expect(page.locator("#own .why")).to_contain_text("path of a capture folder")
    start_button.focus()
    expect(start_button).to_be_focused()
    page.get_by_role("textbox", name="Folder").fill("/captures/bust")
    expect(start_button).to_have_attribute("aria-disabled", "false")
    page.get_by_text("Settings").click()
    page.get_by_label("Every n-th frame").fill("0")
    expect(page.locator("#own")).to_contain_text("A whole number, 1 or more.")
    expect(start_button).to_have_attribute("aria-disabled", "true")


def test_a_cancelled_job_can_be_run_again(page: Page) -> None:
    page.get_by_role("button", name="Run the demo scan").click()
    page.locator("#job").get_by_role("button", name="Cancel").click()
    expect(page.locator("#job")).to_contain_text("stopped on request")
    expect(page.get_by_role("button", name="Try again")).to_have_attribute("aria-disabled", "false")


def test_a_lost_server_is_told_and_found_again(page: Page, server: Server, output: Path) -> None:
    server.stop()
    expect(page.get_by_role("alert")).to_contain_text("Not connected to the server")
    expect(page.locator("#link")).to_contain_text("No answer")
    expect(page.locator("#own .why")).to_contain_text("while the server does not answer")
    page.screenshot(path=output / "lost.png")
    server.start()
    expect(page.locator("#link")).to_contain_text("Connected")
    expect(page.get_by_role("alert")).to_have_count(0)
