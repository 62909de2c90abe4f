"""The control panel's built files, and the answer to every path that no route knows."""

from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Match, Mount
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from twinline.api.problems import allowed_methods

PANEL_FOLDER = Path(__file__).parent / "panel"

_NOT_BUILT = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Twinline</title>
<style>body{font:16px/1.5 system-ui,sans-serif;max-width:40em;margin:4em auto;padding:0 1em}</style></head>
<body><h1>Twinline is running</h1>
<p>The control panel has not been built. In the project's folder run <code>./dev web</code> and reload this page.</p>
<p>Meanwhile: <a href="/view/">3-D view</a>, <a href="/api/v1/system">REST</a>,
<a href="/api/v1/openapi.json">its description</a>.</p></body></html>
"""


class PanelFiles:
    """ASGI application for the end of the route table.

    Parameters
    ----------
    folder
        The built panel; without an ``index.html`` there, a page says how to build it.
    """

    def __init__(self, folder: Path = PANEL_FOLDER) -> None:
        self._folder = folder
        self._files = StaticFiles(directory=folder, check_dir=False)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that no route took."""
        if scope["type"] != "http":
            raise HTTPException(404)
        response = await self._answer(Request(scope, receive))
        await response(scope, receive, send)

    async def _answer(self, request: Request) -> Response:
        path = request.url.path
        if path.startswith(("/api/", "/view/")) or path in ("/api", "/view"):
            raise HTTPException(405 if self._known(request) else 404)
        if request.method not in ("GET", "HEAD"):
            raise HTTPException(405, headers={"Allow": "GET, HEAD"})
        if not (self._folder / "index.html").is_file():
            if path != "/":
                raise HTTPException(404)
            return HTMLResponse(_NOT_BUILT)
        return await self._file(request)

    async def _file(self, request: Request) -> Response:
        name = request.url.path.lstrip("/")
        # Pages of the panel have addresses of their own; all are the one document.
        if not name or "." not in name.rpartition("/")[2]:
            name = "index.html"
        response = await self._files.get_response(name, request.scope)
        # Built files carry a hash in their name; the document that names them does not.
        lasting = name.startswith("assets/")
        response.headers["Cache-Control"] = "public, max-age=31536000, immutable" if lasting else "no-cache"
        return response

    @staticmethod
    def _known(request: Request) -> bool:
        app = request.app
        assert isinstance(app, Starlette)
        return bool(allowed_methods(app.routes, request.scope))


class PanelMount(Mount):
    """Takes every path; not counted when the methods of a path are looked up."""

    is_fallback = True

    def __init__(self, folder: Path = PANEL_FOLDER) -> None:
        super().__init__("/", app=PanelFiles(folder))

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match HTTP only: an unknown WebSocket is refused by the framework."""
        if scope["type"] != "http":
            return Match.NONE, {}
        return super().matches(scope)
