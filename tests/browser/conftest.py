"""A real server in a process of its own, and Chromium to look at its page."""

import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

START_S = 60
DEMO_S = 180
ARGUMENTS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)


@dataclass
class Server:
    """A running `twinline serve` on the loopback."""

    data: Path
    port: int
    process: subprocess.Popen[bytes] | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def command(self) -> list[str]:
        options = ["--port", str(self.port), "--data-dir", str(self.data / "data")]
        return [sys.executable, "-m", "twinline", "serve", *options]

    def start(self) -> None:
        with (self.data / "server.log").open("ab") as log:
            self.process = subprocess.Popen(self.command(), stdout=log, stderr=log)
        for _ in range(START_S * 10):
            if self.process.poll() is not None:
                break
            try:
                self.get("/api/v1/system/health")
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.1)
            else:
                return
        self.stop()
        pytest.fail("the server did not start:\n" + (self.data / "server.log").read_text(errors="replace")[-4000:])

    def stop(self) -> None:
        if self.process is not None:
            self.process.terminate()
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self.process = None

    def get(self, path: str) -> Any:
        """The JSON at a path."""
        with urllib.request.urlopen(self.url + path, timeout=30) as answer:
            return json.loads(answer.read())


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = Server(tmp_path_factory.mktemp("server"), port)
    server.start()
    yield server
    server.stop()


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(ARGUMENTS))
        yield browser
        browser.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(viewport={"width": 1440, "height": 900}, color_scheme="light")
    # The computer may be slow and shared: nothing here asserts how long something takes.
    context.set_default_timeout(60_000)
    expect.set_options(timeout=60_000)
    yield context
    context.close()


@pytest.fixture
def page(context: BrowserContext, server: Server) -> Page:
    """The panel, once the server's first snapshot has arrived."""
    return opened(context, server)


def opened(context: BrowserContext, server: Server) -> Page:
    page = context.new_page()
    page.goto(server.url)
    expect(page.locator("#link")).to_contain_text("Connected")
    return page


@pytest.fixture(scope="module")
def scanned(browser: Browser, server: Server) -> Callable[[], dict[str, Any]]:
    """Makes sure that the demo scan has run, by pressing its button; gives the newest scan."""

    def newest() -> dict[str, Any]:
        scans = server.get("/api/v1/scans")["scans"]
        if not scans:
            context = browser.new_context()
            page = opened(context, server)
            page.get_by_role("button", name="Run the demo scan").click()
            expect(page.locator("#job")).to_contain_text("Median sigma", timeout=DEMO_S * 1000)
            context.close()
            scans = server.get("/api/v1/scans")["scans"]
        found: dict[str, Any] = scans[0]
        return found

    return newest


@pytest.fixture(scope="session")
def output() -> Path:
    """Folder for pictures to look at; git ignores it."""
    folder = Path(__file__).parent / "output"
    folder.mkdir(exist_ok=True)
    return folder
