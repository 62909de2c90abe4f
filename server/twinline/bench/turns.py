"""Measuring in turns: A B A B ..., on one core, so that whatever slows the machine down slows both alike."""

import gc
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import cv2
import numpy as np

from twinline.arrays import FloatArray
from twinline.bench.figures import Quartiles, Ratio

Subject = Callable[[int], object]
"""What is timed; called with the number of the round."""

_NS_PER_US = 1e3
_WARM_UP = 3


@contextmanager
def one_core() -> Iterator[None]:
    """Hold this process, and the processes that it starts, to one core where the system can do that."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    # Windows and macOS have no such call; there, medians over many rounds have to do.
    pinned = hasattr(os, "sched_setaffinity")
    before = os.sched_getaffinity(0) if pinned else set()
    try:
        if pinned:
            os.sched_setaffinity(0, {max(before)})
        yield
    finally:
        if pinned:
            os.sched_setaffinity(0, before)
        cv2.setNumThreads(threads)


def take_turns(
    subjects: Mapping[str, Subject],
    rounds: int,
    *,
    before: Callable[[], object] | None = None,
    waiting: bool = False,
) -> dict[str, FloatArray]:
    """Time every subject once per round.

    Parameters
    ----------
    before
        Called, untimed, before every timed call: brings the caches into the same state for each.
    waiting
        Whether waiting counts, for disks or other processes. Otherwise it is the time that this process spends on the
        processor, all its threads together, whatever else the machine is busy with.

    Returns
    -------
    dict of (rounds,) array
        Microseconds.
    """
    for subject in subjects.values():
        for number in range(_WARM_UP):
            subject(number)
    times: dict[str, FloatArray] = {name: np.empty(rounds) for name in subjects}
    clock = time.perf_counter_ns if waiting else time.process_time_ns
    collected = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        for number in range(rounds):
            for name, subject in subjects.items():
                if before is not None:
                    before()
                start = clock()
                subject(number)
                times[name][number] = (clock() - start) / _NS_PER_US
    finally:
        if collected:
            gc.enable()
    return times


def compare(
    times: Mapping[str, FloatArray], name: str, against: str, *, must: float | None = None, aim: float | None = None
) -> Ratio:
    """Ratio of one subject to another, taken round by round."""
    return Ratio(against, Quartiles.of(times[name] / times[against]), must, aim)
