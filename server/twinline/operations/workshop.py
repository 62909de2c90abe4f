"""Everything that the server can be asked to do, in one place: captures, jobs, scans, the view, and who is told."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

from twinline.errors import InputError, TransitionError, TwinlineError
from twinline.operations.captures import CaptureRecord, CaptureShelf
from twinline.operations.clock import Clock
from twinline.operations.cloud_file import read_cloud
from twinline.operations.demo import DemoRequest, reconstruct_rendered, render_capture
from twinline.operations.display import CloudDisplay, ColourMode, DisplayState
from twinline.operations.feed import Feed
from twinline.operations.job_store import JobStore
from twinline.operations.jobs import Job, JobEvent
from twinline.operations.reconstruct import Bench, ReconstructRequest, outcome
from twinline.operations.records import make_folder
from twinline.operations.runner import JobContext, JobRunner
from twinline.operations.scans import Scan, ScanShelf
from twinline.operations.toolbox import Toolbox
from twinline.operations.workers import WorkerPool


@dataclass(frozen=True)
class Everything:
    """The present state of all that a listener may show."""

    jobs: list[Job]
    captures: list[CaptureRecord]
    scans: list[Scan]
    view: DisplayState


class Workshop:
    """The server's work, without HTTP.

    Any thread may call any method. `run` occupies the thread that calls it until `close`.

    Parameters
    ----------
    data_dir
        Folder for everything that is kept.
    """

    def __init__(
        self, data_dir: Path, toolbox: Toolbox, workers: WorkerPool, display: CloudDisplay, clock: Clock
    ) -> None:
        self.toolbox = toolbox
        self.workers = workers
        self.feed = Feed()
        self.captures = CaptureShelf(make_folder(data_dir / "captures"), clock, toolbox.open_capture, toolbox.read_rig)
        self.scans = ScanShelf(data_dir / "scans")
        self.runner = JobRunner(JobStore(data_dir / "jobs"), clock, self._job_changed, self._job_deleted)
        self._incoming = data_dir / "incoming"
        self._display = display
        self._bench = Bench(self.captures, self.scans, display, toolbox, workers, clock, self._view_changed)

    def restore(self) -> None:
        """Take up what earlier runs left."""
        shutil.rmtree(self._incoming, ignore_errors=True)
        self.captures.restore()
        self.scans.restore()
        self.runner.restore()

    def run(self) -> None:
        """Do queued jobs until `close`."""
        self.runner.run()

    def close(self) -> None:
        """Interrupt jobs, end the worker processes and all listening."""
        self.runner.stop()
        self.workers.shutdown(wait=False)
        self.feed.close()

    def everything(self) -> Everything:
        """The present state, for a snapshot."""
        return Everything(self.runner.jobs(), self.captures.records(), self.scans.records(), self.view())

    def incoming_file(self) -> Path:
        """A path for an upload that is under way."""
        return make_folder(self._incoming) / f"{uuid4().hex}.zip"

    def add_upload(self, archive: Path, name: str) -> CaptureRecord:
        """Unpack an uploaded zip as a new capture.

        Parameters
        ----------
        name
            What the sender calls the zip; error messages use it.

        Raises
        ------
        CaptureError
            If it is no zip of a usable capture.
        """
        try:
            return self._told(self.captures.add("upload", lambda folder: self.toolbox.unpack(archive, folder)))
        except TwinlineError as error:
            raise type(error)(error.detail.replace(str(archive), name), code=error.code) from error

    def add_folder(self, path: Path) -> CaptureRecord:
        """Use a folder of this machine as a capture."""
        return self._told(self.captures.add_folder(path))

    def give_rig(self, capture_id: str, data: bytes) -> CaptureRecord:
        """Keep a rig for a capture."""
        return self._told(self.captures.give_rig(capture_id, data))

    def delete_capture(self, capture_id: str) -> None:
        """Forget a capture.

        Raises
        ------
        TransitionError
            While a job uses it.
        """
        self.captures.get(capture_id)
        for job in self.runner.active():
            if job.request.get("capture_id") == capture_id:
                raise TransitionError(f"Job {job.id} uses capture {capture_id}: cancel it or wait for its end.")
        self.captures.delete(capture_id)
        self.feed.publish("capture", "delete", capture_id)

    def start_reconstruct(self, request: ReconstructRequest, asked: Mapping[str, Any]) -> Job:
        """Queue a reconstruction.

        Parameters
        ----------
        asked
            The request as it came, for the job's record.
        """
        record = self.captures.get(request.capture_id)
        request.check(self.toolbox.methods)

        def work(context: JobContext) -> Mapping[str, Any]:
            return self._finish(self._bench.reconstruct(context, request))

        return self.runner.submit("reconstruct", f"Reconstruct {record.name}", asked, self._shown(work))

    def start_demo(self, request: DemoRequest, asked: Mapping[str, Any]) -> Job:
        """Queue a demo scan."""
        if request.scene not in self.toolbox.scenes:
            raise InputError(f"scene is {request.scene!r}; choose one of {', '.join(self.toolbox.scenes)}.")

        def work(context: JobContext) -> Mapping[str, Any]:
            record = self._told(render_capture(context, self._bench, request))
            return self._finish(reconstruct_rendered(context, self._bench, record))

        return self.runner.submit("demo", f"Demo scan: {self.toolbox.scenes[request.scene]}", asked, self._shown(work))

    def command(self, job_id: str, command: JobEvent) -> Job:
        """Cancel, pause or resume a job."""
        return self.runner.command(job_id, command)

    def delete_scan(self, scan_id: str) -> None:
        """Delete a scan and its files; the view is cleared if it shows it."""
        self.scans.delete(scan_id)
        if self._display.state().scan_id == scan_id:
            self._display.clear()
            self._view_changed()
        self.feed.publish("scan", "delete", scan_id)

    def view(self) -> DisplayState:
        """What the 3-D view shows."""
        return self._display.state()

    def set_colour(self, mode: ColourMode) -> None:
        """Colour the cloud in another way."""
        self._display.set_colour(mode)
        self._view_changed()

    def reset_cameras(self) -> None:
        """Let all viewers of the 3-D view see the whole cloud again."""
        self._display.reset_cameras()

    def show_scan(self, scan_id: str) -> None:
        """Show a scan that is kept.

        Raises
        ------
        NotFoundError
            If there is none.
        TransitionError
            While a running job shows its growing cloud.
        """
        file = self.scans.file(scan_id, "cloud.ply")
        shown = self._display.state()
        if shown.scan_id is None and any(job.id == shown.job_id for job in self.runner.active()):
            raise TransitionError(f"The view shows job {shown.job_id} at work: wait for its end, or cancel it.")
        cloud = read_cloud(file.path)
        self._display.begin(scan_id=scan_id)
        self._display.append(cloud)
        self._display.finish(scan_id=scan_id)
        self._view_changed()

    def _finish(self, scan: Scan) -> Mapping[str, Any]:
        self.feed.publish("scan", "put", scan.id, scan)
        return outcome(scan)

    def _shown(self, work: Callable[[JobContext], Mapping[str, Any]]) -> Callable[[JobContext], Mapping[str, Any]]:
        def watched(context: JobContext) -> Mapping[str, Any]:
            try:
                return work(context)
            finally:
                self._view_changed()

        return watched

    def _told(self, record: CaptureRecord) -> CaptureRecord:
        self.feed.publish("capture", "put", record.id, record)
        return record

    def _view_changed(self) -> None:
        self.feed.publish("view", "put", "view", self._display.state())

    def _job_changed(self, job: Job) -> None:
        self.feed.publish("job", "put", job.id, job)

    def _job_deleted(self, job_id: str) -> None:
        self.feed.publish("job", "delete", job_id)
