"""Store uploads (pictures, videos, files of Gaussians) in the folder of their visitor.

This route replaces Gradio's route, which does not assign uploads to visitors.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from phy124.errors import InputError
from phy124.io.formats import object_endings
from phy124.studies.fit.video import FILMS

from .guard import address_of, cookie_of
from .source import SMALLER

if TYPE_CHECKING:
    from .jobs import Studio

ADDRESS = "/gradio_api/upload"
SUFFIXES = {".png", ".jpg", ".jpeg", ".webp", ".heic", ".heif", ".avif", *FILMS, *object_endings()}
"""File name suffixes that are kept; other suffixes are removed."""
NOT_READ = {
    ".ksplat": "Save it as .ply or .spz in the program that made it, or convert it with"
    " splat-transform; then send the new file.",
}
"""Advice for visitors who upload a file that cannot be read, by the file's suffix."""
MOST = 4


def upload_route(studio: Studio) -> Route:
    """Return the route that stores files and answers with their paths."""

    async def receive(request: Request) -> Response:
        try:
            async with request.form(max_files=MOST, max_fields=MOST) as form:
                sent = [part for _, part in form.multi_items() if isinstance(part, UploadFile)]
                paths = [await _keep(studio, request, part) for part in sent]
        except HTTPException as error:
            return PlainTextResponse(str(error.detail), 400)
        except InputError as error:
            return PlainTextResponse(f"{error.limit} {error.remedy}", _status(error))
        return JSONResponse(paths)

    return Route(ADDRESS, receive, methods=["POST"])


async def _keep(studio: Studio, request: Request, part: UploadFile) -> str:
    limits = studio.settings
    # Pictures have a lower size limit, which is checked when they are used.
    if (part.size or 0) > limits.max_file_bytes:
        raise InputError("image", "large", limits.file_too_large, SMALLER)
    suffix = Path(part.filename or "").suffix.lower()
    if suffix in NOT_READ:
        raise InputError(
            "file", suffix, f"A {suffix} file cannot be read on this page.", NOT_READ[suffix]
        )
    ending = suffix if suffix in SUFFIXES else ""
    visitor, address = cookie_of(request), address_of(request)
    store = studio.visitors.store
    return str(await run_in_threadpool(store, visitor, part.file, ending, address))


def _status(error: InputError) -> int:
    return 413 if error.value == "large" else 415 if error.value in NOT_READ else 503
