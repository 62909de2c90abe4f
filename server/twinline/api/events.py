"""Events: a snapshot, then numbered changes, as server-sent events."""

from collections.abc import AsyncIterator

from fastapi import APIRouter
from starlette.responses import StreamingResponse

from twinline.api.context import ApiContext, InContext
from twinline.operations.feed import Change, Snapshot

router = APIRouter(prefix="/events", tags=["events"])


class EventStream(StreamingResponse):
    """A stream of server-sent events."""

    media_type = "text/event-stream"


@router.get("", response_class=EventStream)
async def get_events(context: InContext) -> EventStream:
    """First `snapshot`, then one `change` per change; after a reconnect another snapshot.

    The data of the events are `SnapshotOut` and `ChangeOut`.
    """
    # A proxy that collects the stream would make it arrive all at once.
    return EventStream(events(context), headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})


async def events(context: ApiContext) -> AsyncIterator[str]:
    """The stream's text, event by event."""
    async for event in context.workshop.feed.follow(context.workshop.everything):
        match event:
            case Snapshot():
                data = context.snapshot(event.seq, event.state).model_dump_json()
                yield f"event: snapshot\nid: {event.seq}\ndata: {data}\n\n"
            case Change():
                data = context.change(event).model_dump_json()
                yield f"event: change\nid: {event.seq}\ndata: {data}\n\n"
            case None:
                yield ": still here\n\n"
