"""Errors as problem+json (RFC 9457): the one table from the package's errors to HTTP."""

from collections.abc import Iterable, Mapping
from http import HTTPStatus
from types import MappingProxyType
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import BaseRoute
from starlette.types import ExceptionHandler

from twinline import errors
from twinline.api.models import FieldProblem, Problem

STATUS: Mapping[type[errors.TwinlineError], HTTPStatus] = MappingProxyType(
    {
        errors.NotFoundError: HTTPStatus.NOT_FOUND,
        errors.TransitionError: HTTPStatus.CONFLICT,
        errors.CancelledError: HTTPStatus.CONFLICT,
        errors.InputError: HTTPStatus.UNPROCESSABLE_ENTITY,
        errors.WorkerError: HTTPStatus.SERVICE_UNAVAILABLE,
        errors.OutputError: HTTPStatus.INSUFFICIENT_STORAGE,
        errors.TwinlineError: HTTPStatus.INTERNAL_SERVER_ERROR,
    }
)
"""Status of each class of error; the nearest base class counts."""

_HTTP_CODES = {
    400: "bad-request",
    403: "forbidden",
    404: "not-found",
    405: "method-not-allowed",
    413: "too-large",
    415: "unsupported-media-type",
    416: "range-not-satisfiable",
}
_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")


def status_of(error: errors.TwinlineError) -> HTTPStatus:
    """HTTP status of an error."""
    return next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)


def problem(
    status: int,
    code: str,
    detail: str,
    *,
    fields: Iterable[FieldProblem] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """A problem+json response."""
    title = HTTPStatus(status).phrase
    body = Problem(title=title, status=status, code=code, detail=detail, fields=list(fields) or None)
    return Response(
        body.model_dump_json(exclude_none=True),
        status_code=status,
        media_type="application/problem+json",
        headers={"Cache-Control": "no-store"} | dict(headers or {}),
    )


def allowed_methods(routes: Iterable[BaseRoute], scope: Mapping[str, Any]) -> list[str]:
    """All methods that a path answers, over all of its routes."""
    found = []
    for method in _METHODS:
        for route in routes:
            match, _ = route.matches({**scope, "method": method})
            if match.value == 2 and not getattr(route, "is_fallback", False):
                found.append(method)
                break
    return found


def install(app: FastAPI) -> None:
    """Make an application answer every error as problem+json."""

    async def on_error(_: Request, error: Exception) -> Response:
        assert isinstance(error, errors.TwinlineError)
        return problem(status_of(error), error.code, error.detail)

    async def on_invalid(_: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        fields = [_field_problem(dict(entry)) for entry in error.errors()]
        detail = "; ".join(f"{entry.field}: {entry.detail}" for entry in fields)
        return problem(422, "bad-request", f"The request cannot be used: {detail}.", fields=fields)

    async def on_http(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        detail, headers = str(error.detail), dict(error.headers or {})
        if error.status_code == 404 and detail == "Not Found":
            detail = f"There is nothing at {request.url.path}."
        if error.status_code == 405:
            # The framework names the methods of one route only.
            methods = allowed_methods(app.routes, request.scope)
            headers = {"Allow": ", ".join(methods) or headers.get("Allow", "")}
            detail = f"{request.method} is not possible here, only {headers['Allow']}."
        return problem(error.status_code, _HTTP_CODES.get(error.status_code, "http-error"), detail, headers=headers)

    async def on_bug(_: Request, __: Exception) -> Response:
        # The framework raises the error again afterwards, and the server logs it there.
        return problem(500, "internal", "The server broke on an error that nobody expected; see its log.")

    handlers: dict[type[Exception], ExceptionHandler] = {
        errors.TwinlineError: on_error,
        RequestValidationError: on_invalid,
        HTTPException: on_http,
        Exception: on_bug,
    }
    for kind, handler in handlers.items():
        app.add_exception_handler(kind, handler)


def _field_problem(entry: Mapping[str, Any]) -> FieldProblem:
    # The first part says "body" or "query"; tags of a union are no fields either.
    parts = [str(part) for part in entry["loc"][1:] if part not in ("reconstruct", "demo")]
    return FieldProblem(field=".".join(parts) or str(entry["loc"][0]), detail=str(entry["msg"]))
