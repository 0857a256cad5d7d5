"""Decodes images from bytes; `image.py` runs this module in a separate process.

Pillow and libheif are native code that reads untrusted data. A separate process protects the
program if decoding crashes, never ends or allocates too much memory.
"""

import io
import struct
from typing import Any, NamedTuple

from PIL import Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile

from phy124.imaging import codecs
from phy124.imaging.header import KINDS, SEGMENT, Size, read_kind, read_size
from phy124.imaging.profile import convert_to_srgb

MAX_PIXELS = 50_000_000
"""Images with more pixels are not decoded."""
ANIMATED = ("PNG", "WEBP", "GIF", "AVIF")
"""Formats in which images after the first are frames of an animation, not thumbnails or pages."""
MAX_SCANS = 100
"""Files with more scans are refused. A usual JPEG file has 1 to 10 scans. A file of 8 MB can have
190,000 scans of 18 ms each.
"""
SCAN, END = b"\xda", b"\xd9"
SIXTEEN = ("I;16", "I;16B", "I;16L", "I;16N", "I")
"""Modes of 16-bit grey images. Pillow would clip their values instead of scaling them."""
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
TEXT = 64 << 20
"""Largest size of a decompressed text or profile in a PNG file [bytes]."""
COPY = "Copy or export the file again."
BAD_PROFILE = "The picture's colour profile cannot be used; its colours may be slightly wrong."
TOO_LARGE = (
    f"It has more than {MAX_PIXELS / 1e6:.0f} million pixels.",
    "Reduce it, for example to 2000 pixels on its longer side.",
)


class Unusable(Exception):
    """Raised if an image is unusable; the arguments are limit and remedy, as in `InputError`."""


class Purpose(NamedTuple):
    """Requirements on an image for a particular use."""

    formats: tuple[str, ...]
    """Accepted formats, by Pillow's names; HEIC is always accepted."""
    minimum: int
    colours: bool = True
    """Whether the image's values are colours, so that its colour profile is applied."""
    deep: bool = False
    """Whether all grey levels are kept; the result then has mode F or L instead of RGBA."""


class Decoded(NamedTuple):
    """A decoded image that is upright and reduced in size."""

    picture: Image.Image
    size: Size
    """Width and height before the image was reduced [pixels]."""
    frames: int = 1
    """Number of frames of an animation; only the first frame was decoded."""
    notes: tuple[str, ...] = ()


def decode(data: bytes, purpose: Purpose, longest: int) -> Decoded:
    """Decode the first image of a file.

    Raises:
        Unusable: If the image cannot be decoded, or is too large or too small.
        MemoryError: If decoding exceeds the memory limit of this process.
    """
    _prepare_pillow()
    try:
        with _open(data, purpose.formats) as opened:
            check_size(opened.size, purpose.minimum)
            opened.load()
            return _finish(opened, purpose, longest)
    except (Unusable, MemoryError):
        raise
    except UnidentifiedImageError:
        raise explain_unidentified(data, purpose.formats) from None
    except Exception as error:  # Pillow and its libraries raise exceptions of many types.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise Unusable(f"The file is broken or cut short ({reason}).", COPY) from None


def check_size(size: Size, minimum: int) -> None:
    """Refuse an image that is too large or too small.

    Raises:
        Unusable: If the width or height is not allowed.
    """
    width, height = size
    if width * height > MAX_PIXELS:
        raise Unusable(*TOO_LARGE)
    if min(width, height) < minimum:
        limit = f"It has {width} x {height} pixels, but each side must have at least {minimum}."
        raise Unusable(limit, "Use a larger picture.")


def explain_unidentified(data: bytes, formats: tuple[str, ...]) -> Unusable:
    """Return an error that says why the data is not an accepted image."""
    if read_kind(data) in (*formats, "HEIC"):
        return Unusable("The file is broken or cut short.", COPY)
    return Unusable(
        f"It is not a {_join_names(formats)} picture.", "Save the picture as PNG or JPEG."
    )


def _join_names(formats: tuple[str, ...]) -> str:
    names = [name.replace("WEBP", "WebP") for name in (*formats, "HEIC")]
    return f"{', '.join(names[:-1])} or {names[-1]}"


def turn_upright(opened: Image.Image) -> Image.Image:
    """Turn an image according to its EXIF orientation."""
    turn = TURNS.get(_read_orientation(opened))
    return opened if turn is None else opened.transpose(turn)


def _prepare_pillow() -> None:
    from PIL import PngImagePlugin

    Image.MAX_IMAGE_PIXELS = None
    PngImagePlugin.MAX_TEXT_CHUNK = TEXT
    Image.Exif.tobytes = _orientation_alone


def _orientation_alone(self: Image.Exif, offset: int = 8) -> bytes:
    """Keep only the orientation, because Pillow's AVIF reader fails if another tag is unusual."""
    entry = struct.pack("<HHHII", 1, ORIENTATION, 3, 1, _orientation_of(self))
    return b"Exif\0\0II*\0" + struct.pack("<I", offset) + entry + bytes(4)


