"""Further pictures: given to the generator cut out, refused where they cannot be used."""

import numpy as np
import pytest
from PIL import Image

from phy124 import pipeline
from phy124.errors import InputError
from phy124.generators.extras import OtherViews


def save_ellipse(path, half_width, half_height):
    y, x = np.mgrid[:96, :96] - 47.5
    inside = np.hypot(x / half_width, y / half_height) < 1
    Image.fromarray(np.dstack([np.full((96, 96, 3), 90), 255 * inside]).astype(np.uint8)).save(path)
    return path


@pytest.fixture
def front(tmp_path):
    return save_ellipse(tmp_path / "front.png", 40, 30)


def test_the_side_is_cut_out_and_makes_the_object_as_deep(front, tmp_path):
    """And the caller sees both cut-outs with their files."""
    views, seen = OtherViews(side=save_ellipse(tmp_path / "side.png", 15, 30)), []
    made = pipeline.make_gaussians(front, views=views, count=500, on_cutout=seen.append)
    size = np.ptp(made.gaussians.means, axis=0)
    assert size[0] == pytest.approx(size[2] / 2, rel=0.15)
    assert [cutout.file.name for cutout in seen] == ["side.png", "front.png"]


def test_a_generator_that_does_not_look_at_them_refuses_them(front):
    """A file of Gaussians does not, either."""

    def other(image_rgba, *, seed, progress):
        raise AssertionError

    for generator in (other, "no.ply"):
        with pytest.raises(InputError, match=r"(?s)back = .*does not use it"):
            pipeline.make_gaussians(front, generator=generator, views=OtherViews(back=front))
        with pytest.raises(InputError, match=r"thickness = 0.5.*does not use it"):
            pipeline.make_gaussians(front, generator=generator, views=OtherViews(thickness=0.5))


def test_a_direction_without_its_picture_is_refused(front):
    with pytest.raises(InputError, match=r"facing = right.*from the side"):
        pipeline.make_gaussians(front, views=OtherViews(facing="right"))


def test_a_picture_that_cannot_be_used_is_named(front, tmp_path):
    empty = tmp_path / "empty.png"
    Image.new("RGB", (96, 96), "white").save(empty)
    for path, why in ((tmp_path / "none.png", "no such file"), (empty, "No object was found")):
        with pytest.raises(InputError, match=f"side = .*{path.name}.*{why}"):
            pipeline.make_gaussians(front, views=OtherViews(side=path), count=500)
