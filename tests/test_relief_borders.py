"""relief: objects with a border along their outline, such as coins and signs, are thin."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.borders import has_border
from support.drawings import X, Y, picture

AWAY = np.hypot(X - 96, Y - 96) / 80
DISC = AWAY < 1
TOWARDS = np.sqrt(np.clip(1 - AWAY**2, 0, 1))
STRIPED = np.where(X % 24 < 12, 0.9, 0.5)
SQUARE = (abs(X - 96) < 60) & (abs(Y - 96) < 60)


def painted(mask, light):
    """Paint an object in one colour whose brightness is `light` [H,W]."""
    return picture(mask, (light[..., None] * [220, 190, 120]).astype(np.uint8))


def plate(width, border=0.95, inside=0.6):
    """Return the brightness of a disc with a border."""
    return np.where(1 - width < AWAY, border, inside) * (0.7 + 0.3 * TOWARDS)


def depth(image):
    means = relief(image, count=3000).means
    return np.ptp(means[:, 0])


def test_a_disc_with_a_border_is_thin():
    """It is shaded like a ball; without the border it is round."""
    assert depth(painted(DISC, plate(0.25))) < 0.12
    assert depth(painted(DISC, plate(0))) > 0.9


def test_feet_and_bells_do_not_hide_the_border_of_a_disc():
    """An alarm clock is thin, and a ball with feet is not."""
    away = np.hypot(X - 96, Y - 90) / 64
    feet = (abs(abs(X - 96) - 40) < 8) & (Y > 100) & (Y < 180)
    clock = (away < 1) | feet | (np.hypot(abs(X - 96) - 40, Y - 30) < 18)
    border = np.where(away > 0.8, 0.9, 0.5)
    assert depth(painted(clock, border)) < 0.12
    assert depth(painted(clock, np.full(X.shape, 0.7))) > 0.5


SIGN = np.where((abs(X - 96) < 52) & (abs(Y - 96) < 52), 0.4, 0.9)


def test_a_sign_has_a_border():
    assert has_border(np.asarray(painted(SQUARE, SIGN)) / 255)


@pytest.mark.slow
def test_a_sign_with_a_border_is_thin():
    """A square without a border is a cube."""
    assert depth(painted(SQUARE, SIGN)) < 0.12
    assert depth(painted(SQUARE, np.full(X.shape, 0.9))) > 0.7


def test_light_from_the_side_shows_the_border_of_a_plate():
    """The slope between border and middle is bright on one side and dark on the other."""
    slope = np.exp(-(((AWAY - 0.7) / 0.03) ** 2)) * (X - 96 + Y - 96) / 113
    assert has_border(np.asarray(painted(DISC, 0.6 + 0.3 * slope)) / 255)


def test_the_width_of_a_border_may_vary():
    bent = AWAY + 0.02 * np.cos(2 * np.arctan2(Y - 96, X - 96))
    shown = np.where(bent > 0.8, 0.9, 0.6)
    assert has_border(np.asarray(painted(DISC, shown)) / 255)


@pytest.mark.parametrize(
    "light",
    [
        0.5 + 0.4 * TOWARDS,  # shading
        np.where(AWAY > 0.95, 0.0, 0.8),  # a drawn outline
        STRIPED,
        np.where(np.hypot(X - 120, Y - 96) < 50, 0.9, 0.5),  # a circle that is not in the middle
        np.where((AWAY > 0.8) & (X > 60), 0.9, 0.5),  # two thirds of a border
    ],
)
def test_other_discs_have_no_border(light):
    assert not has_border(np.asarray(painted(DISC, light)) / 255)


def test_a_chessboard_has_no_border():
    """The lines next to the outline are parallel to it; the benchmark's cube is painted so."""
    squares = ((X - 81) // 30 + (Y - 81) // 30) % 2
    assert not has_border(np.asarray(painted(SQUARE, 0.3 + 0.5 * squares)) / 255)


def test_a_border_counts_only_if_the_shape_is_chosen_automatically():
    round_ = relief(painted(DISC, plate(0.25)), count=3000, shape="round")
    assert np.ptp(round_.means[:, 0]) > 0.9
