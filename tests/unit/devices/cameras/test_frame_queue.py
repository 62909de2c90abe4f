"""The queue between a camera's thread and the loop."""

import asyncio
import threading

import pytest

from twinline.devices.camera import CameraFrame
from twinline.devices.cameras.frame_queue import FrameIterator, FrameQueue
from twinline.errors import CameraError, TransitionError

FRAME = CameraFrame(0, 1.0, None, "gray8", b"\0", (1, 1))


async def drain(queue: FrameQueue, count: int, *, fresh: bool) -> list[tuple[int, int]]:
    """Numbers and drop counts of the next frames."""
    iterator = queue.read(fresh=fresh)
    return [(frame.sequence, frame.dropped) for frame in [await anext(iterator) for _ in range(count)]]


def queue_of(capacity: int) -> FrameQueue:
    return FrameQueue(asyncio.get_running_loop(), capacity)


async def test_what_does_not_fit_is_dropped_from_the_old_end_and_counted() -> None:
    queue = queue_of(3)
    iterator = queue.read(fresh=True)
    for _ in range(10):
        queue.put(FRAME)
    assert queue.counts() == (0, 7)
    taken = [await anext(iterator) for _ in range(3)]
    assert [(frame.sequence, frame.dropped) for frame in taken] == [(7, 7), (8, 7), (9, 7)]
    assert queue.counts() == (3, 7)


async def test_frames_known_to_be_lost_take_numbers() -> None:
    queue = queue_of(8)
    iterator = queue.read(fresh=True)
    queue.put(FRAME)
    queue.lose(2)
    queue.put(FRAME)
    assert [(await anext(iterator)).sequence for _ in range(2)] == [0, 3]
    assert queue.counts() == (2, 2)


async def test_what_nobody_wanted_is_not_counted_as_dropped() -> None:
    queue = queue_of(2)
    for _ in range(5):
        queue.put(FRAME)
    assert queue.counts() == (0, 0)
    iterator = queue.read(fresh=True)
    queue.put(FRAME)
    frame = await anext(iterator)
    assert (frame.sequence, frame.dropped) == (5, 0)


async def test_a_fresh_iteration_leaves_out_what_the_last_one_did_not_take() -> None:
    queue = queue_of(4)
    iterator = queue.read(fresh=True)
    for _ in range(3):
        queue.put(FRAME)
    await anext(iterator)
    del iterator
    iterator = queue.read(fresh=True)
    queue.put(FRAME)
    frame = await anext(iterator)
    assert (frame.sequence, frame.dropped) == (3, 0)


async def test_an_iteration_that_goes_on_begins_where_the_last_one_stopped() -> None:
    queue = queue_of(4)
    iterator = queue.read(fresh=False)
    for _ in range(3):
        queue.put_when_taken(FRAME)
    await anext(iterator)
    del iterator
    assert await drain(queue, 2, fresh=False) == [(1, 0), (2, 0)]


async def test_putting_never_waits_for_a_reader_that_is_asleep() -> None:
    queue = queue_of(2)
    iterator = queue.read(fresh=True)

    def fill() -> None:
        for _ in range(1000):
            queue.put(FRAME)

    thread = threading.Thread(target=fill)
    thread.start()
    # The loop does nothing at all until the thread is through.
    thread.join()
    assert (await anext(iterator)).sequence == 998
    assert queue.counts() == (1, 998)


async def test_a_patient_thread_loses_nothing() -> None:
    queue = queue_of(2)

    def fill() -> None:
        for _ in range(50):
            queue.put_when_taken(FRAME)
        queue.finish()

    thread = threading.Thread(target=fill)
    thread.start()
    numbers = [frame.sequence async for frame in queue.read(fresh=False)]
    thread.join()
    assert numbers == list(range(50))
    assert queue.counts() == (50, 0)


async def test_a_patient_thread_is_released_when_the_queue_is_closed() -> None:
    queue = queue_of(1)

    def fill() -> None:
        for _ in range(5):
            queue.put_when_taken(FRAME)

    thread = threading.Thread(target=fill)
    thread.start()
    queue.close()
    thread.join()
    assert [frame async for frame in queue.read(fresh=False)] == []


async def test_an_error_comes_after_what_was_queued() -> None:
    queue = queue_of(4)
    iterator = queue.read(fresh=True)
    queue.put(FRAME)
    queue.finish(CameraError("The camera is on fire: take another one."))
    await anext(iterator)
    for _ in range(2):
        with pytest.raises(CameraError, match="on fire"):
            await anext(iterator)


async def test_a_frame_that_comes_after_closing_is_not_delivered() -> None:
    queue = queue_of(4)
    iterator = queue.read(fresh=True)
    queue.put(FRAME)
    queue.close()
    queue.put(FRAME)
    assert [frame async for frame in iterator] == []


async def test_a_reader_whose_task_has_ended_makes_room_and_learns_of_it() -> None:
    queue = queue_of(4)

    async def begin() -> object:
        return queue.read(fresh=True)

    left_over = await asyncio.create_task(begin())
    queue.put(FRAME)
    # A plain coroutine of this task would still be reading.
    assert await drain_one(queue) == 1
    assert hasattr(left_over, "__anext__")
    with pytest.raises(TransitionError, match="Somebody else"):
        await left_over.__anext__()


async def drain_one(queue: FrameQueue) -> int:
    iterator = queue.read(fresh=True)
    queue.put(FRAME)
    return (await anext(iterator)).sequence


async def test_closing_the_iterator_makes_room_and_ends_its_waiting() -> None:
    queue = queue_of(4)
    iterator = queue.read(fresh=True)
    waiting = asyncio.create_task(collect(iterator))
    await asyncio.sleep(0)
    await iterator.aclose()
    assert await waiting == []
    queue.put(FRAME)
    assert await drain_one(queue) == 1


async def collect(iterator: FrameIterator) -> list[CameraFrame]:
    return [frame async for frame in iterator]


async def test_a_cancelled_wait_does_not_end_the_iteration() -> None:
    queue = queue_of(4)
    iterator = queue.read(fresh=True)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.001):
            await anext(iterator)
    queue.put(FRAME)
    assert (await anext(iterator)).sequence == 0


def test_a_thread_that_outlives_the_loop_meets_no_error() -> None:
    loop = asyncio.new_event_loop()
    queue = FrameQueue(loop, 2)
    loop.close()
    queue.put(FRAME)
    queue.finish()
    queue.put_when_taken(FRAME)
