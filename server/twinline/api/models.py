"""What goes over the wire: the API's JSON, made from the records of `operations`."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from twinline.operations.captures import CaptureRecord
from twinline.operations.clock import rfc3339
from twinline.operations.display import ColourMode, DisplayState
from twinline.operations.jobs import Job
from twinline.operations.scans import Scan, ScanFile
from twinline.stripe import Method

API = "/api/v1"


class Answer(BaseModel):
    """Base of everything that is sent."""

    model_config = ConfigDict(frozen=True)


class Asked(BaseModel):
    """Base of everything that is received; unknown fields are an error that names them."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FieldProblem(Answer):
    """What is wrong with one field of a request."""

    field: str
    detail: str


class Problem(Answer):
    """An error, as RFC 9457 describes it, with a stable code."""

    type: str = "about:blank"
    title: str
    status: int
    code: str
    detail: str
    fields: list[FieldProblem] | None = None


class SceneOut(Answer):
    """A scene of the simulator."""

    name: str
    title: str


class LimitsOut(Answer):
    """What the server accepts at most."""

    upload_bytes: int


class SystemOut(Answer):
    """The server itself."""

    name: str
    version: str
    started_at: str
    simulated: bool
    workers: int
    methods: list[str]
    default_method: str
    sources: list[str]
    scenes: list[SceneOut]
    limits: LimitsOut
    data_dir: str


class HealthOut(Answer):
    """Whether the server works."""

    status: Literal["ok"]


class CaptureOut(Answer):
    """A capture that the server knows."""

    id: str
    name: str
    origin: Literal["upload", "folder", "demo"]
    path: str
    created_at: str
    image_size: tuple[int, int]
    stripe_runs: str
    lasers: int
    laser_frames: int
    reference_frames: int
    has_rig: bool
    allowed: list[str]

    @classmethod
    def of(cls, record: CaptureRecord) -> Self:
        """The JSON of a record."""
        values = vars(record) | {"path": str(record.path), "created_at": rfc3339(record.created_at)}
        return cls(**values, allowed=["reconstruct", "delete"] if record.laser_frames else ["delete"])


class CaptureFolderIn(Asked):
    """A capture folder on the server's machine, to be used in place."""

    path: Annotated[str, Field(min_length=1, max_length=4096)]


class ProgressOut(Answer):
    """How far a job is; a total of 0 means that it is not known yet."""

    phase: str | None
    done: int
    total: int
    unit: str


class FailureOut(Answer):
    """Why a job failed."""

    code: str
    detail: str


class JobOut(Answer):
    """A job."""

    id: str
    kind: Literal["reconstruct", "demo"]
    title: str
    state: Literal["queued", "running", "paused", "cancelling", "done", "failed", "cancelled", "interrupted"]
    progress: ProgressOut
    created_at: str
    started_at: str | None
    ended_at: str | None
    eta_s: float | None
    request: dict[str, Any]
    outcome: dict[str, Any] | None
    error: FailureOut | None
    allowed: list[str]

    @classmethod
    def of(cls, job: Job) -> Self:
        """The JSON of a job."""
        return cls.model_validate(
            {
                "id": job.id,
                "kind": job.kind,
                "title": job.title,
                "state": str(job.state),
                "progress": vars(job.progress),
                "created_at": rfc3339(job.created_at),
                "started_at": job.started_at and rfc3339(job.started_at),
                "ended_at": job.ended_at and rfc3339(job.ended_at),
                "eta_s": None if job.eta_s is None else round(job.eta_s, 1),
                "request": dict(job.request),
                "outcome": None if job.outcome is None else dict(job.outcome),
                "error": None if job.error is None else vars(job.error),
                "allowed": list(job.allowed),
            }
        )


class ReconstructIn(Asked):
    """Reconstruct a capture."""

    kind: Literal["reconstruct"]
    capture_id: str
    rig: Literal["auto", "nominal"] = "auto"
    rig_path: Path | None = None
    method: Method | None = None
    sources: list[Literal["laser1", "laser2"]] = ["laser1", "laser2"]
    every: int = 1


