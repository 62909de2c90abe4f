import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.unit.operations.fakes import FakeClock
from twinline.errors import CaptureError, NotFoundError, OutputError, TransitionError
from twinline.operations.job_store import JobStore
from twinline.operations.jobs import Job, JobEvent, JobState
from twinline.operations.runner import JobContext, JobRunner


class Bench:
    """A runner on a folder, and what it told."""

    def __init__(self, folder: Path) -> None:
        self.clock = FakeClock()
        self.told: list[Job] = []
        self.runner = JobRunner(JobStore(folder), self.clock, self.told.append, lambda _: None)

    def submit(self, work: Any) -> Job:
        return self.runner.submit("demo", "Demo", {"kind": "demo"}, work)

    def states(self, job: Job) -> list[JobState]:
        states: list[JobState] = []
        for told in self.told:
            if told.id == job.id and (not states or states[-1] is not told.state):
                states.append(told.state)
        return states


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def nothing(_: JobContext) -> Mapping[str, Any]:
    return {}


def test_a_job_runs_through_its_states_and_keeps_its_outcome(bench: Bench) -> None:
    job = bench.submit(lambda _: {"scan_id": "s-1"})
    assert bench.runner.run_next()
    assert bench.states(job) == [JobState.QUEUED, JobState.RUNNING, JobState.DONE]
    assert bench.runner.get(job.id).outcome == {"scan_id": "s-1"}


def test_jobs_run_in_the_order_they_were_asked_for(bench: Bench) -> None:
    order: list[int] = []

    def work_of(number: int) -> Any:
        def work(_: JobContext) -> Mapping[str, Any]:
            order.append(number)
            return {}

        return work

    for number in range(3):
        bench.submit(work_of(number))
    for _ in range(3):
        bench.runner.run_next()
    assert order == [0, 1, 2]


def test_an_error_raised_on_purpose_becomes_the_jobs_code_and_detail(bench: Bench) -> None:
    def work(_: JobContext) -> Mapping[str, Any]:
        raise CaptureError("laser/frames.csv is missing.")

    job = bench.submit(work)
    bench.runner.run_next()
    ended = bench.runner.get(job.id)
    assert ended.state is JobState.FAILED
    assert ended.error is not None
    assert (ended.error.code, ended.error.detail) == ("bad-capture", "laser/frames.csv is missing.")


def test_an_unexpected_error_fails_the_job_and_the_next_one_runs(bench: Bench) -> None:
    def work(_: JobContext) -> Mapping[str, Any]:
        raise ZeroDivisionError

    broken, next_job = bench.submit(work), bench.submit(nothing)
    bench.runner.run_next()
    bench.runner.run_next()
    error = bench.runner.get(broken.id).error
    assert error is not None
    assert error.code == "internal"
    assert bench.runner.get(next_job.id).state is JobState.DONE


def test_cancelling_a_queued_job_means_that_it_never_runs(bench: Bench) -> None:
    ran: list[bool] = []
    job = bench.submit(lambda _: ran.append(True))
    assert bench.runner.command(job.id, JobEvent.CANCEL).state is JobState.CANCELLED
    bench.runner.run_next()
    assert not ran


def test_cancelling_a_running_job_ends_it_at_its_next_checkpoint(bench: Bench) -> None:
    def work(context: JobContext) -> Mapping[str, Any]:
        bench.runner.command(context.job_id, JobEvent.CANCEL)
        context.checkpoint()
        raise AssertionError("the checkpoint let it pass")

    job = bench.submit(work)
    bench.runner.run_next()
    assert bench.states(job) == [JobState.QUEUED, JobState.RUNNING, JobState.CANCELLING, JobState.CANCELLED]


def test_a_paused_job_waits_at_its_checkpoint_until_it_is_resumed(bench: Bench) -> None:
    paused, passed = threading.Event(), threading.Event()

    def work(context: JobContext) -> Mapping[str, Any]:
        bench.runner.command(context.job_id, JobEvent.PAUSE)
        paused.set()
        context.checkpoint()
        passed.set()
        return {}

    job = bench.submit(work)
    lane = threading.Thread(target=bench.runner.run_next)
    lane.start()
    assert paused.wait(10)
    assert not passed.is_set()
    assert bench.runner.get(job.id).allowed == ("cancel", "resume")
    bench.runner.command(job.id, JobEvent.RESUME)
    lane.join(10)
    assert passed.is_set()
    assert bench.runner.get(job.id).state is JobState.DONE


