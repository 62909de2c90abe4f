import asyncio
import threading
from collections.abc import AsyncIterator

from twinline.operations.feed import Change, Feed, Snapshot


async def take(events: AsyncIterator[Snapshot | Change | None], count: int) -> list[Snapshot | Change | None]:
    return [await asyncio.wait_for(anext(events), 10) for _ in range(count)]


async def test_a_listener_gets_a_snapshot_and_then_consecutive_changes() -> None:
    feed = Feed()
    feed.publish("job", "put", "j-0", 0)
    events = feed.follow(lambda: "everything")
    assert await take(events, 1) == [Snapshot(1, "everything")]
    feed.publish("job", "put", "j-1", 1)
    feed.publish("job", "delete", "j-1")
    assert await take(events, 2) == [Change(2, "job", "put", "j-1", 1), Change(3, "job", "delete", "j-1", None)]
    await events.aclose()  # type: ignore[attr-defined]


async def test_changes_of_other_threads_arrive_in_order() -> None:
    feed = Feed()
    events = feed.follow(lambda: None)
    await take(events, 1)

    def publish() -> None:
        for _ in range(50):
            feed.publish("job", "put", "j", None)

    threads = [threading.Thread(target=publish) for _ in range(4)]
    for thread in threads:
        thread.start()
    changes = await take(events, 200)
    for thread in threads:
        thread.join()
    assert [change.seq for change in changes if change is not None] == list(range(1, 201))


async def test_a_slow_listener_gets_a_fresh_snapshot_instead_of_a_gap() -> None:
    feed = Feed(capacity=3)
    events = feed.follow(lambda: None)
    await take(events, 1)
    for _ in range(10):
        feed.publish("job", "put", "j", None)
    assert await take(events, 1) == [Snapshot(10, None)]
    feed.publish("job", "put", "j", None)
    assert await take(events, 1) == [Change(11, "job", "put", "j", None)]


async def test_a_quiet_feed_gives_a_sign_of_life() -> None:
    events = Feed().follow(lambda: None, keep_alive_s=0.01)
    assert await take(events, 3) == [Snapshot(0, None), None, None]


async def test_closing_ends_those_who_listen_and_those_who_come_later() -> None:
    feed = Feed()
    events = feed.follow(lambda: None)
    await take(events, 1)
    waiting = asyncio.create_task(anext(events, None))
    await asyncio.sleep(0)
    feed.close()
    assert await asyncio.wait_for(waiting, 10) is None
    assert len([event async for event in feed.follow(lambda: None)]) <= 1
