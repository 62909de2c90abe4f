"""The real server in a process of its own, on a free port of this machine."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import httpx
import psutil

PROGRAM = "from twinline.app import serve; from twinline.settings import load_settings; serve(load_settings())"
READY = "Twinline is ready: "
TIMEOUT_S = 120.0


class ServerProcess:
    """A running server."""

    def __init__(self, data_dir: Path, **settings: str) -> None:
        environment = {key: value for key, value in os.environ.items() if not key.startswith("TWINLINE_")}
        environment |= {"TWINLINE_PORT": "0", "TWINLINE_DATA_DIR": str(data_dir), "TWINLINE_WORKERS": "2"}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        self.log = data_dir.parent / "server.log"
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM],
                stdout=subprocess.PIPE,
                stderr=log,
                env=environment | settings,
                cwd=data_dir.parent,
                text=True,
            )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line.startswith(READY):
            self.kill()
            raise AssertionError(line + self.log.read_text())
        self.url = line.removeprefix(READY).strip()
        self.client = httpx.Client(base_url=self.url, timeout=TIMEOUT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        self.kill()

    def start(self, **request: Any) -> str:
        """Start a job; its id."""
        response = self.client.post("/api/v1/jobs", json=request)
        assert response.status_code == 202, response.text
        return str(response.json()["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        """A job as it stands."""
        job: dict[str, Any] = self.client.get(f"/api/v1/jobs/{job_id}").json()
        return job

    @contextmanager
    def events(self) -> Iterator["Events"]:
        """The server's events from now on."""
        with (
            httpx.Client(base_url=self.url, timeout=TIMEOUT_S) as client,
            client.stream("GET", "/api/v1/events") as response,
        ):
            assert response.headers["content-type"].startswith("text/event-stream")
            yield Events(response)

    def workers(self) -> list[psutil.Process]:
        """The worker processes: children of the process that forks them."""
        children = psutil.Process(self.process.pid).children()
        return [worker for child in children for worker in child.children()]

    def stop(self, how: signal.Signals = signal.SIGINT) -> int:
        """Ask the server to end and wait for it."""
        self.process.send_signal(how)
        return self.process.wait(30)

    def kill(self) -> None:
        """End it at once, with all that it started."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(30)
        if self.process.stdout is not None:
            self.process.stdout.close()


class Events:
    """Server-sent events, read in the background so that waiting for one can end."""

    def __init__(self, response: httpx.Response) -> None:
        self._found: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._response = response
        self.ended = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    def until(self, wanted: Callable[[dict[str, Any]], bool]) -> list[dict[str, Any]]:
        """All events up to the first that is wanted."""
        found: list[dict[str, Any]] = []
        while not found or not wanted(found[-1]):
            event = self._found.get(timeout=TIMEOUT_S)
            assert event is not None, f"the stream ended after {found[-1:]}"
            found.append(event)
        return found

    def _read(self) -> None:
        try:
            for line in self._response.iter_lines():
                if line.startswith("data: "):
                    self._found.put(json.loads(line.removeprefix("data: ")))
        except (httpx.HTTPError, httpx.StreamError):
            pass
        finally:
            self._found.put(None)
            self.ended.set()


def of_job(job_id: str, **values: Any) -> Callable[[dict[str, Any]], bool]:
    """Whether an event is a change of a job to certain values."""

    def matches(event: dict[str, Any]) -> bool:
        if event.get("topic") != "job" or event["id"] != job_id or event["item"] is None:
            return False
        return all(event["item"][name] == value for name, value in values.items())

    return matches


def has_begun(job_id: str, phase: str) -> Callable[[dict[str, Any]], bool]:
    """Whether an event says that a phase of a job has done some of its work."""
    running = of_job(job_id, state="running")

    def matches(event: dict[str, Any]) -> bool:
        return running(event) and event["item"]["progress"]["phase"] == phase and event["item"]["progress"]["done"] > 0

    return matches


def has_ended(job_id: str) -> Callable[[dict[str, Any]], bool]:
    """Whether an event says that a job has ended."""
    running = of_job(job_id)

    def matches(event: dict[str, Any]) -> bool:
        return running(event) and event["item"]["ended_at"] is not None

    return matches
