"""Opens PNG, TIFF and HEIC files without the metadata that can make Pillow fail."""

import io
import struct
import zlib
from contextlib import suppress
from importlib.util import find_spec

from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

TIFF_BEGINNINGS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
PNG_START = 8
CHUNK_FRAME = 12
"""Size of a PNG chunk without its data: length, kind and checksum [bytes]."""
TRANSPARENCY = b"tRNS"
"""The only optional chunk of a PNG file that changes the pixels."""
USEFUL = (b"iCCP", b"eXIf", b"acTL", b"fcTL")
"""Optional chunks that phy124 uses; their checksums are corrected."""


def strip_png(data: bytes) -> bytes:
    """Return a PNG file without unused chunks, because Pillow refuses damaged chunks."""
    kept, place = [data[:PNG_START]], PNG_START
    while place < len(data):
        end = place + CHUNK_FRAME + int.from_bytes(data[place : place + 4], "big")
        kind, chunk = data[place + 4 : place + 8], data[place:end]
        # names of mandatory chunks begin with a capital letter
        if kind == TRANSPARENCY or not kind[:1].islower():
            kept.append(chunk)
        elif kind in USEFUL:
            kept += [chunk[:-4], struct.pack(">I", zlib.crc32(chunk[4:-4]))]
        place = len(data) if kind == b"IEND" else end
    return b"".join(kept)


class PlainTiff(TiffImageFile):
    """A TIFF image that Pillow does not rotate; with damaged EXIF data, the rotation would fail."""

    def load_end(self) -> None:
        """Do nothing; Pillow's own method would rotate the image."""


def open_tiff(data: bytes) -> TiffImageFile:
    """Open the first image of a TIFF file without decoding it."""
    picture = PlainTiff(io.BytesIO(data))
    with suppress(Exception):  # damaged EXIF raises exceptions of many types
        picture.getexif()  # Pillow must read EXIF now, because the file is closed after decoding
    return picture


def can_read_heic() -> bool:
    """Whether the package that reads HEIC is installed."""
    return find_spec("pi_heif") is not None


def open_heic(data: bytes) -> Image.Image:
    """Open a HEIC image in the orientation of its container; EXIF's orientation is ignored.

    Raises:
        Exception: An exception of any type if the file is damaged.
    """
    import pi_heif

    file = pi_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=True)
    picture = file.to_pillow()
    picture.info.pop("exif", None)
    picture.info.pop("xmp", None)
    return picture
