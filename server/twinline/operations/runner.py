"""Runs jobs one after the other in the computing lane, and is the only place that changes them."""

import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol
from uuid import uuid4

import structlog

from twinline.errors import CancelledError, NotFoundError, TransitionError, TwinlineError
from twinline.operations.clock import Clock
from twinline.operations.job_store import JobStore
from twinline.operations.jobs import ENDED, Job, JobEvent, JobFailure, JobState, Progress

log = structlog.get_logger()

PUBLISH_INTERVAL_S = 0.2
"""Progress is told to listeners at most this often; every change of state always is."""
ETA_AFTER_S = 3.0
"""A phase must have run so long before its end is predicted."""


class JobContext(Protocol):
    """What running work may say and must ask."""

    @property
    def job_id(self) -> str:
        """The job that this work is."""
        ...

    def phase(self, name: str, unit: str = "frames") -> None:
        """Begin another phase; its progress starts at 0 of unknown."""
        ...

    def report(self, done: int, total: int) -> None:
        """Say how far the present phase is."""
        ...

    def checkpoint(self) -> None:
        """Wait while the job is paused.

        Raises
        ------
        CancelledError
            When the job is to end here.
        """
        ...


Work = Callable[[JobContext], Mapping[str, Any]]
"""What a job does; its result becomes the job's outcome."""


@dataclass
class _PhaseTimer:
    """Time spent in the present phase, without pauses."""

    started_s: float
    published_s: float = float("-inf")
    paused_since_s: float | None = None


