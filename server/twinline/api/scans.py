"""Scans and their files."""

from fastapi import APIRouter, Request
from starlette.responses import FileResponse, Response

from twinline.api.context import InContext, InWorkshop
from twinline.api.models import ScanOut, ScansOut

router = APIRouter(prefix="/scans", tags=["scans"])


@router.get("")
def list_scans(context: InContext) -> ScansOut:
    """All scans, newest first."""
    return ScansOut(scans=[context.scan(scan) for scan in context.workshop.scans.records()])


@router.get("/{scan_id}")
def get_scan(scan_id: str, context: InContext) -> ScanOut:
    """One scan."""
    return context.scan(context.workshop.scans.get(scan_id))


@router.delete("/{scan_id}", status_code=204)
def delete_scan(scan_id: str, workshop: InWorkshop) -> None:
    """Delete a scan and its files."""
    workshop.delete_scan(scan_id)


@router.head("/{scan_id}/exports/{name}", response_class=FileResponse, include_in_schema=False)
@router.get("/{scan_id}/exports/{name}", response_class=FileResponse)
def get_export(scan_id: str, name: str, request: Request, workshop: InWorkshop) -> Response:
    """Download a file of a scan; ranges and `If-None-Match` are answered."""
    scan = workshop.scans.get(scan_id)
    file = workshop.scans.file(scan_id, name)
    response = FileResponse(
        file.path,
        media_type=file.media_type,
        filename=f"{scan.name} {name}",
        stat_result=file.path.stat(),
        headers={"Cache-Control": "private, no-cache"},
    )
    etag = response.headers["etag"]
    known = {tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")}
    if etag in known or "*" in known:
        return Response(status_code=304, headers={"ETag": etag, "Cache-Control": "private, no-cache"})
    return response
