"""The picture input: hands over the uploaded file undecoded, so that our own limits come first."""

from __future__ import annotations

import base64
import binascii
import os
import tempfile
from typing import Any

import gradio as gr

MAX_BYTES = 8_000_000

from gradio.events import Dependency

class Photo(gr.Image):
    """A `gr.Image` whose value is the path of the file as it was uploaded.

    Gradio would decode a picture before any limit of ours; and a data: URL in an API call
    bypasses `max_file_size`.
    """

    is_template = True
    max_bytes = MAX_BYTES

    def preprocess(self, payload: Any) -> str | None:
        """The file's path; raises gr.Error if a data: URL is broken or too large."""
        if payload is None:
            return None
        if payload.url and payload.url.startswith("data:"):
            return self._saved(payload.url)
        return payload.path

    def _saved(self, url: str) -> str:
        head, comma, text = url.partition(",")
        if not comma or not head.endswith(";base64"):
            raise gr.Error("The picture's data: URL is broken. Send the file itself.")
        if len(text) * 3 / 4 > self.max_bytes:
            limit = f"{self.max_bytes / 1e6:g} MB"
            raise gr.Error(f"The picture is larger than {limit}. Save it as JPEG or reduce it.")
        try:
            data = base64.b64decode(text, validate=True)
        except binascii.Error:
            raise gr.Error("The picture's data: URL is broken. Send the file itself.") from None
        descriptor, path = tempfile.mkstemp(suffix=".png", dir=self.GRADIO_CACHE)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        return path
    from typing import Callable, Literal, Sequence, Any, TYPE_CHECKING
    from gradio.blocks import Block
    if TYPE_CHECKING:
        from gradio.components import Timer
        from gradio.components.base import Component