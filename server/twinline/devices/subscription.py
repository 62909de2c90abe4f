"""One source of messages, any number of readers, nothing lost between them."""

import asyncio
import weakref
from typing import Generic, TypeVar

Message = TypeVar("Message")


class Subscription(Generic[Message]):
    """Messages from its making on, until the source closes; an asynchronous iterator."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[Message | None] = asyncio.Queue()

    def __aiter__(self) -> "Subscription[Message]":
        return self

    async def __anext__(self) -> Message:
        message = await self._queue.get()
        if message is None:
            self._queue.put_nowait(None)
            raise StopAsyncIteration
        return message

    def put(self, message: Message | None) -> None:
        """Add a message; None ends it."""
        self._queue.put_nowait(message)


class Broadcast(Generic[Message]):
    """The source's end; a subscription that nobody holds any more is dropped."""

    def __init__(self) -> None:
        self._subscriptions: weakref.WeakSet[Subscription[Message]] = weakref.WeakSet()
        self._closed = False

    def subscribe(self) -> Subscription[Message]:
        """A new reader."""
        subscription = Subscription[Message]()
        if self._closed:
            subscription.put(None)
        self._subscriptions.add(subscription)
        return subscription

    def publish(self, message: Message) -> None:
        """Hand a message to all readers."""
        for subscription in list(self._subscriptions):
            subscription.put(message)

    def open(self) -> None:
        """Let subscriptions made from now on live."""
        self._closed = False

    def close(self) -> None:
        """End all subscriptions, after what they still hold."""
        self._closed = True
        for subscription in list(self._subscriptions):
            subscription.put(None)
        self._subscriptions.clear()
