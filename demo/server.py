"""Starts the page: its own routes, the middleware in front of it, and how it ends."""

from __future__ import annotations

import errno
import json
import logging
import os
import socket
import threading
import warnings
from collections.abc import Awaitable, Callable
from functools import partial
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
from .connections import Patient, allow_connections
from .gaussian_files import SMALLER
from .guard import Doorkeeper, Headed, listed, own_names
from .identity import cookie_of
from .proxies import reach_itself
from .streams import Streams
from .touch import socket_route
from .touch.orders import LARGEST
from .turns import RECEIVED, RECEIVED_EACH, UPLOADS, Turns
from .uploads import ADDRESS, upload_route

if TYPE_CHECKING:
    from .jobs import Studio
    from .settings import Settings
    from .visitors import Visitors

FOLDER = Path(__file__).parent
LOG = logging.getLogger("phy124.web")
SLACK = 64_000
"""Size of a request in addition to the upload itself [bytes]."""
GONE = (
    '<!doctype html><html lang="en"><title>phy124</title>'
    "<p>This result is no longer kept. Ask whoever sent the link to make it again.</p></html>"
)
"""Page of a link whose result has gone."""
DIGITS = 9
"""Of a number in an address; Python refuses to read one of thousands."""
LOOPBACK = ("localhost", "127.0.0.1", "::1")
SWEEP = 5.0
"""Time between two searches for visitors who have left [s]."""


def prepare(settings: Settings, root: Path) -> None:
    """Set the environment variables that Gradio reads when it is imported."""
    reach_itself(settings.host)
    os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    os.environ.pop("GRADIO_VIBE_MODE", None)
    os.environ.pop("GRADIO_SHARE", None)
    os.environ["GRADIO_TEMP_DIR"] = str(root)
    ask_this_machine_directly()
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = int(settings.max_megapixels * 1e6)
    warnings.simplefilter("error", Image.DecompressionBombWarning)


def check_address(settings: Settings) -> None:
    """Check that the page can listen where it is to.

    Raises:
        InputError: Another program does so already, or this machine has no such address.
    """
    host, port = settings.host.strip("[]"), settings.port
    try:
        socket.create_server((host, port), family=_family(host)).close()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            limit, remedy = "Another program listens there.", f"Try --port {port % 65535 + 1}."
            raise InputError("port", port, limit, remedy) from None
        if error.errno == errno.EACCES:
            limit = "This user may not listen there."
            raise InputError("port", port, limit, "Give one from 1024 on.") from None
        limit = "This machine cannot listen there."
        raise InputError("host", host, limit, "127.0.0.1 is itself, 0.0.0.0 all of it.") from None


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def ask_this_machine_directly() -> None:
    """Keep requests to this machine from proxies: Gradio asks its own page whether it is there."""
    for name in ("NO_PROXY", "no_proxy"):
        others = filter(None, os.environ.get(name, "").split(","))
        os.environ[name] = ",".join(dict.fromkeys([*others, *LOOPBACK]))
    if find_spec("socksio") is None:
        # Gradio's client would not even begin.
        for name in [name for name in os.environ if name.lower().endswith("_proxy")]:
            if os.environ[name].lower().startswith("socks"):
                del os.environ[name]


class Assets(StaticFiles):
    """Static files a browser may keep for an hour."""

    def file_response(self, *arguments: Any, **options: Any) -> Response:
        """The response of StaticFiles, with a maximum age."""
        answer = super().file_response(*arguments, **options)
        answer.headers["cache-control"] = "public, max-age=3600"
        return answer


def shared_route(visitors: Visitors) -> Callable[[Request], Awaitable[Response]]:
    """Shows the player of a result to anyone who has its link."""

    async def shared(request: Request) -> Response:
        path = visitors.shared(request.path_params["token"])
        if path is None:
            return HTMLResponse(GONE, 404)
        return FileResponse(path, media_type="text/html")

    return shared


