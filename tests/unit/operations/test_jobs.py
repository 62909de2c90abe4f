from datetime import UTC, datetime

import pytest

from twinline.errors import TransitionError
from twinline.operations.jobs import COMMANDS, ENDED, TRANSITIONS, Job, JobEvent, JobState

NOW = datetime(2026, 11, 22, 10, 0, tzinfo=UTC)


def job_in(state: JobState) -> Job:
    return Job("j-1", "demo", "Demo", {}, NOW, state)


@pytest.mark.parametrize("event", list(JobEvent))
@pytest.mark.parametrize("state", list(JobState))
def test_every_state_and_event_follows_the_table_or_is_refused(state: JobState, event: JobEvent) -> None:
    expected = TRANSITIONS.get((state, event))
    if expected is not None:
        assert job_in(state).after(event, NOW).state is expected
    else:
        with pytest.raises(TransitionError, match=f"Job j-1 is {state}: {event} is not possible"):
            job_in(state).after(event, NOW)


@pytest.mark.parametrize("state", list(JobState))
def test_allowed_commands_are_those_of_the_table(state: JobState) -> None:
    job = job_in(state)
    if state in ENDED:
        assert job.allowed == ("delete",)
    else:
        assert set(job.allowed) == {str(event) for event in COMMANDS if (state, event) in TRANSITIONS}


@pytest.mark.parametrize("state", sorted(ENDED))
def test_nothing_happens_to_an_ended_job(state: JobState) -> None:
    assert not [event for event in JobEvent if (state, event) in TRANSITIONS]


def test_every_state_can_be_reached_and_every_other_left_by_an_interruption() -> None:
    reachable = {JobState.QUEUED}
    for _ in JobState:
        reachable |= {target for (state, _), target in TRANSITIONS.items() if state in reachable}
    assert reachable == set(JobState)
    assert all((state, JobEvent.INTERRUPT) in TRANSITIONS for state in JobState if state not in ENDED)


def test_start_and_end_are_dated() -> None:
    later = NOW.replace(minute=5)
    started = job_in(JobState.QUEUED).after(JobEvent.START, NOW)
    ended = started.after(JobEvent.FINISH, later)
    assert (started.started_at, started.ended_at) == (NOW, None)
    assert (ended.started_at, ended.ended_at) == (NOW, later)
