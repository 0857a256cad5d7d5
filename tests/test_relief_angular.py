"""relief: symmetric objects with straight vertical and horizontal edges are no solids of
revolution."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.angular import is_angular
from phy124.generators.relief.ends import continue_silhouette
from phy124.generators.relief.picture import PADDING, open_picture, work_picture
from phy124.generators.relief.solids import is_block, is_turned
from support.drawings import X, Y, extents, picture, shaded

WIDTHS = np.select([Y < 20, Y < 60, Y < 90, Y < 115, Y < 135, Y < 170], [0, 46, 64, 82, 66, 82])
PRINTER = abs(X - 96) < WIDTHS
SHIRT = ((abs(X - 96) < 80) & (abs(Y - 50) < 25)) | ((abs(X - 96) < 50) & (abs(Y - 96) < 70))
HOURGLASS = (abs(X - 96) < 12 + 0.8 * abs(Y - 96)) & (abs(Y - 96) < 60)
PLATES = (abs(X - 96) < 64) & (abs(abs(Y - 96) - 68) < 12)
MUSHROOM = (np.hypot(X - 96, Y - 90) < 70) & ((Y < 90) | (abs(X - 96) < 25))


def scaled(drawing):
    return np.asarray(drawing.resize((248, 248)), np.float64) / 255


@pytest.mark.parametrize("outline", [PRINTER, SHIRT])
def test_appliances_and_clothes_are_angular(outline):
    assert is_turned(outline)
    assert is_angular(scaled(picture(outline)))


@pytest.mark.parametrize(
    "drawing",
    [
        picture(np.hypot(X - 96, Y - 96) < 80),
        picture(HOURGLASS | PLATES),
        picture(MUSHROOM),
        picture((abs(X - 96) < 80 - 0.3 * Y) & (abs(Y - 96) < 60)),  # a lampshade
        shaded(PRINTER, np.clip((X - 96) / 82, -1, 1)),
    ],
)
def test_other_symmetric_objects_are_not(drawing):
    assert not is_angular(scaled(drawing))


@pytest.mark.parametrize(("arc", "block"), [(0, True), (8, False)])
def test_a_drum_with_arcs_at_both_ends_is_no_block(arc, block):
    end = 60 + arc * np.sqrt(np.clip(1 - ((X - 96) / 70) ** 2, 0, 1))
    drum = (abs(X - 96) < 70) & (abs(Y - 96) < end)
    rgba = work_picture(open_picture(picture(drum)))
    assert is_angular(rgba)
    assert is_block(continue_silhouette(rgba, PADDING)) == block


def test_an_angular_object_has_a_flat_front_and_is_less_deep_than_wide():
    depth, width = extents(relief(picture(PRINTER), count=6000), -0.1, 0.1)
    assert 0.3 * width < depth < 0.7 * width


SHIELD = (abs(X - 96) < 70 * np.sqrt(np.clip((176 - Y) / 120, 0, 1))) & (abs(X - 96) < 60)
SHIELD &= Y > 30


def continued(solid):
    return continue_silhouette(work_picture(open_picture(picture(solid))), PADDING)


def test_a_shield_is_a_block():
    assert is_block(continued(SHIELD))


@pytest.mark.slow
def test_a_shield_is_less_deep_than_wide():
    depth, width = extents(relief(picture(SHIELD), count=6000), -0.1, 0.4)
    assert 0.2 * width < depth < 0.7 * width


@pytest.mark.parametrize(
    "solid",
    [
        np.hypot((X - 96) / 60, (Y - 96) / 75) < 1,  # an egg
        np.hypot(X - 96, Y - 60) < 90 - np.clip(Y - 60, 0, None) / 2,  # a balloon
        (np.hypot(X - 96, Y - 70) < 55) | ((abs(X - 96) < 22) & (abs(Y - 130) < 40)),  # a bulb
        (np.hypot(X - 96, Y - 60) < 85) & (Y > 60),  # a bowl
        abs(X - 96) < np.clip(np.minimum(Y - 20, (170 - Y) * 0.7), 0, 90),  # a spinning top
        ((abs(X - 96) < 50) & (abs(Y - 50) < 30))
        | ((abs(X - 96) < 8) & (abs(Y - 120) < 60)),  # a pin
    ],
)
def test_other_outlines_with_a_narrow_end_are_no_shields(solid):
    assert not is_block(continued(solid))


def test_an_angular_outline_that_is_shaded_like_a_cylinder_is_round():
    lit = shaded(PRINTER, np.clip((X - 96) / np.maximum(WIDTHS, 1), -1, 1))
    depth, width = extents(relief(lit, count=6000), -0.1, 0.1)
    assert depth == pytest.approx(width, rel=0.1)


def test_the_shape_can_still_be_chosen():
    made = relief(picture(PRINTER), count=6000, shape="upright")
    depth, width = extents(made, -0.1, 0.1)
    assert depth == pytest.approx(width, rel=0.1)