def test_a_command_that_the_state_does_not_allow_is_refused(bench: Bench) -> None:
    job = bench.submit(nothing)
    with pytest.raises(TransitionError, match="is queued: pause is not possible, only cancel"):
        bench.runner.command(job.id, JobEvent.PAUSE)
    with pytest.raises(TransitionError):
        bench.runner.command(job.id, JobEvent.FINISH)
    with pytest.raises(NotFoundError):
        bench.runner.command("j-none", JobEvent.CANCEL)


def test_progress_is_told_at_most_five_times_a_second_but_its_end_always(bench: Bench) -> None:
    def work(context: JobContext) -> Mapping[str, Any]:
        context.phase("Counting")
        for done in range(1, 101):
            bench.clock.elapsed_s += 0.01
            context.report(done, 100)
        return {}

    job = bench.submit(work)
    bench.runner.run_next()
    counted = [told.progress.done for told in bench.told if told.id == job.id and told.state is JobState.RUNNING]
    assert len(counted) < 10
    assert counted[-1] == 100
    assert counted == sorted(counted)


def test_the_end_is_predicted_after_three_seconds_without_counting_pauses(bench: Bench) -> None:
    seen: list[float | None] = []

    def work(context: JobContext) -> Mapping[str, Any]:
        context.phase("Counting")
        bench.clock.elapsed_s += 2.0
        context.report(20, 100)
        seen.append(bench.runner.get(context.job_id).eta_s)
        bench.runner.command(context.job_id, JobEvent.PAUSE)
        bench.clock.elapsed_s += 1000.0
        bench.runner.command(context.job_id, JobEvent.RESUME)
        bench.clock.elapsed_s += 2.0
        context.report(40, 100)
        seen.append(bench.runner.get(context.job_id).eta_s)
        return {}

    bench.submit(work)
    bench.runner.run_next()
    assert seen == [None, pytest.approx(6.0)]


def test_after_a_restart_jobs_are_listed_and_unfinished_ones_are_interrupted(bench: Bench, tmp_path: Path) -> None:
    done = bench.submit(nothing)
    bench.runner.run_next()
    queued = bench.submit(nothing)
    again = Bench(tmp_path)
    again.runner.restore()
    assert {job.id: job.state for job in again.runner.jobs()} == {
        done.id: JobState.DONE,
        queued.id: JobState.INTERRUPTED,
    }
    third = Bench(tmp_path)
    third.runner.restore()
    assert third.runner.get(queued.id).state is JobState.INTERRUPTED
    assert third.runner.get(done.id) == bench.runner.get(done.id)


def test_a_damaged_record_does_not_keep_the_others_from_being_read(bench: Bench, tmp_path: Path) -> None:
    job = bench.submit(nothing)
    (tmp_path / "j-broken.json").write_text('{"id": 3', encoding="utf-8")
    again = Bench(tmp_path)
    again.runner.restore()
    assert [known.id for known in again.runner.jobs()] == [job.id]


def test_stopping_interrupts_queued_and_running_jobs(bench: Bench) -> None:
    def work(context: JobContext) -> Mapping[str, Any]:
        bench.runner.stop()
        context.checkpoint()
        return {}

    running, queued = bench.submit(work), bench.submit(nothing)
    bench.runner.run()
    assert bench.runner.get(running.id).state is JobState.INTERRUPTED
    assert bench.runner.get(queued.id).state is JobState.INTERRUPTED
    with pytest.raises(TransitionError, match="shutting down"):
        bench.submit(nothing)


def test_only_ended_jobs_can_be_deleted(bench: Bench, tmp_path: Path) -> None:
    job = bench.submit(nothing)
    with pytest.raises(TransitionError, match="cancel it before"):
        bench.runner.delete(job.id)
    bench.runner.run_next()
    bench.runner.delete(job.id)
    assert bench.runner.jobs() == []
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_does_not_stop_the_lane(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    job = bench.submit(nothing)

    def full(*_: object) -> None:
        raise OutputError("no space left")

    def work(_: JobContext) -> Mapping[str, Any]:
        monkeypatch.setattr(JobStore, "save", full)
        return {}

    second = bench.submit(work)
    bench.runner.run_next()
    bench.runner.run_next()
    assert bench.runner.get(job.id).state is JobState.DONE
    assert bench.runner.get(second.id).state is JobState.DONE
