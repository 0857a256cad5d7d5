"""Pictures painted over the object are opened as pictures are: upright, 16 bits, within limits."""

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.painted import Canvas, sample_brightness
from support.hostile import png_claiming

CORNERS = np.array([[0, -1, 1], [0, 1, 1], [0, -1, -1], [0, 1, -1]], float)
"""Top left, top right, bottom left, bottom right, seen from the front."""
FRONT = Canvas.of(CORNERS)


def test_a_picture_of_four_pixels(tmp_path):
    Image.fromarray(np.array([[0, 51], [102, 255]], np.uint8)).save(tmp_path / "a.png")
    grey = sample_brightness(CORNERS, str(tmp_path / "a.png"), FRONT, field="parts.0.mask")
    np.testing.assert_allclose(grey, [0, 0.2, 0.4, 1])


def test_sixteen_bits_are_scaled_not_clipped(tmp_path):
    deep = (np.array([[0, 51], [102, 255]]) * 257).astype(np.uint16)
    Image.fromarray(deep).save(tmp_path / "a.png")
    grey = sample_brightness(CORNERS, str(tmp_path / "a.png"), FRONT, field="parts.0.mask")
    np.testing.assert_allclose(grey, [0, 0.2, 0.4, 1])


def test_painted_map_is_rotated_like_the_picture(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # lies on its left side
    picture = Image.fromarray(np.array([[0, 51], [102, 255]], np.uint8))
    picture.save(tmp_path / "a.png", exif=exif)
    grey = sample_brightness(CORNERS, str(tmp_path / "a.png"), FRONT, field="parts.0.mask")
    np.testing.assert_allclose(grey, [0.4, 0, 1, 0.2])


def test_a_bomb_is_refused_with_the_name_of_the_field(tmp_path):
    (tmp_path / "bomb.png").write_bytes(png_claiming(30_000, 30_000))
    with pytest.raises(InputError, match=r"stiffness.file = .*more than 50 million pixels"):
        sample_brightness(CORNERS, str(tmp_path / "bomb.png"), FRONT, field="stiffness.file")
