"""What kind of file was given, and which command takes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phy124.errors import InputError

PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff")
KINDS = {
    **dict.fromkeys(PICTURES, "a picture"),
    ".ply": "a file of Gaussians",
    ".safetensors": "a clip",
    ".toml": "a scene",
}
"""What a file of each ending holds."""
TAKES = {
    "generate": ("image", "a picture"),
    "simulate": ("file", "a file of Gaussians"),
    "render": ("clip", "a clip"),
    "evaluate": ("clip", "a clip"),
}
"""Which field of a command is which kind of file."""
USES = {
    "a picture": "Use `phy124 generate {}`.",
    "a file of Gaussians": "Use `phy124 simulate {}`.",
    "a clip": "Use `phy124 render {}`.",
    "a scene": "Give it after --scene.",
}
"""What to do with each kind."""


def refuse_other_kind(name: str, command: Any) -> None:
    """Raise InputError if a command was given a file that another one takes."""
    if name not in TAKES:
        return
    field, wanted = TAKES[name]
    path = Path(getattr(command, field))
    found = KINDS.get(path.suffix.lower(), wanted)
    if found != wanted:
        limit = f"it is {found}, and `phy124 {name}` takes {wanted}."
        raise InputError(field, path, limit, USES[found].format(path))
