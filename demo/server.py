"""Start the web server with its routes and middleware, and shut it down at the end."""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import socket
import threading
import time
import warnings
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from phy124.errors import InputError
from phy124.io.html import VIEWER

from .bodies import BodyLimit
from .connections import allow_connections, limit_connections
from .guard import Doorkeeper, Headed, cookie_of, own_names, split_names
from .settings import SLACK
from .source import SMALLER
from .touch import socket_route
from .touch.relay import LARGEST_MESSAGE
from .traffic import RECEIVED, RECEIVED_EACH, TOOLS, TOOLS_EACH, UPLOADS, Present, Streams, Turns
from .uploads import ADDRESS, upload_route

if TYPE_CHECKING:
    from .jobs import Studio
    from .settings import Settings
    from .visitors import Visitors

FOLDER = Path(__file__).parent
LOG = logging.getLogger("phy124.web")
GONE = (
    '<!doctype html><html lang="en"><title>phy124</title>'
    "<p>This result is no longer kept. Ask whoever sent the link to make it again.</p></html>"
)
"""Page for a link whose result has been removed."""
DIGITS = 9
"""Largest number of digits of a number in a URL; Python refuses to parse thousands of digits."""
LOOPBACK = ("localhost", "127.0.0.1", "::1")
SWEEP = 5.0
"""Interval between two checks for visitors who have left the page [s]."""
NAMES = ("NO_PROXY", "no_proxy")
"""Environment variables that list hosts reached without a proxy; programs read either variable."""


def prepare(settings: Settings, root: Path) -> None:
    """Set the environment variables that Gradio reads when it is imported."""
    reach_itself(settings.host)
    os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    os.environ.pop("GRADIO_VIBE_MODE", None)
    os.environ.pop("GRADIO_SHARE", None)
    os.environ["GRADIO_TEMP_DIR"] = str(root)
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = int(settings.max_megapixels * 1e6)
    warnings.simplefilter("error", Image.DecompressionBombWarning)


def check_address(settings: Settings) -> None:
    """Check that the page can listen at the address in its settings.

    Raises:
        InputError: The port is in use, or this machine has no such address.
    """
    host, port = settings.host.strip("[]"), settings.port
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            limit, remedy = "Another program uses this port.", f"Try --port {port % 65535 + 1}."
            raise InputError("port", port, limit, remedy) from None
        if error.errno == errno.EACCES:
            limit = "This user is not allowed to listen at this port."
            raise InputError("port", port, limit, "Give a port of at least 1024.") from None
        limit = "This machine cannot listen at this address."
        raise InputError(
            "host",
            host,
            limit,
            "With 127.0.0.1 only this machine can connect; with 0.0.0.0 any machine can.",
        ) from None


class Assets(StaticFiles):
    """Static files that a browser may cache for an hour."""

    def file_response(self, *arguments: Any, **options: Any) -> Response:
        """Return the response of StaticFiles with a header for the maximum age."""
        answer = super().file_response(*arguments, **options)
        answer.headers["cache-control"] = "public, max-age=3600"
        return answer


def shared_route(visitors: Visitors) -> Callable[[Request], Awaitable[Response]]:
    """Return the route that shows the player of a result to anyone who has the link."""

    async def shared(request: Request) -> Response:
        path = visitors.find_shared(request.path_params["token"])
        if path is None:
            return HTMLResponse(GONE, 404)
        return FileResponse(path, media_type="text/html")

    return shared


def routes(studio: Studio) -> list[BaseRoute]:
    """Return the page's own routes: uploads, jobs, live runs, scripts, pictures, scenes, health."""
    from .catalogue import catalogue

    offered = json.dumps(catalogue(studio.settings)).encode()

    async def scenes(_: Request) -> Response:
        return Response(offered, media_type="application/json")

    async def health(_: Request) -> Response:
        ready, visitors = studio.warm.is_set(), len(studio.visitors)
        return JSONResponse(
            {"status": "ok", "ready": ready, "busy": studio.busy, "visitors": visitors},
        )

    async def progress(request: Request) -> Response:
        job = studio.visitors.job(request.path_params["name"])
        if job is None:
            return JSONResponse({"state": "gone"}, 404)
        seen = request.query_params.get("seen", "0")[:DIGITS]
        data = job.progress.data(int(seen) if seen.isdecimal() else 0)
        wait = {"place": job.place, "wait": job.seconds_to_start}
        return JSONResponse({**data, **wait}, headers={"cache-control": "no-store"})

    async def here(request: Request) -> Response:
        visitor = studio.visitors.find(cookie_of(request) or "")
        data = {"known": visitor is not None, "visitor": visitor and visitor.folder.name}
        return JSONResponse(data, headers={"cache-control": "no-store"})

    return [
        Route("/health", health),
        Route("/phy124/shared/{token}", shared_route(studio.visitors)),
        upload_route(studio),
        socket_route(studio.touches, studio.settings),
        Route("/phy124/jobs/{name}", progress),
        Route("/phy124/here", here),
        Route("/phy124/catalogue.json", scenes),
        Mount("/phy124/examples", Assets(directory=FOLDER / "examples")),
        Mount("/phy124/previews", Assets(directory=FOLDER / "previews")),
        Mount("/phy124/viewer", Assets(directory=VIEWER)),
        Mount("/phy124/static", Assets(directory=FOLDER / "static")),
    ]


