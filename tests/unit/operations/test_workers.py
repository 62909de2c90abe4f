import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import Future, wait

import pytest

from twinline.errors import CaptureError, WorkerError
from twinline.operations.workers import WorkerPool

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are killed by POSIX signals here")


@pytest.fixture
def pool() -> Iterator[WorkerPool]:
    pool = WorkerPool(2)
    yield pool
    pool.shutdown()


def kill_self() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave() -> None:
    os._exit(7)


def complain() -> None:
    raise CaptureError("the file is empty", code="empty-file")


def dawdle() -> None:
    time.sleep(60)


def test_results_and_errors_come_back_from_the_processes(pool: WorkerPool) -> None:
    assert [future.result() for future in [pool.submit(abs, -n) for n in range(5)]] == list(range(5))
    assert pool.submit(os.getpid).result() != os.getpid()
    with pytest.raises(CaptureError) as raised:
        pool.submit(complain).result()
    assert (raised.value.code, raised.value.detail) == ("empty-file", "the file is empty")


def test_a_killed_process_is_named_as_the_cause_and_the_next_task_works(pool: WorkerPool) -> None:
    with pytest.raises(WorkerError, match="killed by SIGKILL") as raised:
        pool.submit(kill_self).result()
    assert raised.value.code == "worker-died"
    assert pool.submit(abs, -3).result() == 3


def test_an_exit_status_is_named(pool: WorkerPool) -> None:
    with pytest.raises(WorkerError, match="exit status 7"):
        pool.submit(leave).result()


def test_a_death_fails_all_tasks_of_that_pool(pool: WorkerPool) -> None:
    futures: list[Future[None]] = [pool.submit(dawdle), pool.submit(kill_self)]
    wait(futures, timeout=30)
    assert all(isinstance(future.exception(timeout=0), WorkerError) for future in futures)


def test_shutting_down_does_not_wait_for_tasks(pool: WorkerPool) -> None:
    future = pool.submit(dawdle)
    pool.shutdown()
    with pytest.raises((WorkerError, BaseException)):
        future.result(timeout=30)
    with pytest.raises(WorkerError, match="shut down"):
        pool.submit(abs, 1)


def test_a_waiting_task_can_be_cancelled(pool: WorkerPool) -> None:
    futures = [pool.submit(dawdle) for _ in range(8)]
    assert futures[-1].cancel()
    assert futures[-1].cancelled()
