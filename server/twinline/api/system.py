"""The server itself."""

from fastapi import APIRouter

from twinline.api.context import InContext
from twinline.api.models import HealthOut, SystemOut

router = APIRouter(prefix="/system", tags=["system"])


@router.get("")
def get_system(context: InContext) -> SystemOut:
    """Version, methods, scenes and limits of this server."""
    return context.system()


@router.get("/health")
async def get_health() -> HealthOut:
    """Whether the server answers."""
    return HealthOut(status="ok")
