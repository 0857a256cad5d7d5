"""Which kind of file was given, and which command takes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.io.formats import ENDINGS

PICTURES = (
    ".png",
    ".jpg",
    ".jpeg",
    ".webp",
    ".gif",
    ".bmp",
    ".tif",
    ".tiff",
    ".avif",
    ".heic",
    ".heif",
)
KINDS = {
    **dict.fromkeys(PICTURES, "a picture"),
    **dict.fromkeys(ENDINGS, "a file of Gaussians"),
    ".safetensors": "a clip",
    ".toml": "a scene",
}
"""Ending of a file's name -> its content."""
TAKES = {
    "generate": ("image", "a picture"),
    "simulate": ("file", "a file of Gaussians"),
    "orient": ("file", "a file of Gaussians"),
    "convert": ("file", "a file of Gaussians"),
    "render": ("clip", "a clip"),
    "export": ("clip", "a clip"),
    "evaluate": ("clip", "a clip"),
}
"""Command -> its field that is a file, and the kind of file it takes."""
USES = {
    "a picture": "Use `phy124 generate {}`.",
    "a file of Gaussians": "Use `phy124 simulate {}`.",
    "a clip": "Use `phy124 render {}` or `phy124 export {}`.",
    "a scene": "Give it after --scene.",
}
"""Kind of file -> the remedy that names the command for it."""


def refuse_other_kind(name: str, command: Any) -> None:
    """Refuse a file that is meant for another command.

    Raises:
        InputError: The file is of a kind that another command takes.
    """
    if name not in TAKES:
        return
    field, wanted = TAKES[name]
    path = Path(getattr(command, field))
    found = KINDS.get(path.suffix.lower(), wanted)
    if found != wanted:
        limit = f"it is {found}, and `phy124 {name}` takes {wanted}."
        raise InputError(field, path, limit, USES[found].replace("{}", str(path)))
