"""What the 3-D view shows; the view itself is the page at /view/."""

from fastapi import APIRouter

from twinline.api.context import InWorkshop
from twinline.api.models import ViewIn, ViewOut

router = APIRouter(prefix="/view", tags=["view"])


@router.get("")
def get_view(workshop: InWorkshop) -> ViewOut:
    """What is shown."""
    return ViewOut.of(workshop.view())


@router.put("")
def put_view(asked: ViewIn, workshop: InWorkshop) -> ViewOut:
    """Colour the cloud in another way, show a scan that is kept, or let all viewers see the whole cloud again."""
    if asked.scan_id is not None:
        workshop.show_scan(asked.scan_id)
    if asked.colour is not None:
        workshop.set_colour(asked.colour)
    if asked.reset_cameras:
        workshop.reset_cameras()
    return ViewOut.of(workshop.view())
