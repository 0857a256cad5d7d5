"""Pictures of visitors: looked at before they are decoded, cut out, corrected by brush."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from demo.settings import Settings
from phy124.cutout import foreground
from phy124.errors import InputError
from phy124.image import FORMATS, open_image
from phy124.isolated import PATIENT, Deadline


def check_picture(path: Path, settings: Settings) -> None:
    """Size in bytes and pixels, from the header alone; raises InputError."""
    size = path.stat().st_size
    if size > settings.max_bytes:
        limit = f"The picture has {size / 1e6:.0f} MB; this page takes {settings.max_upload_mb:g}."
        raise InputError("picture", path.name, limit, "Save it as JPEG or reduce it.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=FORMATS) as opened:
                pixels = opened.width * opened.height
    except Image.DecompressionBombError:
        pixels = 10**9
    except (OSError, SyntaxError, ValueError):
        open_image(path)  # says what is wrong with it
        raise
    if pixels > settings.max_megapixels * 1e6:
        limit = f"It has more than {settings.max_megapixels:g} million pixels."
        raise InputError("picture", path.name, limit, "Reduce it to 2000 pixels, say.")


def cut_out(
    picture: str, strokes: Image.Image | None, path: Path, deadline: Deadline = PATIENT
) -> tuple[str, ...]:
    """Write the cut-out and return what makes it doubtful.

    Green strokes are object and red ones are not, whatever was found.
    """
    image, doubts = open_image(picture), ()
    try:
        found = foreground(image, deadline=deadline)
        cut, doubts = found.picture, found.warnings
    except InputError:
        if strokes is None:
            raise
        cut = image.convert("RGBA")
        cut.putalpha(0)
    if strokes is not None:
        cut.putalpha(brushed(cut.getchannel("A"), strokes))
        doubts = ()
    if not np.any(np.asarray(cut.getchannel("A")) > 127):
        raise InputError("picture", "empty", "Nothing is left of it.", "Paint green what to keep.")
    cut.save(path, compress_level=1)
    return doubts


def brushed(alpha: Image.Image, strokes: Image.Image) -> Image.Image:
    """Alpha with strokes applied: green keeps, red removes."""
    marks = np.asarray(strokes.convert("RGBA").resize(alpha.size)).astype(np.int16)
    painted = marks[..., 3] > 64
    keep = painted & (marks[..., 1] > marks[..., 0])
    values = np.array(alpha)
    values[painted & ~keep] = 0
    values[keep] = 255
    return Image.fromarray(values)


def dimmed(picture: str, cutout: str) -> Image.Image:
    """The picture for the brush: what was cut away is pale, so that one sees what to correct."""
    image = open_image(picture)
    white = Image.new("RGBA", image.size, "white")
    flat = np.asarray(Image.alpha_composite(white, image).convert("RGB")).astype(np.float32)
    with Image.open(cutout) as cut:
        kept = np.asarray(cut.getchannel("A")).astype(np.float32)[..., None] / 255
    return Image.fromarray((flat * kept + (0.3 * flat + 165) * (1 - kept)).astype(np.uint8))
