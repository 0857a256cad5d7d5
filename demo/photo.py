"""Components for files that programs upload; the size of a file is checked before it is decoded.

Gradio's own components would decode a picture before any check, download it from any URL, and
accept data: URLs beyond `max_file_size`.
"""

from __future__ import annotations

import base64
import binascii
from typing import TYPE_CHECKING, Any, ClassVar

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


class Sent(ImageData):
    """A picture that a program sent; a value that is not a file is refused with a message."""

    name: ClassVar[str] = "image"
    """Name of the argument, for error messages."""

    # Not a pydantic validator, because the program would not see the exceptions of a validator.
    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Sent:
        """Validate the picture; raise gr.Error if it is not a file."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError:
            raise refusal(f"{cls.name}: {NO_FILE}") from None


def photo(studio: Studio, label: str = "image", **options: Any) -> gr.Image:
    """Create a `gr.Image` whose value is the path of the uploaded file; the file is not decoded.

    Args:
        studio: Stores the pictures that requests contain.
        label: Name of the argument. Error messages begin with it.
        options: Options of `gr.Image`.
    """

    class Named(Sent):
        name: ClassVar[str] = label

    image = gr.Image(type="filepath", label=label, **options)
    image.data_model = Named

    def preprocess(payload: Any) -> str | None:
        """Return the file's path; raise gr.Error if a data: URL is broken or too large."""
        if payload is None:
            return None
        if payload.url and payload.url.startswith("data:"):
            return save_data_url(payload.url, studio, label)
        return payload.path

    image.preprocess = preprocess
    return _describe_as_file(image, "picture.png")


class SentVideo(FileData):
    """A video that a program sent; a value that is not a file is refused with a message."""

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> SentVideo:
        """Validate the video; raise gr.Error if it is not a file."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError:
            raise refusal(f"video: {NO_FILE}") from None


def film(**options: Any) -> gr.File:
    """Create a `gr.File` whose value is the path of the uploaded video; the video is not
    decoded.
    """
    file = gr.File(**options)
    file.data_model = SentVideo

    def preprocess(payload: Any) -> str | None:
        """Return the file's path; raise gr.Error if it is a data: URL."""
        if payload is None:
            return None
        if (payload.url or payload.path or "").startswith("data:"):
            raise refusal(f"video: {NO_FILE}")
        return payload.path

    file.preprocess = preprocess
    return _describe_as_file(file, "film.mp4")


def _describe_as_file(component: Any, name: str) -> Any:
    """Describe a component in the API as a file; the component accepts no URL."""
    example = {"path": name, "meta": {"_type": "gradio.FileData"}}
    component.api_info = FileData.model_json_schema
    component.example_payload = lambda: example
    return component


def refusal(text: str) -> gr.Error:
    """Create an error for a program; the error is not logged, because the server did not fail."""
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
