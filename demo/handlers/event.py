"""Read the data of Gradio's events, and create links to files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gradio as gr
from gradio import FileData

from ..guard import visitor_of
from ..jobs import Studio
from ..line import Job

Handler = Callable[..., Any]


def data_of(event: gr.EventData) -> dict[str, Any]:
    """Return the data that a panel sent with an event; empty if the data is malformed."""
    return event._data if isinstance(event._data, dict) else {}


def job_of(studio: Studio, request: gr.Request, event: gr.EventData) -> Job | None:
    """Return the job that an event names, if it is a job of this visitor."""
    visitor = studio.visitors.find(visitor_of(request))
    return visitor.jobs.get(str(data_of(event).get("job"))) if visitor else None


def table_of(value: Any) -> dict[str, Any]:
    """Return a panel's value in a request; empty if the value is malformed."""
    return value if isinstance(value, dict) else {}


def path_of(file: Any) -> Any:
    """Return the path in the data with which Gradio describes a file; None if there is no file."""
    return file.get("path") if isinstance(file, dict) else None


def file_of(path: Path) -> dict[str, Any]:
    """Return a link to a file; the link contains a name that cannot be guessed."""
    return FileData(path=str(path), orig_name=path.name, size=path.stat().st_size).model_dump()