class DemoIn(Asked):
    """Render a small capture on the simulated scanner and reconstruct it."""

    kind: Literal["demo"]
    scene: str | None = None
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 1


JobIn = Annotated[ReconstructIn | DemoIn, Field(discriminator="kind")]


class CommandIn(Asked):
    """A command to a job; its `allowed` names those that are possible."""

    command: Literal["cancel", "pause", "resume"]


class RigOut(Answer):
    """The rig that a scan was made with."""

    id: str
    origin: Literal["given", "uploaded", "capture", "nominal"]


class BoundsOut(Answer):
    """Smallest and largest coordinates in the bed frame."""

    min: tuple[float, float, float]
    max: tuple[float, float, float]


class FrameProblemOut(Answer):
    """A frame that gave nothing, and why."""

    frame: str
    reason: str


class FileOut(Answer):
    """A file of a scan."""

    name: str
    media_type: str
    bytes: int
    url: str

    @classmethod
    def of(cls, scan_id: str, file: ScanFile) -> Self:
        """The JSON of a file."""
        url = f"{API}/scans/{scan_id}/exports/{file.name}"
        return cls(name=file.name, media_type=file.media_type, bytes=file.size_bytes, url=url)


class ScanOut(Answer):
    """A scan: a cloud in files, and the account of how it came about."""

    id: str
    name: str
    job_id: str
    capture_id: str
    created_at: str
    points: int
    frames: int
    frames_used: int
    problem_count: int
    problems: list[FrameProblemOut]
    counts: dict[str, int]
    warnings: list[str]
    elapsed_s: float
    method: str
    sources: list[str]
    every: int
    rig: RigOut
    bounds_mm: BoundsOut | None
    median_sigma_mm: float | None
    software_version: str
    files: list[FileOut]
    allowed: list[str]

    @classmethod
    def of(cls, scan: Scan, files: list[ScanFile]) -> Self:
        """The JSON of a scan and its files."""
        bounds = None if scan.bounds_mm is None else {"min": scan.bounds_mm[0], "max": scan.bounds_mm[1]}
        values = vars(scan) | {
            "created_at": rfc3339(scan.created_at),
            "problems": [vars(problem) for problem in scan.problems],
            "rig": {"id": scan.rig_name, "origin": scan.rig_origin},
            "bounds_mm": bounds,
            "files": [FileOut.of(scan.id, file) for file in files],
            "allowed": ["show", "delete"],
        }
        return cls.model_validate({name: values[name] for name in cls.model_fields})


class LegendOut(Answer):
    """Values at the two ends of the colour scale."""

    min: float
    max: float
    unit: str


class ViewOut(Answer):
    """What the 3-D view shows."""

    page: str
    colour: ColourMode
    colours: list[ColourMode]
    points: int
    shown: int
    scan_id: str | None
    job_id: str | None
    legend: LegendOut | None
    note: str | None

    @classmethod
    def of(cls, state: DisplayState) -> Self:
        """The JSON of the display's state."""
        legend = None if state.legend is None else vars(state.legend)
        values = vars(state) | {"legend": legend, "page": "/view/", "colours": list(ColourMode)}
        return cls.model_validate(values)


class ViewIn(Asked):
    """What the 3-D view shall show."""

    colour: ColourMode | None = None
    scan_id: str | None = None
    reset_cameras: bool = False


class CapturesOut(Answer):
    """All captures, newest first."""

    captures: list[CaptureOut]


class JobsOut(Answer):
    """All jobs, newest first."""

    jobs: list[JobOut]


class ScansOut(Answer):
    """All scans, newest first."""

    scans: list[ScanOut]


class SnapshotOut(Answer):
    """First event of a stream: everything."""

    seq: int
    system: SystemOut
    jobs: list[JobOut]
    captures: list[CaptureOut]
    scans: list[ScanOut]
    view: ViewOut


class ChangeOut(Answer):
    """Later events: one item as it now is, or null where it was deleted."""

    seq: int
    topic: Literal["job", "capture", "scan", "view"]
    action: Literal["put", "delete"]
    id: str
    item: JobOut | CaptureOut | ScanOut | ViewOut | None
