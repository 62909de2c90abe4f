"""The API as a FastAPI application, without anything behind it."""

from typing import Any

from fastapi import APIRouter, FastAPI
from starlette.types import Lifespan

import twinline
from twinline.api import captures, events, jobs, problems, scans, system, view
from twinline.api.guard import Guard
from twinline.api.models import API, ChangeOut, Problem, SnapshotOut

_DESCRIPTION = (
    "Control server of a line-laser scanner. Times are RFC 3339 in UTC, lengths millimetres in the bed frame. "
    "Errors are problem+json with a stable `code`."
)


def build_api(lifespan: Lifespan[FastAPI] | None = None) -> FastAPI:
    """Make the application with its routes, errors and guard; the caller sets `state.context`."""
    app = FastAPI(
        title="Twinline",
        version=twinline.__version__,
        description=_DESCRIPTION,
        openapi_url=f"{API}/openapi.json",
        # Their pages load scripts from elsewhere.
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        # Names of functions are shorter than paths, and what a generated client calls its methods.
        generate_unique_id_function=lambda route: route.name,
    )
    routes = APIRouter(prefix=API, responses={"default": {"description": "Any error", **_PROBLEM}})
    for part in (system, captures, jobs, scans, view, events):
        routes.include_router(part.router)
    app.include_router(routes)
    problems.install(app)
    app.add_middleware(Guard)
    plain = app.openapi
    app.openapi = lambda: _with_events(plain())  # type: ignore[method-assign]
    return app


_PROBLEM: dict[str, Any] = {
    "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
}


def _with_events(document: dict[str, Any]) -> dict[str, Any]:
    """Add what the framework cannot know: the data of the events, and the errors."""
    schemas = document["components"]["schemas"]
    for model in (SnapshotOut, ChangeOut, Problem):
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        for name, part in schema.pop("$defs", {}).items():
            schemas.setdefault(name, part)
        schemas[model.__name__] = schema
    # A request that does not fit is answered with the problem that every route declares.
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for path in document["paths"].values():
        for operation in path.values():
            operation["responses"].pop("422", None)
    return document
