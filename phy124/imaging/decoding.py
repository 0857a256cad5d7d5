"""Decodes a picture's bytes, whatever they are; runs in a process of its own (`image.py`).

Pillow and libheif are native code that reads the data of strangers, so a crash, an endless loop or
a claim of memory costs one picture only. Of the metadata only the orientation and the colour
profile are read; damage in the rest changes nothing.
"""

from __future__ import annotations

import io
import struct
from typing import Any, NamedTuple

from PIL import Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile

from phy124.imaging import heic, png, tiff
from phy124.imaging.header import KINDS, SEGMENT, Size, kind_of, size_of
from phy124.imaging.profile import in_srgb

MAX_PIXELS = 50_000_000
"""Number of pixels of the largest picture that is decoded; read from the header before decoding."""
ANIMATED = ("PNG", "WEBP", "GIF", "AVIF")
"""Formats whose further pictures are frames of an animation, not thumbnails or pages."""
MAX_SCANS = 100
"""Most scans of a JPEG: usual files have 1 to 10; 8 MB can hold 190,000 of 18 ms each."""
SCAN, END = b"\xda", b"\xd9"
SIXTEEN = ("I;16", "I;16B", "I;16L", "I;16N", "I")
"""Modes of 16-bit grey pictures, which Pillow would clip instead of scaling."""
ORIENTATION = 0x0112
TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
"""Orientation in EXIF -> what turns the picture upright."""
TEXT = 64 << 20
"""Most bytes of one text or profile in a PNG, decompressed."""
COPY = "Copy or export it again."
BAD_PROFILE = "The picture's colour profile cannot be used; its colours may be slightly wrong."
"""Note on a profile that cannot be used."""
TOO_LARGE = (
    f"It has more than {MAX_PIXELS / 1e6:.0f} million pixels.",
    "Reduce it, for example to 2000 pixels on its longer side.",
)


class Unusable(Exception):
    """What is wrong with a picture, and what to do about it."""


class Purpose(NamedTuple):
    """What a picture is read for."""

    formats: tuple[str, ...]
    """Names of the Pillow formats to accept; HEIC besides."""
    minimum: int
    """Smallest allowed side, pixels."""
    colours: bool = True
    """Whether its numbers are colours, which its profile explains."""
    deep: bool = False
    """Whether all its grey levels are needed: the result is in mode F or L, not RGBA."""


class Decoded(NamedTuple):
    """A picture, upright and reduced."""

    picture: Image.Image
    size: Size
    """Width and height of the upright picture before it was reduced."""
    frames: int = 1
    """Number of frames if it is an animation; only the first was decoded."""
    notes: tuple[str, ...] = ()
    """Sentences on what was ignored."""


def decoded(data: bytes, purpose: Purpose, longest: int) -> Decoded:
    """The first picture of a file.

    Args:
        data: The file's bytes.
        purpose: What the picture is read for.
        longest: Side to which larger pictures are reduced, pixels.

    Raises:
        Unusable: For whatever reason it cannot be used.
        MemoryError: It takes more memory than this process may.
    """
    _prepare_pillow()
    try:
        with _opened(data, purpose.formats) as opened:
            check_size(opened.size, purpose.minimum)
            opened.load()
            return _upright(opened, purpose, longest)
    except (Unusable, MemoryError):
        raise
    except UnidentifiedImageError:
        raise unidentified(data, purpose.formats) from None
    except Exception as error:  # Pillow and its libraries raise many types.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise Unusable(f"It is broken or cut short ({reason}).", COPY) from None


def check_size(size: Size, minimum: int) -> None:
    """Check a picture's width and height.

    Raises:
        Unusable: It is too large or too small.
    """
    width, height = size
    if width * height > MAX_PIXELS:
        raise Unusable(*TOO_LARGE)
    if min(width, height) < minimum:
        limit = f"It has {width} x {height} pixels; each side needs {minimum} at least."
        raise Unusable(limit, "Use a larger picture.")


def unidentified(data: bytes, formats: tuple[str, ...]) -> Unusable:
    """What is wrong with data in which no picture of these formats was recognised."""
    if kind_of(data) in (*formats, "HEIC"):
        return Unusable("It is broken or cut short.", COPY)
    return Unusable(
        f"It is not a {_listed(formats)} picture.", "Save it as PNG or JPEG and try again."
    )


def _listed(formats: tuple[str, ...]) -> str:
    """The formats as words."""
    names = [name.replace("WEBP", "WebP") for name in (*formats, "HEIC")]
    return f"{', '.join(names[:-1])} or {names[-1]}"


def turned(opened: Image.Image) -> Image.Image:
    """The picture, which must be loaded, turned upright as its EXIF states."""
    turn = TURNS.get(_orientation(opened))
    return opened if turn is None else opened.transpose(turn)


def _prepare_pillow() -> None:
    """Set Pillow's limits for this process; here are stricter ones, and EXIF is never written."""
    from PIL import PngImagePlugin

    Image.MAX_IMAGE_PIXELS = None
    PngImagePlugin.MAX_TEXT_CHUNK = TEXT
    Image.Exif.tobytes = _orientation_alone


def _orientation_alone(self: Image.Exif, offset: int = 8) -> bytes:
    """EXIF that holds the orientation and nothing else.

    Pillow's reader of AVIF writes EXIF out again, which fails for tags of an unusual type.
    """
    entry = struct.pack("<HHHII", 1, ORIENTATION, 3, 1, _orientation_in(self))
    return b"Exif\0\0II*\0" + struct.pack("<I", offset) + entry + bytes(4)


