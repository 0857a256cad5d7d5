"""Around the page: limits on requests, static files, health, and how Gradio is started."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from demo.jobs import Studio
    from demo.settings import Settings

FOLDER = Path(__file__).parent
DRAIN = 1 << 28
"""Bytes of a refused request that are read before the connection is closed."""
SLACK = 64_000
"""Bytes of a request beside the upload itself."""


def prepare(settings: Settings) -> Path:
    """Set what must be set before Gradio is imported; returns the folder of visitors' files."""
    os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    os.environ.pop("GRADIO_VIBE_MODE", None)
    os.environ.pop("GRADIO_SHARE", None)
    root = Path(settings.folder or tempfile.mkdtemp(prefix="phy124-web-"))
    root.mkdir(parents=True, exist_ok=True)
    os.environ["GRADIO_TEMP_DIR"] = str(root)
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = int(settings.max_megapixels * 1e6)
    warnings.simplefilter("error", Image.DecompressionBombWarning)
    return root


class BodyLimit:
    """Refuses requests that are larger than an upload may be, however they say their size."""

    def __init__(self, app: ASGIApp, most: int) -> None:
        self.app, self.most = app, most

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 413, or pass the request on."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        length = dict(scope["headers"]).get(b"content-length", b"0")
        if not length.isdigit() or int(length) > self.most:
            return await self._refuse(scope, receive, send)
        read = 0

        async def counted() -> Message:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            if read > self.most:
                # To the application it looks as if the client had gone.
                return {"type": "http.disconnect"}
            return message

        await self.app(scope, counted, send)

    async def _refuse(self, scope: Scope, receive: Receive, send: Send) -> None:
        # Read to the end, keeping nothing: a client that is still sending hears no answer.
        read, more = 0, True
        while more and read < DRAIN:
            message = await receive()
            read, more = read + len(message.get("body", b"")), message.get("more_body", False)
        text = f"The file is larger than this page takes ({self.most / 1e6:.0f} MB)."
        answer = PlainTextResponse(text, 413, {"connection": "close"})
        await answer(scope, receive, send)


class Assets(StaticFiles):
    """Static files a browser may keep for an hour."""

    def file_response(self, *arguments: Any, **options: Any) -> Response:
        """As StaticFiles, with an age."""
        answer = super().file_response(*arguments, **options)
        answer.headers["cache-control"] = "public, max-age=3600"
        return answer


def routes(studio: Studio) -> list[Route | Mount]:
    """Our own addresses: scripts, pictures, the catalogue of scenes, health."""
    from demo.catalogue import catalogue

    offered = json.dumps(catalogue(studio.settings)).encode()

    async def scenes(_: Request) -> Response:
        return Response(offered, media_type="application/json")

    async def health(_: Request) -> Response:
        ready, visitors = studio.warm.is_set(), len(studio.visitors)
        return JSONResponse(
            {"status": "ok", "ready": ready, "busy": studio.busy, "visitors": visitors},
        )

    return [
        Route("/health", health),
        Route("/phy124/catalogue.json", scenes),
        Mount("/phy124/examples", Assets(directory=FOLDER / "examples")),
        Mount("/phy124/previews", Assets(directory=FOLDER / "previews")),
        Mount("/phy124/viewer", Assets(directory=FOLDER / "viewer")),
        Mount("/phy124/static", Assets(directory=FOLDER / "static")),
    ]


def launch(page: Any, studio: Studio, **options: Any) -> Any:
    """Start the page with everything a public server needs; returns Gradio's answer."""
    settings = studio.settings
    page.queue(max_size=settings.max_queue, default_concurrency_limit=1, api_open=False)
    limit = Middleware(BodyLimit, most=int(settings.max_bytes * 4 / 3) + SLACK)
    return page.launch(
        server_name=settings.host,
        server_port=settings.port,
        share=False,
        show_error=False,
        max_file_size=settings.max_bytes,
        allowed_paths=[],
        run_history=False,
        ssr_mode=False,
        footer_links=["api"],
        enable_monitoring=False,
        mcp_server=False,
        pwa=False,
        app_kwargs={"middleware": [limit], "routes": routes(studio)},
        **options,
    )
