"""Being ended by the system without leaving a laser on."""

import asyncio
import signal
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def cancelled_by_sigterm() -> Generator[None]:
    """Within a task of the main thread, let SIGTERM cancel the task, so that its clean-up runs.

    Without it the process dies at once and the board waits for its heartbeat's deadline. Ctrl-C needs no such help:
    ``asyncio.run`` cancels its main task by itself. Where the system has no signals this does nothing.

    Yields
    ------
    None
        Until the end of the block the signal means cancellation.
    """
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    if task is None:
        raise RuntimeError("this is for use within a task")
    try:
        loop.add_signal_handler(signal.SIGTERM, task.cancel)
    except NotImplementedError:
        yield
        return
    try:
        yield
    finally:
        loop.remove_signal_handler(signal.SIGTERM)
