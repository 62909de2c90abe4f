"""Job records on disk: one JSON file per job."""

from pathlib import Path

import structlog

from twinline.errors import InputError
from twinline.operations.jobs import Job
from twinline.operations.records import make_folder, read_record, write_record

log = structlog.get_logger()


class JobStore:
    """Keeps job records in a folder.

    Parameters
    ----------
    folder
        Made if it does not exist.

    Raises
    ------
    OutputError
        If the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = make_folder(folder)

    def load(self) -> list[Job]:
        """All records, oldest first; one that cannot be read is reported in the log and left alone."""
        jobs = []
        for path in sorted(self._folder.glob("j-*.json")):
            try:
                jobs.append(read_record(Job, path))
            except InputError as error:
                log.warning("job record skipped", reason=error.detail)
        return sorted(jobs, key=lambda job: job.created_at)

    def save(self, job: Job) -> None:
        """Write one record.

        Raises
        ------
        OutputError
            If it cannot be written; the old record then still stands.
        """
        write_record(self._path(job.id), job)

    def delete(self, job_id: str) -> None:
        """Remove one record, if it is there."""
        self._path(job_id).unlink(missing_ok=True)

    def _path(self, job_id: str) -> Path:
        return self._folder / f"{job_id}.json"
