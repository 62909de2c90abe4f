"""The real server process, from a first visit to a power cut."""

import io
import signal
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh

from tests.integration.server_process import ServerProcess, has_begun, has_ended

pytestmark = pytest.mark.slow


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    return tmp_path / "data"


@pytest.fixture(scope="class")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    with ServerProcess(tmp_path_factory.mktemp("server") / "data") as server:
        yield server


class TestWork:
    """One server does all of it, one job after the other."""

    def test_the_demo_goes_from_nothing_to_files_with_progress(self, server: ServerProcess) -> None:
        with server.events() as events:
            job_id = server.start(kind="demo")
            found = events.until(has_ended(job_id))
        ended = found[-1]["item"]
        assert ended["state"] == "done", ended
        progress = [event["item"]["progress"] for event in found[1:] if event["topic"] == "job"]
        for phase in ("Rendering", "Reconstructing"):
            counts = [entry["done"] for entry in progress if entry["phase"] == phase]
            assert counts == sorted(counts)
            assert len(set(counts)) > 2, f"{phase} told no progress: {counts}"
        scan = server.client.get(f"/api/v1/scans/{ended['outcome']['scan_id']}").json()
        assert scan["points"] > 10_000
        assert scan["rig"]["origin"] == "capture"
        assert scan["bounds_mm"]["max"][2] > 10.0
        files = {file["name"]: server.client.get(file["url"]).content for file in scan["files"]}
        header, _, rows = files["cloud.ply"].partition(b"end_header\n")
        assert f"element vertex {scan['points']}".encode() in header
        assert len(rows) % scan["points"] == 0
        assert struct.unpack_from("<4sI", files["cloud.glb"]) == (b"glTF", 2)
        cloud = trimesh.load_scene(io.BytesIO(files["cloud.glb"]), file_type="glb")
        assert sum(len(getattr(part, "vertices", ())) for part in cloud.geometry.values()) == scan["points"]
        view = server.client.get("/api/v1/view").json()
        assert (view["scan_id"], view["points"]) == (scan["id"], scan["points"])

    def test_a_zip_of_that_capture_can_be_uploaded_and_reconstructed(self, server: ServerProcess) -> None:
        demo = server.client.get("/api/v1/captures").json()["captures"][-1]
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            for path in sorted(Path(demo["path"]).rglob("*")):
                archive.write(path, Path("outer") / path.relative_to(demo["path"]))
        headers = {"Content-Type": "application/zip"}
        response = server.client.post("/api/v1/captures", content=packed.getvalue(), headers=headers)
        assert response.status_code == 201, response.text
        with server.events() as events:
            job_id = server.start(kind="reconstruct", capture_id=response.json()["id"], every=2)
            ended = events.until(has_ended(job_id))[-1]["item"]
        assert ended["state"] == "done", ended

    def test_a_hostile_zip_is_refused(self, server: ServerProcess) -> None:
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            archive.writestr("capture.json", "{}")
            archive.writestr("../../../escaped.txt", "out")
        headers = {"Content-Type": "application/zip"}
        response = server.client.post("/api/v1/captures", content=packed.getvalue(), headers=headers)
        assert (response.status_code, response.json()["code"]) == (422, "bad-capture")

    def test_a_running_job_can_be_cancelled(self, server: ServerProcess) -> None:
        with server.events() as events:
            job_id = server.start(kind="demo")
            events.until(has_begun(job_id, "Rendering"))
            response = server.client.post(f"/api/v1/jobs/{job_id}/commands", json={"command": "cancel"})
            assert response.status_code == 202
            assert events.until(has_ended(job_id))[-1]["item"]["state"] == "cancelled"

    def test_a_killed_worker_fails_the_job_with_its_cause_and_the_next_job_succeeds(
        self, server: ServerProcess
    ) -> None:
        capture = server.client.get("/api/v1/captures").json()["captures"][-1]
        with server.events() as events:
            job_id = server.start(kind="demo")
            events.until(has_begun(job_id, "Rendering"))
            server.workers()[0].kill()
            ended = events.until(has_ended(job_id))[-1]["item"]
            assert (ended["state"], ended["error"]["code"]) == ("failed", "worker-died")
            assert "SIGKILL" in ended["error"]["detail"]
            job_id = server.start(kind="reconstruct", capture_id=capture["id"])
            assert events.until(has_ended(job_id))[-1]["item"]["state"] == "done"


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_asked_to_end_it_ends_with_its_workers_and_streams_and_the_job_is_interrupted(
    data_dir: Path, how: signal.Signals
) -> None:
    with ServerProcess(data_dir) as server:
        with server.events() as events:
            job_id = server.start(kind="demo")
            events.until(has_begun(job_id, "Rendering"))
            workers = server.workers()
            assert workers
            assert server.stop(how) in (0, -how)
            assert events.ended.wait(10)
        for worker in workers:
            worker.wait(10)
        assert "Traceback" not in server.log.read_text()
    with ServerProcess(data_dir) as again:
        assert again.job(job_id)["state"] == "interrupted"


def test_after_a_power_cut_the_interrupted_job_is_listed_and_nothing_half_done_is_left(data_dir: Path) -> None:
    with ServerProcess(data_dir) as server:
        with server.events() as events:
            job_id = server.start(kind="demo")
            events.until(has_begun(job_id, "Rendering"))
        workers = server.workers()
        server.kill()
        for worker in workers:
            worker.wait(10)
    with ServerProcess(data_dir) as again:
        job = again.job(job_id)
        assert (job["state"], job["allowed"]) == ("interrupted", ["delete"])
        assert job["ended_at"] is not None
        assert again.client.get("/api/v1/captures").json() == {"captures": []}
        assert list((data_dir / "captures").iterdir()) == []


def test_a_second_server_on_the_same_port_says_so(data_dir: Path, tmp_path: Path) -> None:
    with ServerProcess(data_dir) as server:
        port = server.url.rpartition(":")[2]
        with pytest.raises(AssertionError, match=f"cannot listen on 127.0.0.1 port {port}"):
            ServerProcess(tmp_path / "other", TWINLINE_PORT=port)