class JobRunner:
    """The computing lane.

    Any thread may call any method. `run` occupies the thread that calls it until `stop`.

    Parameters
    ----------
    changed
        Called with each new state of a job, in order; must be quick and must not call back.
    deleted
        Called with the id of each deleted job.
    """

    def __init__(
        self, store: JobStore, clock: Clock, changed: Callable[[Job], None], deleted: Callable[[str], None]
    ) -> None:
        self._store = store
        self._clock = clock
        self._changed = changed
        self._deleted = deleted
        self._jobs: dict[str, Job] = {}
        self._work: dict[str, Work] = {}
        self._timers: dict[str, _PhaseTimer] = {}
        self._waiting: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._condition = threading.Condition(threading.RLock())
        self._stopping = False

    def restore(self) -> None:
        """Read the records of earlier runs; what was unfinished then is interrupted now."""
        with self._condition:
            for job in self._store.load():
                self._jobs[job.id] = job
                if not job.ended:
                    self._apply(job.id, JobEvent.INTERRUPT)

    def jobs(self) -> list[Job]:
        """All jobs, newest first."""
        with self._condition:
            return sorted(self._jobs.values(), key=lambda job: job.created_at, reverse=True)

    def get(self, job_id: str) -> Job:
        """One job.

        Raises
        ------
        NotFoundError
            If there is none with this id.
        """
        with self._condition:
            job = self._jobs.get(job_id)
        if job is None:
            raise NotFoundError(f"There is no job {job_id}.")
        return job

    def submit(self, kind: str, title: str, request: Mapping[str, Any], work: Work) -> Job:
        """Queue new work and return its job at once.

        Raises
        ------
        TransitionError
            If the server is shutting down.
        """
        with self._condition:
            if self._stopping:
                raise TransitionError("The server is shutting down and takes no new jobs.", code="shutting-down")
            job = Job(f"j-{uuid4().hex[:12]}", kind, title, dict(request), self._clock.now())
            self._store.save(job)
            self._jobs[job.id] = job
            self._work[job.id] = work
            self._changed(job)
            self._waiting.put(job.id)
        return job

    def command(self, job_id: str, command: JobEvent) -> Job:
        """Cancel, pause or resume a job.

        Raises
        ------
        NotFoundError
            If there is no such job.
        TransitionError
            If its state does not allow the command.
        """
        with self._condition:
            job = self.get(job_id)
            if command not in job.allowed:
                job.after(command, self._clock.now())
                raise TransitionError(f"{command} is not a command.")
            self._clock_pause(job_id, command)
            job = self._apply(job_id, command)
            if job.state is JobState.CANCELLED:
                self._work.pop(job_id, None)
            self._condition.notify_all()
        return job

    def delete(self, job_id: str) -> None:
        """Forget an ended job.

        Raises
        ------
        NotFoundError
            If there is no such job.
        TransitionError
            If it has not ended.
        """
        with self._condition:
            job = self.get(job_id)
            if not job.ended:
                raise TransitionError(f"Job {job_id} is {job.state}: cancel it before deleting it.")
            self._store.delete(job_id)
            del self._jobs[job_id]
            self._deleted(job_id)

    def active(self) -> list[Job]:
        """Jobs that have not ended."""
        with self._condition:
            return [job for job in self._jobs.values() if job.state not in ENDED]

    def run(self) -> None:
        """Do queued work until `stop`."""
        while self.run_next():
            pass

    def run_next(self) -> bool:
        """Wait for one queued job and do it; False after `stop`."""
        job_id = self._waiting.get()
        if job_id is None:
            return False
        with self._condition:
            work = self._work.pop(job_id, None)
            if work is None or self._stopping:
                return True
            self._timers[job_id] = _PhaseTimer(self._clock.monotonic_s())
            self._apply(job_id, JobEvent.START)
        try:
            self._do(job_id, work)
        finally:
            self._timers.pop(job_id, None)
        return True

    def stop(self) -> None:
        """Interrupt everything and let `run` return."""
        with self._condition:
            self._stopping = True
            for job in self.active():
                if job.state is JobState.QUEUED:
                    self._work.pop(job.id, None)
                    self._apply(job.id, JobEvent.INTERRUPT)
            self._condition.notify_all()
        self._waiting.put(None)

    def _do(self, job_id: str, work: Work) -> None:
        try:
            outcome = work(_Context(self, job_id))
        except CancelledError:
            self._end(job_id, JobEvent.INTERRUPT if self._stopping else JobEvent.STOP)
        except TwinlineError as error:
            self._fail(job_id, error.code, error.detail)
        except Exception:
            if not self._stopping:
                log.exception("job failed unexpectedly", job=job_id)
            self._fail(job_id, "internal", "The job broke on an error that nobody expected; see the server's log.")
        else:
            self._end(job_id, JobEvent.FINISH, outcome=dict(outcome))

    def _fail(self, job_id: str, code: str, detail: str) -> None:
        # While the server stops, workers are taken away: what breaks then is an interruption.
        event = JobEvent.INTERRUPT if self._stopping else JobEvent.FAIL
        self._end(job_id, event, error=None if self._stopping else JobFailure(code, detail))

    def _end(self, job_id: str, event: JobEvent, **values: Any) -> None:
        with self._condition:
            try:
                self._apply(job_id, event, eta_s=None, **values)
            except TwinlineError as error:
                # The disk is full, or the like: the state in memory is still right, so the lane must go on.
                log.error("job record not kept", job=job_id, reason=error.detail)

    def _apply(self, job_id: str, event: JobEvent, **values: Any) -> Job:
        job = replace(self._jobs[job_id].after(event, self._clock.now()), **values)
        self._jobs[job_id] = job
        self._changed(job)
        self._store.save(job)
        return job

    def _clock_pause(self, job_id: str, command: JobEvent) -> None:
        timer = self._timers.get(job_id)
        if timer is None:
            return
        now_s = self._clock.monotonic_s()
        if command is JobEvent.PAUSE:
            timer.paused_since_s = now_s
        elif command is JobEvent.RESUME and timer.paused_since_s is not None:
            timer.started_s += now_s - timer.paused_since_s
            timer.paused_since_s = None

    def _phase(self, job_id: str, name: str, unit: str) -> None:
        with self._condition:
            self._timers[job_id] = _PhaseTimer(self._clock.monotonic_s())
            self._tell(replace(self._jobs[job_id], progress=Progress(name, 0, 0, unit), eta_s=None))

    def _report(self, job_id: str, done: int, total: int) -> None:
        with self._condition:
            job, timer, now_s = self._jobs[job_id], self._timers[job_id], self._clock.monotonic_s()
            elapsed_s = now_s - timer.started_s
            running = job.state is JobState.RUNNING
            eta_s = elapsed_s * (total - done) / done if running and done > 0 and elapsed_s >= ETA_AFTER_S else None
            job = replace(job, progress=replace(job.progress, done=done, total=total), eta_s=eta_s)
            if now_s - timer.published_s >= PUBLISH_INTERVAL_S or done >= total:
                timer.published_s = now_s
                self._tell(job)
            else:
                self._jobs[job_id] = job

    def _tell(self, job: Job) -> None:
        self._jobs[job.id] = job
        self._changed(job)

    def _checkpoint(self, job_id: str) -> None:
        with self._condition:
            while self._jobs[job_id].state is JobState.PAUSED and not self._stopping:
                self._condition.wait()
            if self._stopping or self._jobs[job_id].state is JobState.CANCELLING:
                raise CancelledError(f"Job {job_id} was stopped.")


class _Context:
    """The runner as the work of one job sees it."""

    def __init__(self, runner: JobRunner, job_id: str) -> None:
        self._runner = runner
        self._job_id = job_id

    @property
    def job_id(self) -> str:
        return self._job_id

    def phase(self, name: str, unit: str = "frames") -> None:
        self.checkpoint()
        self._runner._phase(self._job_id, name, unit)

    def report(self, done: int, total: int) -> None:
        self._runner._report(self._job_id, done, total)

    def checkpoint(self) -> None:
        self._runner._checkpoint(self._job_id)
