"""Jobs: what is being computed, how far it is, and what may be done with it.

The state machine is one table, `TRANSITIONS`. `Job.allowed` goes out with every status, and the panel enables its
buttons from it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from twinline.errors import TransitionError


class JobState(StrEnum):
    """Where a job stands."""

    QUEUED = "queued"
    RUNNING = "running"
    PAUSED = "paused"
    CANCELLING = "cancelling"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    INTERRUPTED = "interrupted"


class JobEvent(StrEnum):
    """What can happen to a job. The first three are commands that anybody may give."""

    CANCEL = "cancel"
    PAUSE = "pause"
    RESUME = "resume"
    START = "start"
    FINISH = "finish"
    FAIL = "fail"
    STOP = "stop"
    INTERRUPT = "interrupt"


COMMANDS = (JobEvent.CANCEL, JobEvent.PAUSE, JobEvent.RESUME)
ENDED = frozenset({JobState.DONE, JobState.FAILED, JobState.CANCELLED, JobState.INTERRUPTED})

_S, _E = JobState, JobEvent
TRANSITIONS: Mapping[tuple[JobState, JobEvent], JobState] = MappingProxyType(
    {
        (_S.QUEUED, _E.START): _S.RUNNING,
        (_S.QUEUED, _E.CANCEL): _S.CANCELLED,
        (_S.QUEUED, _E.INTERRUPT): _S.INTERRUPTED,
        (_S.RUNNING, _E.PAUSE): _S.PAUSED,
        (_S.RUNNING, _E.CANCEL): _S.CANCELLING,
        (_S.RUNNING, _E.FINISH): _S.DONE,
        (_S.RUNNING, _E.FAIL): _S.FAILED,
        (_S.RUNNING, _E.INTERRUPT): _S.INTERRUPTED,
        (_S.PAUSED, _E.RESUME): _S.RUNNING,
        (_S.PAUSED, _E.CANCEL): _S.CANCELLING,
        # The last checkpoint may lie behind the pause: the work then ends although it was paused.
        (_S.PAUSED, _E.FINISH): _S.DONE,
        (_S.PAUSED, _E.FAIL): _S.FAILED,
        (_S.PAUSED, _E.INTERRUPT): _S.INTERRUPTED,
        (_S.CANCELLING, _E.STOP): _S.CANCELLED,
        # It was finished, or broke, before it noticed the cancellation.
        (_S.CANCELLING, _E.FINISH): _S.DONE,
        (_S.CANCELLING, _E.FAIL): _S.FAILED,
        (_S.CANCELLING, _E.INTERRUPT): _S.INTERRUPTED,
    }
)


@dataclass(frozen=True)
class Progress:
    """How far a job is.

    Attributes
    ----------
    phase
        What is being done, for people; None before it starts.
    done, total
        Count in `unit`; a total of 0 means that it is not known yet.
    """

    phase: str | None = None
    done: int = 0
    total: int = 0
    unit: str = "frames"


@dataclass(frozen=True)
class JobFailure:
    """Why a job failed: the code and detail of the error that ended it."""

    code: str
    detail: str


@dataclass(frozen=True)
class Job:
    """One piece of work, as it stands at one moment.

    Attributes
    ----------
    request
        What was asked for, as it was asked.
    created_at, started_at, ended_at
        In UTC; None where it has not happened.
    eta_s
        Expected seconds to the end of the present phase; None while unknown.
    outcome
        What came out; only of a job that is done.
    error
        Only of a job that failed.
    """

    id: str
    kind: str
    title: str
    request: Mapping[str, Any]
    created_at: datetime
    state: JobState = JobState.QUEUED
    progress: Progress = field(default_factory=Progress)
    started_at: datetime | None = None
    ended_at: datetime | None = None
    eta_s: float | None = None
    outcome: Mapping[str, Any] | None = None
    error: JobFailure | None = None

    @property
    def ended(self) -> bool:
        """Whether nothing can happen to it any more."""
        return self.state in ENDED

    @property
    def allowed(self) -> tuple[str, ...]:
        """Names of the actions that are possible now."""
        if self.ended:
            return ("delete",)
        return tuple(str(command) for command in COMMANDS if (self.state, command) in TRANSITIONS)

    def after(self, event: JobEvent, now: datetime) -> "Job":
        """The job after an event.

        Raises
        ------
        TransitionError
            Where the table has no such transition.
        """
        state = TRANSITIONS.get((self.state, event))
        if state is None:
            possible = ", ".join(self.allowed) or "nothing"
            raise TransitionError(f"Job {self.id} is {self.state}: {event} is not possible, only {possible}.")
        return replace(
            self,
            state=state,
            started_at=now if event is JobEvent.START else self.started_at,
            ended_at=now if state in ENDED else self.ended_at,
            eta_s=self.eta_s if state is JobState.RUNNING else None,
        )
