"""Worker processes: a pool that survives the death of any of them."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from typing import ParamSpec, TypeVar

import structlog

from twinline.errors import WorkerError

log = structlog.get_logger()

P = ParamSpec("P")
T = TypeVar("T")


class WorkerPool(Executor):
    """A process pool that is made anew after one of its processes died.

    A death fails all tasks of that pool with `WorkerError`, which names its cause; the next `submit` starts new
    processes. May be used from any thread.

    Parameters
    ----------
    workers
        Number of processes; they start with the first task.
    preload
        Modules that the processes share from the start, so that a new one is ready in milliseconds
        (where the system can fork; elsewhere each process imports what it needs).
    """

    def __init__(self, workers: int, preload: Sequence[str] = ()) -> None:
        method = "spawn" if sys.platform == "win32" else "forkserver"
        self._context = multiprocessing.get_context(method)
        if method == "forkserver" and preload:
            self._context.set_forkserver_preload(list(preload))
        # The attribute has the name that ProcessPoolExecutor uses: callers size their backlog by it.
        self._max_workers = workers
        self._lock = threading.Lock()
        self._pool: ProcessPoolExecutor | None = None
        self._processes: list[BaseProcess] = []
        self._closed = False

    @property
    def workers(self) -> int:
        """Number of processes."""
        return self._max_workers

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a function in a worker process; it and its arguments must be picklable."""
        outer: Future[T] = Future()
        with self._lock:
            if self._closed:
                raise WorkerError("The worker processes have been shut down.")
            try:
                pool = self._pool or self._start()
                inner = pool.submit(fn, *args, **kwargs)
            except BrokenProcessPool:
                self._pool = None
                pool = self._start()
                inner = pool.submit(fn, *args, **kwargs)
            self._processes = list((pool._processes or {}).values())
        outer.add_done_callback(lambda future: inner.cancel() if future.cancelled() else None)
        inner.add_done_callback(lambda future: self._hand_over(pool, future, outer))
        return outer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes at once; tasks that run are lost."""
        with self._lock:
            self._closed = True
            pool, self._pool = self._pool, None
            processes = self._processes
        if pool is None:
            return
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        if wait:
            for process in processes:
                process.join()

    def _start(self) -> ProcessPoolExecutor:
        pool = ProcessPoolExecutor(self._max_workers, mp_context=self._context, initializer=prepare_worker)
        # A process that is started after the first one may not be watched until something else happens: its death
        # would leave its task waiting for ever. Without leave to start them one by one, all start at once.
        pool._safe_to_dynamically_spawn_children = False  # type: ignore[attr-defined]
        self._pool = pool
        return pool

    def _hand_over(self, pool: ProcessPoolExecutor, inner: Future[T], outer: Future[T]) -> None:
        if inner.cancelled():
            outer.cancel()
            outer.set_running_or_notify_cancel()
            return
        if not outer.set_running_or_notify_cancel():
            return
        error = inner.exception()
        if isinstance(error, BrokenProcessPool):
            outer.set_exception(self._death(pool))
        elif error is not None:
            outer.set_exception(error)
        else:
            outer.set_result(inner.result())

    def _death(self, pool: ProcessPoolExecutor) -> WorkerError:
        with self._lock:
            if self._pool is pool:
                self._pool = None
            processes = self._processes
        cause = _cause_of_death(processes)
        log.warning("worker process died", cause=cause)
        return WorkerError(f"A worker process {cause}; its results are lost. Start the job again.")


def prepare_worker() -> None:
    """Set up a worker process: one thread of OpenCV, no Ctrl-C of its own, an end when the server ends."""
    import cv2

    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _cause_of_death(processes: Sequence[BaseProcess]) -> str:
    codes = [code for process in processes if (code := process.exitcode) not in (None, 0, -signal.SIGTERM)]
    if not codes:
        return "died"
    code = codes[0]
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = ", often for lack of memory" if name == "SIGKILL" else ""
        return f"was killed by {name}{hint}"
    return f"ended with exit status {code}"
