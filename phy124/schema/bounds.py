"""Limits of the numbers in a scene, chosen for the ranges of float32 and of the grid."""

import difflib
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

LONGEST = 1e5
"""Maximum time in a scene [s]; the duration of a clip is limited to 1e4 s."""
SHORTEST = 1e-6
"""Smallest duration [s]; it is shorter than any substep of a visible object."""
FARTHEST = 1e5

_Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
_Rate = Annotated[float, Field(ge=-1e5, le=1e5)]
_Push = Annotated[float, Field(ge=-1e9, le=1e9)]
_Direction = Annotated[float, Field(ge=-1e6, le=1e6)]

Spot = tuple[_Coordinate, _Coordinate]
"""A position on the floor [m]."""
Position = tuple[_Coordinate, _Coordinate, _Coordinate]
"""A position or displacement [m]."""
Velocity = tuple[_Rate, _Rate, _Rate]
"""A velocity [m/s] or angular velocity [rad/s]."""
Push = tuple[_Push, _Push, _Push]
"""An acceleration [m/s^2], a force [N] or a momentum [N s]."""
Direction = tuple[_Direction, _Direction, _Direction]
Factor = Annotated[float, Field(ge=-1e6, le=1e6)]
"""A value of a time profile; the strength of a force or motion is multiplied by this value."""
Instant = Annotated[float, Field(ge=0, le=LONGEST)]
"""A time since the start [s]."""
Colour = Annotated[float, Field(ge=0, le=1)]
"""A channel of a colour."""


def _named_colour(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    from PIL import ImageColor

    try:
        return tuple(channel / 255 for channel in ImageColor.getrgb(value)[:3])
    except ValueError:
        # "water" is not a misspelt "white", nor "sand" a misspelt "salmon".
        close = difflib.get_close_matches(value, ImageColor.colormap, 1, cutoff=0.7)
        hint = (
            f"did you mean {close[0]}?" if close else 'write "grey", "#808080" or [0.5, 0.5, 0.5]'
        )
        raise ValueError(f"this is not a CSS colour name; {hint}") from None


RGB = Annotated[tuple[Colour, Colour, Colour], BeforeValidator(_named_colour)]
"""A colour as red, green and blue, 0 to 1."""


def _check_text(text: str) -> str:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError("it has characters that UTF-8 cannot encode; remove them") from None
    return text


Text = Annotated[str, AfterValidator(_check_text)]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
"""Name of an object, also used in files and topics: a letter, then letters, digits, - and _."""
NAME_LENGTH = 4096


def _check_file_name(path: Path) -> Path:
    if len(str(path)) > NAME_LENGTH:
        raise ValueError(f"a file name has at most {NAME_LENGTH} characters; shorten it")
    _check_text(str(path))
    return path


FileName = Annotated[
    Path, AfterValidator(_check_file_name), Field(json_schema_extra={"maxLength": NAME_LENGTH})
]
"""Path of a file to read; the web page does not accept file paths from browsers."""
