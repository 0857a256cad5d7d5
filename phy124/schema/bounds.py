"""Bounds of a scene's numbers: what float32 and a grid of cells can represent.

They are wider than any scene needs and narrow enough that no product of two of them overflows.
"""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

LONGEST = 1e5
"""A clip lasts at most 1e4 s; anything that begins later never does."""
SHORTEST = 1e-6
"""Shorter than any substep of a visible object [s]."""

FARTHEST = 1e5
"""No scene is wider [m]."""

_Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
_Rate = Annotated[float, Field(ge=-1e5, le=1e5)]
_Push = Annotated[float, Field(ge=-1e9, le=1e9)]
_Direction = Annotated[float, Field(ge=-1e6, le=1e6)]

Spot = tuple[_Coordinate, _Coordinate]
"""A place on the floor [m]."""
Position = tuple[_Coordinate, _Coordinate, _Coordinate]
"""A place or a displacement [m]."""
Velocity = tuple[_Rate, _Rate, _Rate]
"""A velocity [m/s], or an angular one [rad/s]."""
Push = tuple[_Push, _Push, _Push]
"""An acceleration [m/s^2], a force [N] or a momentum [N s]."""
Direction = tuple[_Direction, _Direction, _Direction]
"""A vector whose length is ignored."""
Factor = Annotated[float, Field(ge=-1e6, le=1e6)]
"""The factor of a time profile."""
Instant = Annotated[float, Field(ge=0, le=LONGEST)]
"""A time since the start [s]."""
Colour = Annotated[float, Field(ge=0, le=1)]
"""A channel of a colour."""


def _writable(text: str) -> str:
    """Text that a file can hold."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError("it has characters that no file can hold; write it in UTF-8") from None
    return text


Text = Annotated[str, AfterValidator(_writable)]
"""Text that is written into scene files as it is."""
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
"""What an object is called, in files and topics too: a letter, then letters, digits, - and _."""
NAME_LENGTH = 4096
"""Length of a file name, characters."""


def _nameable(path: Path) -> Path:
    if len(str(path)) > NAME_LENGTH:
        raise ValueError(f"the name of a file has {NAME_LENGTH} letters at most")
    _writable(str(path))
    return path


FileName = Annotated[
    Path, AfterValidator(_nameable), Field(json_schema_extra={"maxLength": NAME_LENGTH})
]
"""A file to be read; the page uses this type to refuse file names that come from outside."""
