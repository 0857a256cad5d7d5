"""A picture's own transparency, and objects that are half clear."""

import numpy as np
import pytest
from PIL import Image

from phy124.imaging.cutout import cut_out, foreground
from phy124.imaging.transparency import has_alpha, is_faint, make_solid


def square(inside: int, outside: int = 0) -> Image.Image:
    """A red square in the middle, with these alphas within and around it."""
    pixels = np.zeros((60, 80, 4), np.uint8)
    pixels[..., :3], pixels[..., 3] = (200, 40, 30), outside
    pixels[15:45, 20:60, 3] = inside
    return Image.fromarray(pixels)


@pytest.mark.parametrize("alpha", [8, 60, 114, 127, 128, 200, 255])
def test_an_object_that_is_half_clear_throughout_is_taken(alpha):
    cutout = foreground(square(alpha))
    solid = np.asarray(cutout.picture)[..., 3]
    assert (cutout.method, cutout.coverage) == ("alpha", 0.25)
    assert solid.max() == (255 if alpha < 128 else alpha) and solid[0, 0] == 0
    assert bool(cutout.notes) == (alpha < 128)
    assert np.asarray(cutout.picture)[30, 40, :3].tolist() == [200, 40, 30]


def test_the_transparency_of_a_thin_object_is_used():
    """The line covers 0.45 % of the picture."""
    pixels = np.zeros((400, 400, 4), np.uint8)
    pixels[199:201, 20:380] = 200, 40, 30, 255
    cutout = foreground(Image.fromarray(pixels))
    assert (cutout.method, cutout.coverage) == ("alpha", 0.0045)


def test_faint_parts_beside_an_opaque_one_stay_faint():
    picture = square(255, 100)
    assert not is_faint(picture) and has_alpha(picture)
    np.testing.assert_array_equal(np.asarray(make_solid(picture)), np.asarray(picture))
    assert not is_faint(square(3)) and not has_alpha(square(3))


def test_a_faint_photograph_is_searched_like_an_opaque_one():
    assert is_faint(square(114, 114)) and not has_alpha(make_solid(square(114, 114)))
    assert np.asarray(make_solid(square(114, 114)))[..., 3].min() == 255


def test_a_mask_that_is_half_clear_says_where_the_object_is(tmp_path):
    square(255, 255).save(tmp_path / "picture.png")
    square(114).save(tmp_path / "mask.png")
    cutout = cut_out(tmp_path / "picture.png", mask=tmp_path / "mask.png")
    assert (cutout.method, cutout.coverage) == ("mask", 0.25)
