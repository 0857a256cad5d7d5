"""Converts pictures to sRGB by their colour profiles (ICC).

Phones write Display P3, cameras Adobe RGB, print shops CMYK and grey with dot gain.
"""

from __future__ import annotations

import io
from typing import Any

from PIL import Image

DESCRIBED = {"RGB ": ("RGBA", "L", "LA"), "GRAY": ("L", "LA"), "CMYK": ("CMYK",)}
"""Colour space of a profile -> modes of the pictures it describes."""
READ = {"RGB ": "RGB", "GRAY": "L", "CMYK": "CMYK"}
"""Colour space of a profile -> mode in which the picture is converted, without its alpha."""


def convert_to_srgb(picture: Image.Image, profile: bytes) -> Image.Image:
    """Convert a picture to sRGB, mode RGBA; its alpha stays.

    Args:
        picture: The picture, in mode RGBA, LA, L or CMYK.
        profile: The bytes of its ICC profile.

    Raises:
        ValueError: The profile is damaged, or describes pictures of another kind.
    """
    try:
        from PIL import ImageCms  # Some builds of Pillow lack it.

        source: Any = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        space = source.profile.xcolor_space
        if picture.mode not in DESCRIBED[space]:
            raise ValueError(f"it describes {space}, the picture is {picture.mode}")
        srgb, mode = ImageCms.createProfile("sRGB"), READ[space]
        transform = ImageCms.buildTransform(source, srgb, mode, "RGB")
        result = ImageCms.applyTransform(picture.convert(mode), transform)
        assert result is not None
    except Exception as error:  # The library raises many types.
        raise ValueError(f"the profile cannot be used ({error})") from error
    result.info = {}
    if "A" in picture.getbands():
        result.putalpha(picture.getchannel("A"))
    return result.convert("RGBA")
