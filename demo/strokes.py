"""Brush strokes and clicks as the page sends them: numbers instead of pictures."""

from __future__ import annotations

from typing import Annotated, Any

from PIL import Image, ImageDraw
from pydantic import Field, TypeAdapter, ValidationError

from phy124.errors import InputError
from phy124.imaging.objects import Point
from phy124.schema.section import Section

Fraction = Annotated[float, Field(ge=-0.5, le=1.5, allow_inf_nan=False)]


class Stroke(Section):
    """A line painted on the picture; lengths are fractions of its longer side."""

    keep: bool
    """Whether the area under it belongs to the object."""
    width: float = Field(gt=0, le=0.5)
    points: tuple[tuple[Fraction, Fraction], ...] = Field(min_length=1, max_length=2000)


Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
PLACE = TypeAdapter(tuple[Share, Share])
STROKES = TypeAdapter(Annotated[list[Stroke], Field(max_length=200)])
UNREAD = "These strokes cannot be read."
POINTS = 20_000
"""Points of all strokes together."""


def strokes_of(data: Any) -> list[Stroke]:
    """Strokes from plain data.

    Raises:
        InputError: The data cannot be read.
    """
    unread = InputError("strokes", "unknown", UNREAD, "Undo some of them.")
    try:
        strokes = STROKES.validate_python(data)
    except ValidationError:
        raise unread from None
    if sum(len(stroke.points) for stroke in strokes) > POINTS:
        raise unread
    return strokes


def place_of(data: Any) -> Point | None:
    """A place in the picture, as fractions of width and height, from plain data; [] is none.

    Raises:
        InputError: If it is something else.
    """
    if data is None or data == []:
        return None
    try:
        return PLACE.validate_python(data)
    except ValidationError:
        raise InputError(
            "pick",
            "unknown",
            "It is not a place in the picture.",
            "Give two fractions, as in [0.3, 0.5].",
        ) from None


def painted(strokes: list[Stroke] | tuple[Stroke, ...], size: tuple[int, int]) -> Image.Image:
    """A picture of the strokes: 0 nothing, 1 remove, 2 keep; later strokes cover earlier ones."""
    marks = Image.new("L", size)
    draw, side = ImageDraw.Draw(marks), max(size)
    for stroke in strokes:
        width = max(1, round(stroke.width * side))
        points = [(x * side, y * side) for x, y in stroke.points]
        value, reach = 1 + stroke.keep, width / 2
        draw.line(points, value, width)
        for x, y in points:
            draw.ellipse((x - reach, y - reach, x + reach, y + reach), value)
    return marks
