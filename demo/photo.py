"""The picture input: hands over the uploaded file undecoded, so that our own limits come first.

Gradio would decode a picture before any limit of ours; and a data: URL in an API call bypasses
its `max_file_size`.
"""

from __future__ import annotations

import base64
import binascii
import os
import tempfile
from typing import Any

import gradio as gr


def photo(max_bytes: int, **options: Any) -> gr.Image:
    """A `gr.Image` whose value is the path of the file as it was uploaded."""
    image = gr.Image(type="filepath", **options)

    def preprocess(payload: Any) -> str | None:
        """The file's path; raises gr.Error if a data: URL is broken or too large."""
        if payload is None:
            return None
        if payload.url and payload.url.startswith("data:"):
            return _saved(payload.url, max_bytes, image.GRADIO_CACHE)
        return payload.path

    image.preprocess = preprocess
    return image


def _saved(url: str, max_bytes: int, folder: str) -> str:
    head, comma, text = url.partition(",")
    if not comma or not head.endswith(";base64"):
        raise gr.Error("The picture's data: URL is broken. Send the file itself.")
    if len(text) * 3 / 4 > max_bytes:
        limit = f"{max_bytes / 1e6:g} MB"
        raise gr.Error(f"The picture is larger than {limit}. Save it as JPEG or reduce it.")
    try:
        data = base64.b64decode(text, validate=True)
    except binascii.Error:
        raise gr.Error("The picture's data: URL is broken. Send the file itself.") from None
    descriptor, path = tempfile.mkstemp(suffix=".png", dir=folder)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
    return path
