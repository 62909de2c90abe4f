"""Jobs: start work, follow it, stop it."""

from typing import Annotated

from fastapi import APIRouter, Body, Response

from twinline.api.context import InWorkshop
from twinline.api.models import API, CommandIn, DemoIn, JobIn, JobOut, JobsOut, ReconstructIn
from twinline.operations.demo import DemoRequest
from twinline.operations.jobs import Job, JobEvent
from twinline.operations.reconstruct import ReconstructRequest
from twinline.operations.workshop import Workshop
from twinline.reconstruction.result import ReconstructionOptions

router = APIRouter(prefix="/jobs", tags=["jobs"])


@router.get("")
def list_jobs(workshop: InWorkshop) -> JobsOut:
    """All jobs, newest first."""
    return JobsOut(jobs=[JobOut.of(job) for job in workshop.runner.jobs()])


@router.post("", status_code=202)
def start_job(asked: Annotated[JobIn, Body()], response: Response, workshop: InWorkshop) -> JobOut:
    """Queue a job; `Location` names it."""
    job = _start(workshop, asked)
    response.headers["Location"] = f"{API}/jobs/{job.id}"
    return JobOut.of(job)


@router.get("/{job_id}")
def get_job(job_id: str, workshop: InWorkshop) -> JobOut:
    """One job."""
    return JobOut.of(workshop.runner.get(job_id))


@router.post("/{job_id}/commands", status_code=202)
def command_job(job_id: str, asked: CommandIn, workshop: InWorkshop) -> JobOut:
    """Cancel, pause or resume a job."""
    return JobOut.of(workshop.command(job_id, JobEvent(asked.command)))


@router.delete("/{job_id}", status_code=204)
def delete_job(job_id: str, workshop: InWorkshop) -> None:
    """Forget an ended job; its scan stays."""
    workshop.runner.delete(job_id)


def _start(workshop: Workshop, asked: ReconstructIn | DemoIn) -> Job:
    toolbox = workshop.toolbox
    record = asked.model_dump(mode="json", exclude_none=True)
    if isinstance(asked, DemoIn):
        return workshop.start_demo(DemoRequest(asked.scene or next(iter(toolbox.scenes)), asked.seed), record)
    options = ReconstructionOptions(asked.method or toolbox.default_method, frozenset(asked.sources), asked.every)
    request = ReconstructRequest(asked.capture_id, asked.rig, asked.rig_path, options)
    return workshop.start_reconstruct(request, record)