def routes(studio: Studio) -> list[BaseRoute]:
    """The page's own routes: uploads, jobs, live runs, scripts, pictures, the scenes, health."""
    from .catalogue import catalogue

    offered = json.dumps(catalogue(studio.settings)).encode()

    async def scenes(_: Request) -> Response:
        return Response(offered, media_type="application/json")

    async def health(_: Request) -> Response:
        ready, visitors = studio.warm.is_set(), len(studio.visitors)
        return JSONResponse(
            {"status": "ok", "ready": ready, "busy": studio.busy, "visitors": visitors},
        )

    async def job(request: Request) -> Response:
        """The progress of a job; also counts as a sign of life."""
        found = studio.visitors.job(request.path_params["name"])
        if found is None:
            return JSONResponse({"state": "gone"}, 404)
        seen = request.query_params.get("seen", "0")[:DIGITS]
        told = found.progress.data(int(seen) if seen.isdecimal() else 0)
        return JSONResponse({**told, "place": found.place}, headers={"cache-control": "no-store"})

    async def here(request: Request) -> Response:
        """An open page reports every few seconds that it is still open; it learns whether what it
        had here is still here.
        """
        known = studio.visitors.known(cookie_of(request) or "")
        told = {"known": known is not None, "visitor": known and known.folder.name}
        return JSONResponse(told, headers={"cache-control": "no-store"})

    return [
        Route("/health", health),
        Route("/phy124/shared/{token}", shared_route(studio.visitors)),
        upload_route(studio),
        socket_route(studio.touches, studio.settings),
        Route("/phy124/jobs/{name}", job),
        Route("/phy124/here", here),
        Route("/phy124/catalogue.json", scenes),
        Mount("/phy124/examples", Assets(directory=FOLDER / "examples")),
        Mount("/phy124/previews", Assets(directory=FOLDER / "previews")),
        Mount("/phy124/viewer", Assets(directory=VIEWER)),
        Mount("/phy124/static", Assets(directory=FOLDER / "static")),
    ]


def doors(studio: Studio, connections: int) -> list[Middleware]:
    """What each request passes before it reaches the page, in that order.

    Args:
        studio: What all visitors share.
        connections: Largest number of connections.
    """
    # Not before Gradio's environment is prepared.
    from .sessions import Asked

    settings, space = studio.settings, os.environ.get("SPACE_HOST", "")
    # A program may send a picture as a data: URL.
    other = int(settings.max_bytes * 4 / 3) + SLACK, f"{settings.too_large} {settings.make_smaller}"
    most = settings.max_file_bytes + SLACK, f"{settings.file_too_large} {SMALLER}"
    hosts, origins = own_names(settings.hosts, space), listed(settings.hosts, space)
    return [
        Middleware(Asked),
        Middleware(Headed, embedded=bool(space)),
        Middleware(Doorkeeper, hosts=hosts, origins=origins),
        Middleware(Streams, most=connections // 2, here=studio.visitors.is_here),
        Middleware(BodyLimit, uploads=ADDRESS, other=other, most=most),
        Middleware(Turns),
        Middleware(Turns, at=UPLOADS, together=RECEIVED, each=RECEIVED_EACH),
    ]


def launch(page: Any, studio: Studio, **options: Any) -> None:
    """Serve the page with everything that a public server needs, until the process is to end."""
    # Not before Gradio's environment is prepared.
    from .sessions import Sessions

    settings = studio.settings
    page.queue(max_size=settings.max_queue, default_concurrency_limit=1, api_open=False)
    connections = allow_connections()
    page.launch(
        server_name=settings.host,
        server_port=settings.port,
        share=False,
        _frontend=False,  # else it gives up if its own first answer takes 3 s on a busy machine
        show_error=False,
        max_file_size=settings.max_file_bytes,
        allowed_paths=[],
        run_history=False,
        ssr_mode=False,
        footer_links=["api"],
        enable_monitoring=False,
        mcp_server=False,
        pwa=False,
        prevent_thread_lock=True,
        app_kwargs={
            "middleware": doors(studio, connections),
            "routes": routes(studio),
        },
        **options,
    )
    _share_with_nobody(page.app)
    sessions = page.app.state_holder = page.state_holder = Sessions(page, studio.visitors)
    # uvicorn looks this up for each new connection.
    page.server.config.http_protocol_class = partial(Patient, most=connections)
    page.server.config.ws_max_size = LARGEST
    # What is sent is dense already.
    page.server.config.ws_per_message_deflate = False
    try:
        while page.server.thread.is_alive():
            page.server.thread.join(SWEEP)
            sessions.sweep()
            _sweep(studio)
    finally:
        studio.touches.close()
        studio.visitors.close()
        page.close(verbose=False)


def _share_with_nobody(app: Any) -> None:
    """Take out what lets pages of other sites read answers, which Gradio puts before all else."""
    from gradio.route_utils import CustomCORSMiddleware

    kept = [each for each in app.user_middleware if each.cls is not CustomCORSMiddleware]
    app.user_middleware = kept
    app.middleware_stack = app.build_middleware_stack()


def _sweep(studio: Studio) -> None:
    try:
        studio.visitors.sweep()
    except OSError:
        # The page goes on, and this is tried again some seconds later.
        LOG.exception("silent visitors could not be removed")


def end_on_signals() -> None:
    """Let SIGTERM end the page as Ctrl-C does, so that nothing is left behind."""
    import signal

    def end(number: int, _: Any) -> None:
        raise SystemExit(128 + number)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, end)