def _opened(data: bytes, formats: tuple[str, ...]) -> Image.Image:
    """The picture, not decoded yet unless it is HEIC."""
    kind = kind_of(data)
    if kind == "HEIC":
        return _opened_heic(data)
    if kind == "JPEG":
        # Not by Image.open, which looks at the further pictures that phones append.
        _check_scans(data)
        return JpegImageFile(io.BytesIO(data))
    if kind == "PNG":
        data = png.plain(data)
    if "TIFF" in formats and data[:4] in tiff.BEGINNINGS:
        return tiff.opened(data)
    others = [name for name in formats if name not in KINDS]
    return Image.open(io.BytesIO(data), formats=[kind] if kind in formats else others)


def _opened_heic(data: bytes) -> Image.Image:
    width, height = size_of(data)
    picture = heic.opened(data)
    if picture.width * picture.height > width * height:
        raise ValueError("it is larger than its header states")
    return picture


def _check_scans(jpeg: bytes) -> None:
    scans, place = 0, 2
    while (segment := SEGMENT.search(jpeg, place)) and segment[1] != END:
        scans += segment[1] == SCAN
        if scans > MAX_SCANS:
            limit = f"It is a JPEG of more than {MAX_SCANS} passes, which takes very long to open."
            raise Unusable(limit, "Save it as PNG or as an ordinary JPEG.")
        place = segment.end() + int.from_bytes(jpeg[segment.end() : segment.end() + 2], "big")


def _upright(opened: Image.Image, purpose: Purpose, longest: int) -> Decoded:
    frames = getattr(opened, "n_frames", 1) if opened.format in ANIMATED else 1
    profile = _profile(opened) if purpose.colours else None
    picture = turned(opened)
    size, notes = picture.size, ()
    picture = _levels(picture) if purpose.deep else _plain(picture)
    picture.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    if not purpose.deep:
        picture, notes = _coloured(picture, profile)
    picture.info = {}
    return Decoded(picture, size, frames, notes)


def _orientation(opened: Image.Image) -> int:
    """Which of the 8 orientations EXIF states; 1, as stored, if EXIF is damaged or has none."""
    try:
        return _orientation_in(opened.getexif())
    except Exception:  # Damage has many types, and the pixels are whole.
        return 1


def _orientation_in(exif: Image.Exif) -> int:
    value: Any = exif.get(ORIENTATION)
    try:
        first = int(value[0] if isinstance(value, tuple | bytes) else value)
    except (TypeError, ValueError, LookupError, ArithmeticError):
        return 1
    return first if first in TURNS else 1


def _plain(picture: Image.Image) -> Image.Image:
    """The picture in one of the modes RGBA, LA, L and CMYK, with 8 bits."""
    if picture.mode in SIXTEEN:
        return _shallow(picture)
    if picture.mode == "F":
        return _bytes_of_floats(picture)
    if picture.mode in ("1", "L"):
        return picture.convert("LA" if "transparency" in picture.info else "L")
    if picture.mode in ("YCbCr", "LAB", "HSV"):
        picture = picture.convert("RGB")
    return picture if picture.mode in ("CMYK", "LA") else picture.convert("RGBA")


def _shallow(picture: Image.Image) -> Image.Image:
    """A 16-bit grey picture in 8 bits; the one grey level a file may make transparent is kept."""
    import numpy as np

    deep, clear = np.asarray(picture), picture.info.get("transparency")
    grey = Image.fromarray(np.clip(np.rint(deep / 257), 0, 255).astype(np.uint8))
    if clear is not None:
        grey.putalpha(Image.fromarray(255 * (deep != clear).astype(np.uint8)))
    return grey


def _bytes_of_floats(picture: Image.Image) -> Image.Image:
    """A picture of floating-point grey levels, 0 to 1, in 8 bits."""
    import numpy as np

    levels = np.asarray(picture)
    if not np.logical_and(levels >= 0, levels <= 1).all():
        limit = "Its values are floating-point numbers that are not all from 0 to 1."
        raise Unusable(limit, "Save it with 8 or 16 bits.")
    return Image.fromarray(np.rint(255 * levels).astype(np.uint8))


def _levels(picture: Image.Image) -> Image.Image:
    """All grey levels of the picture: mode F if there are more than 256, else L."""
    import numpy as np

    if picture.mode in (*SIXTEEN, "F"):
        return Image.fromarray(np.asarray(picture).astype(np.float32))
    return _coloured(_plain(picture), None)[0].convert("L")


def _profile(opened: Image.Image) -> bytes | None:
    """The colour profile; empty if it is cut short, None if the file has none."""
    return (opened.info["icc_profile"] or b"") if "icc_profile" in opened.info else None


def _coloured(picture: Image.Image, profile: bytes | None) -> tuple[Image.Image, tuple[str, ...]]:
    """The picture in sRGB, RGBA, and notes on its profile."""
    notes = ()
    if profile is not None:
        try:
            return in_srgb(picture, profile), notes
        except ValueError:
            notes = (BAD_PROFILE,)
    plain = picture.convert("RGB") if picture.mode == "CMYK" else picture
    return plain.convert("RGBA"), notes