def _open(data: bytes, formats: tuple[str, ...]) -> Image.Image:
    kind = read_kind(data)
    if kind == "HEIC":
        return _open_heic(data)
    if kind == "JPEG":
        # Image.open would also read the additional images that phones append to a JPEG file.
        _check_scans(data)
        return JpegImageFile(io.BytesIO(data))
    if kind == "PNG":
        data = codecs.strip_png(data)
    if "TIFF" in formats and data[:4] in codecs.TIFF_BEGINNINGS:
        return codecs.open_tiff(data)
    others = [name for name in formats if name not in KINDS]
    return Image.open(io.BytesIO(data), formats=[kind] if kind in formats else others)


def _open_heic(data: bytes) -> Image.Image:
    width, height = read_size(data)
    picture = codecs.open_heic(data)
    if picture.width * picture.height > width * height:
        raise ValueError("it is larger than its header states")
    return picture


def _check_scans(jpeg: bytes) -> None:
    scans, place = 0, 2
    while (segment := SEGMENT.search(jpeg, place)) and segment[1] != END:
        scans += segment[1] == SCAN
        if scans > MAX_SCANS:
            limit = f"It is a JPEG of more than {MAX_SCANS} passes, which takes very long to open."
            raise Unusable(limit, "Save the picture as PNG or as an ordinary JPEG.")
        place = segment.end() + int.from_bytes(jpeg[segment.end() : segment.end() + 2], "big")


def _finish(opened: Image.Image, purpose: Purpose, longest: int) -> Decoded:
    frames = getattr(opened, "n_frames", 1) if opened.format in ANIMATED else 1
    profile = _read_profile(opened) if purpose.colours else None
    picture = turn_upright(opened)
    size, notes = picture.size, ()
    picture = _grey_levels(picture) if purpose.deep else _to_8_bits(picture)
    picture.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    if not purpose.deep:
        picture, notes = _convert_colours(picture, profile)
    picture.info = {}
    return Decoded(picture, size, frames, notes)


def _read_orientation(opened: Image.Image) -> int:
    try:
        return _orientation_of(opened.getexif())
    except Exception:  # damaged EXIF raises exceptions of many types although the pixels are intact
        return 1


def _orientation_of(exif: Image.Exif) -> int:
    value: Any = exif.get(ORIENTATION)
    try:
        first = int(value[0] if isinstance(value, tuple | bytes) else value)
    except (TypeError, ValueError, LookupError, ArithmeticError):
        return 1
    return first if first in TURNS else 1


def _to_8_bits(picture: Image.Image) -> Image.Image:
    """The result has mode RGBA, LA, L or CMYK."""
    if picture.mode in SIXTEEN:
        return _scale_16_bits(picture)
    if picture.mode == "F":
        return _scale_floats(picture)
    if picture.mode in ("1", "L"):
        return picture.convert("LA" if "transparency" in picture.info else "L")
    if picture.mode in ("YCbCr", "LAB", "HSV"):
        picture = picture.convert("RGB")
    return picture if picture.mode in ("CMYK", "LA") else picture.convert("RGBA")


def _scale_16_bits(picture: Image.Image) -> Image.Image:
    import numpy as np

    deep, clear = np.asarray(picture), picture.info.get("transparency")
    grey = Image.fromarray(np.clip(np.rint(deep / 257), 0, 255).astype(np.uint8))
    if clear is not None:
        grey.putalpha(Image.fromarray(255 * (deep != clear).astype(np.uint8)))
    return grey


def _scale_floats(picture: Image.Image) -> Image.Image:
    import numpy as np

    levels = np.asarray(picture)
    if not np.logical_and(levels >= 0, levels <= 1).all():
        limit = "Its values are floating-point numbers that are not all from 0 to 1."
        raise Unusable(limit, "Save the picture with 8 or 16 bits per value.")
    return Image.fromarray(np.rint(255 * levels).astype(np.uint8))


def _grey_levels(picture: Image.Image) -> Image.Image:
    """The result has mode F for 16-bit and float images, otherwise mode L."""
    import numpy as np

    if picture.mode in (*SIXTEEN, "F"):
        return Image.fromarray(np.asarray(picture).astype(np.float32))
    return _convert_colours(_to_8_bits(picture), None)[0].convert("L")


def _read_profile(opened: Image.Image) -> bytes | None:
    """Return the colour profile: empty if it is cut short, None if there is none."""
    return (opened.info["icc_profile"] or b"") if "icc_profile" in opened.info else None


def _convert_colours(
    picture: Image.Image, profile: bytes | None
) -> tuple[Image.Image, tuple[str, ...]]:
    notes = ()
    if profile is not None:
        try:
            return convert_to_srgb(picture, profile), notes
        except ValueError:
            notes = (BAD_PROFILE,)
    plain = picture.convert("RGB") if picture.mode == "CMYK" else picture
    return plain.convert("RGBA"), notes
