"""What an event carries: its data, the job it names, and a file as Gradio's components take it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gradio as gr
from gradio import FileData

from ..identity import visitor_of
from ..jobs import Studio
from ..line import Job

Handler = Callable[..., Any]


def data_of(event: gr.EventData) -> dict[str, Any]:
    """What our own panel sent with an event; empty if it is of another form."""
    return event._data if isinstance(event._data, dict) else {}


def job_of(studio: Studio, request: gr.Request, event: gr.EventData) -> Job | None:
    """The visitor's own job that an event names."""
    visitor = studio.visitors.known(visitor_of(request))
    return visitor.jobs.get(str(data_of(event).get("job"))) if visitor else None


def table_of(value: Any) -> dict[str, Any]:
    """What a panel shows, as a request says; empty if it is of another form."""
    return value if isinstance(value, dict) else {}


def path_of(file: Any) -> Any:
    """Where a file lies; None if it is none."""
    return file.get("path") if isinstance(file, dict) else None


def file_of(path: Path) -> dict[str, Any]:
    """A link to a file for the page; the name of its folder cannot be guessed."""
    return FileData(path=str(path), orig_name=path.name, size=path.stat().st_size).model_dump()
