"""Captures: uploaded as a zip, or a folder of the server's machine."""

import json
from pathlib import Path
from typing import Annotated, Any

import anyio
from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.exceptions import HTTPException

from twinline.api.context import ApiContext, InContext, InWorkshop
from twinline.api.guard import UPLOAD_TYPES
from twinline.api.models import API, CaptureFolderIn, CaptureOut, CapturesOut
from twinline.errors import InputError, OutputError
from twinline.operations.captures import CaptureRecord

router = APIRouter(prefix="/captures", tags=["captures"])

_UPLOAD_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/zip": {"schema": {"type": "string", "format": "binary"}},
            "application/json": {"schema": CaptureFolderIn.model_json_schema()},
        },
    }
}
_RIG_BODY: dict[str, Any] = {
    "requestBody": {"required": True, "content": {"application/json": {"schema": {"type": "object"}}}}
}


@router.get("")
def list_captures(workshop: InWorkshop) -> CapturesOut:
    """All captures, newest first."""
    return CapturesOut(captures=[CaptureOut.of(record) for record in workshop.captures.records()])


@router.post("", status_code=201, openapi_extra=_UPLOAD_BODY)
async def add_capture(
    request: Request,
    response: Response,
    context: InContext,
    name: Annotated[str, Query(max_length=200, description="What to call an uploaded zip in messages.")] = "The zip",
) -> CaptureOut:
    """Upload a zip of a capture folder as the raw body, or name a folder of the server's machine as JSON."""
    content_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if content_type in UPLOAD_TYPES:
        record = await _receive(request, context, Path(name).name or "The zip")
    elif content_type == "application/json":
        folder = Path(_folder_of(await request.body()).path)
        record = await to_thread.run_sync(context.workshop.add_folder, folder)
    else:
        raise HTTPException(
            415, "Send a zip with Content-Type application/zip, or {'path': ...} with Content-Type application/json."
        )
    response.headers["Location"] = f"{API}/captures/{record.id}"
    return CaptureOut.of(record)


@router.get("/{capture_id}")
def get_capture(capture_id: str, workshop: InWorkshop) -> CaptureOut:
    """One capture."""
    return CaptureOut.of(workshop.captures.get(capture_id))


@router.delete("/{capture_id}", status_code=204)
def delete_capture(capture_id: str, workshop: InWorkshop) -> None:
    """Delete an uploaded or rendered capture; a local folder is only forgotten."""
    workshop.delete_capture(capture_id)


@router.put("/{capture_id}/rig", openapi_extra=_RIG_BODY)
async def put_rig(capture_id: str, request: Request, workshop: InWorkshop) -> CaptureOut:
    """Keep a rig.json for a capture; it is used before the capture's own."""
    data = await request.body()
    return CaptureOut.of(await to_thread.run_sync(workshop.give_rig, capture_id, data))


async def _receive(request: Request, context: ApiContext, name: str) -> CaptureRecord:
    limit = context.upload_max_bytes
    too_large = HTTPException(413, f"{name} is larger than {limit} bytes; name a local folder instead, or split it.")
    length = request.headers.get("content-length", "0")
    if length.isdigit() and int(length) > limit:
        raise too_large
    path = await to_thread.run_sync(context.workshop.incoming_file)
    try:
        received = 0
        async with await anyio.open_file(path, "wb") as file:
            async for block in request.stream():
                received += len(block)
                if received > limit:
                    raise too_large
                await file.write(block)
        if not received:
            raise InputError(f"{name} is empty; send the zip as the body of the request.", code="bad-request")
        return await to_thread.run_sync(context.workshop.add_upload, path, name)
    except OSError as error:
        raise OutputError(f"{name} cannot be kept: {error.strerror or error}.") from error
    finally:
        await anyio.Path(path).unlink(missing_ok=True)


def _folder_of(data: bytes) -> CaptureFolderIn:
    try:
        return CaptureFolderIn.model_validate(json.loads(data))
    except ValidationError as error:
        raise RequestValidationError([{**entry, "loc": ("body", *entry["loc"])} for entry in error.errors()]) from None
    except ValueError as error:
        raise InputError(f"The body is not JSON: {error}.", code="bad-request") from None
