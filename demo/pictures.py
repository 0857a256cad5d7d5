"""Visitors' pictures: checks before decoding, cut-outs, and corrections by brush strokes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from PIL import Image, ImageDraw
from PIL.PngImagePlugin import PngInfo
from pydantic import Field, TypeAdapter, ValidationError

from phy124.errors import InputError
from phy124.imaging.cutout import Cutout, clean_edge, examine, foreground, title_of
from phy124.imaging.grabcut import apply_marks
from phy124.imaging.header import HEAD, read_kind
from phy124.imaging.image import open_image, read_picture_size
from phy124.imaging.objects import Point
from phy124.imaging.transparency import has_alpha, make_solid
from phy124.io.files import replacing
from phy124.runtime import isolated
from phy124.runtime.isolated import PATIENT, Deadline, Unfinished
from phy124.schema.section import Section

from .settings import Settings
from .visitors import Visitor, key

MISSING = "Part of the object may be missing."
"""First sentence of a warning about a cut-out; the reasons follow."""
REMEDIES = {
    "foreground": "Mark the object with the brush, or use a picture with a plain background.",
    "pick": "Click the middle of the object, or mark it with the brush.",
}
"""Advice for the visitor, by the field of an error."""
HOW = "cutout"
"""Key of the PNG text that stores the method and quality of a cut-out."""
PIXEL = 4
"""Size of a pixel in a cut-out, which is hardly compressed [bytes]."""
Fraction = Annotated[float, Field(ge=-0.5, le=1.5, allow_inf_nan=False)]


def check_picture(path: Path, settings: Settings, field: str = "image") -> None:
    """Check a picture's file size and number of pixels from its header, without decoding it.

    Args:
        path: Path of the picture.
        settings: The page's limits.
        field: Name of the picture in error messages.

    Raises:
        InputError: The picture is too large, or the file is not a picture.
    """
    size = path.stat().st_size
    if size > settings.max_bytes:
        raise InputError(field, path.name, settings.too_large, settings.make_smaller)
    width, height = read_picture_size(path, field=field)
    if width * height > settings.max_megapixels * 1e6:
        limit = f"The picture has more than {settings.max_megapixels:g} million pixels."
        raise InputError(field, path.name, limit, "Reduce the picture, for example to 2000 pixels.")


def bytes_of_cutout(picture: Path) -> int:
    """Estimate the size of the largest cut-out of a picture [bytes]."""
    width, height = read_picture_size(picture)
    return PIXEL * width * height


def is_shown(picture: Path) -> bool:
    """Return whether browsers can show the format of a picture."""
    with open(picture, "rb") as file:
        return read_kind(file.read(HEAD)) != "HEIC"


def viewable(picture: Path, deadline: Deadline = PATIENT) -> Path:
    """Return the picture, or a copy in a format that browsers can show."""
    if is_shown(picture):
        return picture
    shown = picture.with_name(f"{picture.stem}-shown.webp")
    if not shown.exists():
        opened = open_image(picture, deadline=deadline)
        with replacing(shown) as temporary:
            opened.save(temporary, "WEBP", quality=95)
    return shown


def cut_out(
    picture: Path, path: Path, pick: Point | None = None, deadline: Deadline = PATIENT
) -> tuple[str, ...]:
    """Write the cut-out of a picture; return its notes, or a warning and the reasons.

    Args:
        picture: The picture.
        path: The PNG to write.
        pick: A point on the object, if the picture shows several objects.
        deadline: Time limit.

    Raises:
        InputError: No object is found in the picture.
    """
    try:
        cut = foreground(open_image(picture, deadline=deadline), pick=pick, deadline=deadline)
    except InputError as error:
        remedy = REMEDIES.get(error.field, error.remedy)
        raise InputError(error.field, error.value, error.limit, remedy) from error
    _save(cut, path)
    return (MISSING, *cut.warnings, *cut.notes) if cut.warnings else cut.notes


def cutout_file(visitor: Visitor, picture: Path, *more: Any) -> Path:
    """Return the path of a visitor's cut-out. The file name depends on the picture and on `more`,
    the other inputs of the cut-out.
    """
    return visitor.folder / "cutouts" / f"{key(picture.read_bytes(), *more)}.png"


def cut_once(
    visitor: Visitor,
    upload: Path,
    strokes: Sequence[Stroke],
    pick: Point | None,
    deadline: Deadline,
) -> tuple[Path, tuple[str, ...], bool]:
    """Cut out an upload, or correct the cut-out by strokes, unless the result exists.

    Return the path of the cut-out, the reasons for a warning, and whether the object was segmented.

    Args:
        visitor: The visitor who uploaded the picture.
        upload: The uploaded picture.
        strokes: The brush strokes.
        pick: A point on the object, if the picture shows several objects.
        deadline: Time limit.
    """
    place = pick or ()
    first = cutout_file(visitor, upload, *place)
    if not strokes and first.exists():
        return first, (), False
    if not strokes:
        doubts = cut_out(upload, first, pick, deadline)
        return first, doubts, cut_by(first) != title_of("alpha")
    path = cutout_file(visitor, upload, *place, [stroke.model_dump() for stroke in strokes])
    if not path.exists():
        basis = _find_basis(upload, first, pick, deadline)
        correct_cutout(upload, basis, strokes, path, deadline)
    return path, (), False


def _find_basis(upload: Path, first: Path, pick: Point | None, deadline: Deadline) -> Path | None:
    """Return the cut-out that strokes correct; None if the picture shows no object.

    A cut-out that has been removed is created again. Its time of change is set to the present, so
    that older files are removed first.
    """
    if not first.exists():
        try:
            cut_out(upload, first, pick, deadline)
        except InputError as error:
            if error.field not in REMEDIES:
                raise
            return None
    first.touch()
    return first


def correct_cutout(
    picture: Path,
    first: Path | None,
    strokes: Sequence[Stroke],
    path: Path,
    deadline: Deadline = PATIENT,
) -> None:
    """Write a cut-out that is corrected by brush strokes.

    Pixels under a stroke are added to the object or removed from it. Near the strokes, the outline
    follows the edges in the picture.

    Args:
        picture: The picture.
        first: The cut-out to correct, or None.
        strokes: The brush strokes.
        path: The PNG to write.
        deadline: Time limit.
    """
    image = make_solid(open_image(picture, deadline=deadline))
    marks = np.asarray(paint(tuple(strokes), image.size))
    alpha = np.zeros(marks.shape, np.uint8)
    if first is not None:
        with Image.open(first) as cut:
            alpha = np.array(cut.getchannel("A"))
    if not has_alpha(image):
        # If computing the outline takes too long, only the painted pixels change.
        with suppress(Unfinished):
            rgb = np.asarray(image.convert("RGB"))
            alpha = np.array(isolated.run(apply_marks, rgb, alpha, marks, deadline=deadline))
    alpha[marks == 1] = 0
    alpha[marks == 2] = 255
    _save(examine(clean_edge(image, alpha), "brush"), path)


def how_cut(picture: Image.Image) -> dict[str, Any] | None:
    """Return the method and quality of a cut-out; None if this module did not write the cut-out."""
    text = picture.info.get(HOW)
    return text and json.loads(text)


def cut_by(path: Path) -> str:
    """Return the title of the method that made a cut-out; empty if the method is unknown."""
    with Image.open(path) as picture:
        how = how_cut(picture)
    return title_of(how["method"]) if how else ""


def _save(cut: Cutout, path: Path) -> None:
    if not cut.coverage:
        raise InputError(
            "strokes",
            "empty",
            "Nothing of the object is left.",
            "With the green brush, paint the parts to keep.",
        )
    how = PngInfo()
    how.add_text(HOW, json.dumps(cut.data()))
    with replacing(path) as temporary:
        cut.picture.save(temporary, "PNG", compress_level=1, pnginfo=how)


class Stroke(Section):
    """A line painted on the picture; lengths are fractions of the picture's longer side."""

    keep: bool
    """True if the painted area belongs to the object, False if it belongs to the background."""
    width: float = Field(gt=0, le=0.5)
    points: tuple[tuple[Fraction, Fraction], ...] = Field(min_length=1, max_length=2000)


Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
PLACE = TypeAdapter(tuple[Share, Share])
STROKES = TypeAdapter(Annotated[list[Stroke], Field(max_length=200)])
UNREAD = "These strokes cannot be read."
POINTS = 20_000
"""Largest number of points in all strokes together."""


def read_strokes(data: Any) -> list[Stroke]:
    """Validate strokes from plain data.

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


def read_place(data: Any) -> Point | None:
    """Read a point of the picture, as fractions of width and height; None if `data` is empty.

    Raises:
        InputError: The data is neither a point nor empty.
    """
    if data is None or data == []:
        return None
    try:
        return PLACE.validate_python(data)
    except ValidationError:
        raise InputError(
            "pick",
            "unknown",
            "It is not a point in the picture.",
            "Give two fractions, as in [0.3, 0.5].",
        ) from None


def paint(strokes: list[Stroke] | tuple[Stroke, ...], size: tuple[int, int]) -> Image.Image:
    """Paint the strokes in order into a map (0: nothing, 1: remove, 2: keep)."""
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
