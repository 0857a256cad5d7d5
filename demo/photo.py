"""Gradio components for uploaded files. The size of a file is checked before it is decoded.

Gradio's own components would decode a picture before any check, download it from any URL, and
accept data: URLs beyond `max_file_size`.
"""

from __future__ import annotations

import base64
import binascii
from typing import TYPE_CHECKING, Any

import gradio as gr
from gradio import processing_utils
from gradio.data_classes import FileData, ImageData
from pydantic import ValidationError

from phy124.errors import InputError

if TYPE_CHECKING:
    from .jobs import Studio

NO_FILE = "This is not a file. Send the file itself, by handle_file(PATH) in Python."
BROKEN = "The picture's data: URL is broken. Send the file itself."
FETCHES_NOTHING = "This page downloads nothing from an address. Send the file itself."


def _refusing(model: Any, name: str) -> Any:
    """Return a model that refuses values that are not files, and names the argument `name`."""

    class Sent(model):
        # This is no pydantic validator, because the calling program would not see its exceptions.
        @classmethod
        def model_validate(cls, obj: Any, **options: Any) -> Any:
            try:
                return super().model_validate(obj, **options)
            except ValidationError:
                raise refusal(f"{name}: {NO_FILE}") from None

    return Sent


def photo(studio: Studio, label: str) -> gr.Image:
    """Create a `gr.Image` whose value is the path of the uploaded file; the file is not decoded.

    Error messages begin with the label, which is the name of the argument.
    """
    image = gr.Image(type="filepath", label=label)
    image.data_model = _refusing(ImageData, label)

    def preprocess(payload: Any) -> str | None:
        if payload is None:
            return None
        if not (payload.path or payload.url):  # Gradio accepts any object and drops its keys.
            raise refusal(f"{label}: {NO_FILE}")
        if payload.url and payload.url.startswith("data:"):
            return save_data_url(payload.url, studio, label)
        return payload.path

    image.preprocess = preprocess
    return _describe_as_file(image, "picture.png")


def film(label: str) -> gr.File:
    """Create a `gr.File` whose value is the path of the uploaded file; the file is not decoded."""
    file = gr.File(label=label)
    file.data_model = _refusing(FileData, label)

    def preprocess(payload: Any) -> str | None:
        if payload is None:
            return None
        if (payload.url or payload.path or "").startswith("data:"):
            raise refusal(f"{label}: {NO_FILE}")
        return payload.path

    file.preprocess = preprocess
    return _describe_as_file(file, "film.mp4")


def _describe_as_file(component: Any, name: str) -> Any:
    example = {"path": name, "meta": {"_type": "gradio.FileData"}}
    component.api_info = FileData.model_json_schema
    component.example_payload = lambda: example
    return component


def refusal(text: str) -> gr.Error:
    """Create the error that a program receives; it is not logged, as the server did not fail."""
    return gr.Error(text, print_exception=False)


def fetch_nothing(page: gr.Blocks) -> None:
    """Prevent the page from downloading URLs that a request contains."""

    async def refuse(url: str) -> Any:
        raise refusal(f"file: {FETCHES_NOTHING}")

    # The function in the module is also replaced, because Gradio copies unchanged panels for each
    # session.
    processing_utils.async_ssrf_protected_get = refuse
    for block in page.blocks.values():
        moved = block.async_move_resource_to_block_cache
        name = getattr(block, "label", None) or "file"

        async def local(url_or_file_path: Any, moved: Any = moved, name: str = name) -> str | None:
            if "://" in str(url_or_file_path or "")[:12]:
                raise refusal(f"{name}: {FETCHES_NOTHING}")
            return await moved(url_or_file_path)

        block.async_move_resource_to_block_cache = local


def count_values(page: gr.Blocks) -> None:
    """Refuse requests of programs that have too few or too many values for an endpoint."""

    def check(block_fn: Any, inputs: list[Any]) -> None:
        if len(inputs) == len(block_fn.inputs) or block_fn.api_visibility != "public":
            return usual(block_fn, inputs)
        names, endpoint = [b.label for b in block_fn.inputs if not b.skip_api], block_fn.api_name
        raise refusal(
            f"{endpoint}: This endpoint has {len(names)} arguments ({', '.join(names)}), but the "
            f"request has {len(inputs)}. Give all of them in this order, or give some of them by "
            f"name to /gradio_api/call/v2/{endpoint}."
        )

    usual = page.validate_inputs
    page.validate_inputs = check


def save_data_url(url: str, studio: Studio, name: str) -> str:
    """Store the picture of a data: URL as an upload; return the path of the upload.

    Args:
        url: The data: URL.
        studio: Stores the picture.
        name: Name of the argument. Error messages begin with it.

    Raises:
        gr.Error: The URL is broken or too large, or there is not enough disk space.
    """
    limits = studio.settings
    head, comma, text = url.partition(",")
    if not comma or not head.endswith(";base64"):
        raise refusal(f"{name}: {BROKEN}")
    if len(text) * 3 / 4 > limits.max_bytes:
        raise refusal(f"{name}: {limits.too_large} {limits.make_smaller}")
    try:
        data = base64.b64decode(text, validate=True)
        return str(studio.visitors.store(None, data, ""))
    except binascii.Error:
        raise refusal(f"{name}: {BROKEN}") from None
    except InputError as error:
        raise refusal(f"{name}: {error.limit} {error.remedy}") from None
