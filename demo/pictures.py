"""Pictures of visitors: checked before they are decoded, cut out, corrected by brush."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

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

from .settings import Settings
from .strokes import Stroke, painted
from .visitors import Visitor, key

HOW = "cutout"
"""Key of the text in a PNG that says how it was cut out."""


def check_picture(path: Path, settings: Settings, field: str = "image") -> None:
    """Check a picture's size in bytes and pixels, from its header alone; nothing is decoded.

    Args:
        path: The picture.
        settings: The page's limits.
        field: What the picture is for, used in error messages.

    Raises:
        InputError: It is too large, or it is not a picture.
    """
    size = path.stat().st_size
    if size > settings.max_bytes:
        raise InputError(field, path.name, settings.too_large, settings.make_smaller)
    width, height = read_picture_size(path, field=field)
    if width * height > settings.max_megapixels * 1e6:
        limit = f"It has more than {settings.max_megapixels:g} million pixels."
        raise InputError(field, path.name, limit, "Reduce it to 2000 pixels, for example.")


def is_shown(picture: Path) -> bool:
    """Whether browsers can show a picture."""
    with open(picture, "rb") as file:
        return read_kind(file.read(HEAD)) != "HEIC"


def viewable(picture: Path, deadline: Deadline = PATIENT) -> Path:
    """The picture, or a copy beside it in a format that browsers can show."""
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
    """Write the cut-out of a picture; returns reasons to doubt it.

    Args:
        picture: The picture.
        path: The PNG to write.
        pick: A place on the object that is meant, if there are several.
        deadline: When to give up.

    Raises:
        InputError: No object can be found in it.
    """
    found = foreground(open_image(picture, deadline=deadline), pick=pick, deadline=deadline)
    _save(found, path)
    return (*found.notes, *found.warnings)


def cutout_file(visitor: Visitor, picture: Path, *more: Any) -> Path:
    """Where a visitor's cut-out of a picture lies; `more` says what else it depends on."""
    return visitor.folder / "cutouts" / f"{key(picture.read_bytes(), *more)}.png"


def cut_once(
    visitor: Visitor, upload: Path, strokes: Sequence[Stroke], pick: Point | None,
    deadline: Deadline,
) -> tuple[Path, tuple[str, ...], bool]:  # fmt: skip
    """The cut-out of an upload, doubts about it, and whether the object had to be searched for.

    It is made once, and corrected by strokes.

    Args:
        visitor: Whose it is.
        upload: The picture.
        strokes: The brush strokes.
        pick: A place on the object that is meant, if there are several.
        deadline: When to give up.
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
        corrected(upload, first if first.exists() else None, strokes, path, deadline)
    return path, (), False


def corrected(
    picture: Path, first: Path | None, strokes: Sequence[Stroke], path: Path,
    deadline: Deadline = PATIENT,
) -> None:  # fmt: skip
    """Write the cut-out as corrected by brush strokes.

    Strokes say for certain what is object and what is not; near them the outline follows the edges
    of the picture.

    Args:
        picture: The picture.
        first: The cut-out to start from, if there is one.
        strokes: The brush strokes.
        path: The PNG to write.
        deadline: When to give up.
    """
    image = make_solid(open_image(picture, deadline=deadline))
    marks = np.asarray(painted(tuple(strokes), image.size))
    alpha = np.zeros(marks.shape, np.uint8)
    if first is not None:
        with Image.open(first) as cut:
            alpha = np.array(cut.getchannel("A"))
    if not has_alpha(image):
        # If the outline is not found in time, the strokes themselves still count.
        with suppress(Unfinished):
            rgb = np.asarray(image.convert("RGB"))
            alpha = np.array(isolated.run(apply_marks, rgb, alpha, marks, deadline=deadline))
    alpha[marks == 1] = 0
    alpha[marks == 2] = 255
    _save(examine(clean_edge(image, alpha), "brush"), path)


def how_cut(picture: Image.Image) -> dict[str, Any] | None:
    """How a picture was cut out, if `cut_out` or `corrected` wrote it."""
    said = picture.info.get(HOW)
    return said and json.loads(said)


def cut_by(path: Path) -> str:
    """What a cut-out was cut out by, for a sentence; empty if it is not known."""
    with Image.open(path) as picture:
        how = how_cut(picture)
    return title_of(how["method"]) if how else ""


def _save(cut: Cutout, path: Path) -> None:
    if not cut.coverage:
        raise InputError("strokes", "empty", "Nothing is left of it.", "Paint green what to keep.")
    how = PngInfo()
    how.add_text(HOW, json.dumps(cut.data()))
    with replacing(path) as temporary:
        cut.picture.save(temporary, "PNG", compress_level=1, pnginfo=how)
