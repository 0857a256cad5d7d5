"""Converts images to sRGB according to their ICC colour profiles.

Phones use Display P3, cameras use Adobe RGB, and print shops use CMYK or grey with dot gain.
"""

import io
from typing import Any

from PIL import Image

DESCRIBED = {"RGB ": ("RGBA", "L", "LA"), "GRAY": ("L", "LA"), "CMYK": ("CMYK",)}
"""Modes of the images to which a profile may apply, by the profile's colour space."""
READ = {"RGB ": "RGB", "GRAY": "L", "CMYK": "CMYK"}
"""Mode to which an image without alpha is converted first, by the profile's colour space."""


def convert_to_srgb(picture: Image.Image, profile: bytes) -> Image.Image:
    """Convert an image in mode RGBA, LA, L or CMYK to sRGB, mode RGBA; its alpha is unchanged.

    Raises:
        ValueError: If the profile is damaged, or does not apply to the image's mode.
    """
    try:
        from PIL import ImageCms  # some builds of Pillow lack this module

        source: Any = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        space = source.profile.xcolor_space
        if picture.mode not in DESCRIBED[space]:
            raise ValueError(
                f"the profile describes {space}, but the mode of the picture is {picture.mode}"
            )
        srgb, mode = ImageCms.createProfile("sRGB"), READ[space]
        transform = ImageCms.buildTransform(source, srgb, mode, "RGB")
        result = ImageCms.applyTransform(picture.convert(mode), transform)
        assert result is not None
    except Exception as error:  # the library raises exceptions of many types
        raise ValueError(f"the profile cannot be used ({error})") from error
    result.info = {}
    if "A" in picture.getbands():
        result.putalpha(picture.getchannel("A"))
    return result.convert("RGBA")