def doors(studio: Studio, connections: int) -> list[Middleware]:
    """Return the middleware, in the order in which a request passes it."""
    # Imported here, because it imports Gradio, whose environment must be prepared first.
    from .sessions import Asked

    settings, space = studio.settings, os.environ.get("SPACE_HOST", "")
    other = settings.max_body, f"{settings.too_large} {settings.make_smaller}"
    most = settings.max_file_bytes + SLACK, f"{settings.file_too_large} {SMALLER}"
    hosts, origins = own_names(settings.hosts, space), split_names(settings.hosts, space)
    return [
        Middleware(Asked),
        Middleware(Headed, embedded=bool(space)),
        Middleware(Doorkeeper, hosts=hosts, origins=origins),
        Middleware(Present, asking=studio.visitors.asking),
        Middleware(Streams, most=connections // 2, here=studio.visitors.is_here),
        Middleware(BodyLimit, uploads=ADDRESS, other=other, most=most),
        Middleware(Turns),
        Middleware(Turns, at=UPLOADS, together=RECEIVED, each=RECEIVED_EACH),
        Middleware(
            Turns, at=re.compile(rf"{TOOLS}\b"), together=settings.max_queue, each=TOOLS_EACH
        ),
    ]


def launch(page: Any, studio: Studio, **options: Any) -> None:
    """Serve the page, with the protections of a public server, until the process ends."""
    # Imported here, because it imports Gradio, whose environment must be prepared first.
    from .sessions import Sessions

    settings = studio.settings
    page.queue(max_size=settings.max_queue, default_concurrency_limit=1, api_open=False)
    connections = allow_connections()
    with limit_connections(connections), without_cors():
        page.launch(
            server_name=settings.host,
            server_port=settings.port,
            share=False,
            quiet=True,  # otherwise Gradio would suggest a public link
            _frontend=False,  # otherwise Gradio would give up after 3 s
            show_error=False,
            max_file_size=settings.max_file_bytes,
            allowed_paths=[],
            run_history=False,
            ssr_mode=False,
            footer_links=["api"],
            enable_monitoring=False,
            mcp_server=False,  # demo/tools.py replaces Gradio's own MCP server
            pwa=False,
            prevent_thread_lock=True,
            app_kwargs={
                "middleware": doors(studio, connections),
                "routes": [*routes(studio), *tool_routes(page, studio)],
            },
            **options,
        )
    print(
        f"The page is at {page.local_url}", flush=True
    )  # printed immediately, even if the output goes to a file
    sessions = page.app.state_holder = page.state_holder = Sessions(page, studio.visitors)
    # uvicorn reads these attributes for each new connection.
    page.server.config.ws_max_size = LARGEST_MESSAGE
    # The data that the page sends is already compressed or hardly compressible.
    page.server.config.ws_per_message_deflate = False
    try:
        while page.server.thread.is_alive():
            due = time.monotonic() + SWEEP
            page.server.thread.join(SWEEP)
            sessions.sweep()
            _sweep(studio, max(0.0, time.monotonic() - due))
    finally:
        studio.touches.close()
        studio.visitors.close()
        page.close(verbose=False)


def tool_routes(page: Any, studio: Studio) -> list[BaseRoute]:
    """Return the routes of the tools for agents; empty if the tools are off or `mcp` is missing."""
    if not studio.settings.mcp:
        return []
    if find_spec("mcp") is None:
        LOG.warning("Agents get no tools: the package mcp is not installed.")
        return []
    # This module is imported here, because its import takes a second.
    from .tools import ToolServer

    return ToolServer(page, studio).routes()


@contextmanager
def without_cors() -> Iterator[None]:
    """Create apps without Gradio's CORS middleware within this context.

    Gradio's middleware would let other sites read the answers of the page. If the middleware were
    removed after the start, all middleware would be built again, and the counts of streams and
    requests would be lost.
    """
    from gradio import routes

    names, name = routes.__dict__, "CustomCORSMiddleware"
    usual, names[name] = names[name], lambda app, **_: app
    try:
        yield
    finally:
        names[name] = usual


def _sweep(studio: Studio, late: float) -> None:
    try:
        studio.visitors.sweep(late)
    except OSError:
        # The page continues; the next removal of inactive visitors tries again.
        LOG.exception("inactive visitors could not be removed")


def end_on_signals() -> None:
    """Make SIGTERM end the page like Ctrl-C, so that all files are removed."""
    import signal

    def end(number: int, _: Any) -> None:
        raise SystemExit(128 + number)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, end)


def reach_itself(host: str) -> None:
    """Let this process reach the page at `host` without a proxy.

    Gradio requests the page when it starts. Proxies that httpx cannot use, such as SOCKS without
    its package, are removed with a warning, because Gradio's client would fail to start.
    """
    known = ",".join(filter(None, (os.environ.get(name) for name in NAMES))).split(",")
    excepted = [*(name.strip() for name in known), *LOOPBACK, host]
    for name in NAMES:
        os.environ[name] = ",".join(filter(None, dict.fromkeys(excepted)))
    if problem := _problem():
        for name in [name for name in os.environ if name.lower().endswith("_proxy")]:
            del os.environ[name]
        LOG.warning("The page ignores the proxies set in the environment: %s", problem)


def _problem() -> str:
    import httpx

    try:
        httpx.Client().close()
    except (ImportError, ValueError, httpx.InvalidURL) as error:
        return str(error)
    return ""
