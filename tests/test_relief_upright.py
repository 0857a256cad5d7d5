"""relief: vessels and drums that are wider than high stand upright and are as deep as wide."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.upright import upright_body
from support.drawings import X, Y, picture


def from_above(top, bottom, rim, foot, tilt):
    """Draw a tapered vessel between two heights, with circles as a raised camera sees them."""
    share = np.clip((Y - top) / (bottom - top), 0, 1)
    wall = (abs(X - 96) < rim + (foot - rim) * share) & (top < Y) & (bottom > Y)
    ends = [
        np.hypot(X - 96, (Y - y) / tilt) < r if tilt else wall
        for y, r in ((top, rim), (bottom, foot))
    ]
    return wall | ends[0] | ends[1]


BOWL, TIN = from_above(60, 120, 80, 40, 0.3), from_above(70, 115, 80, 80, 0.4)
HANDLES = (abs(X - 96) < 90) & (abs(Y - 85) < 5)
POT = from_above(70, 120, 60, 57, 0.4) | HANDLES
SLEEVES = ((abs(X - 96) < 80) & (abs(Y - 70) < 20)) | ((abs(X - 96) < 40) & (abs(Y - 100) < 50))


BULGE = from_above(50, 140, 50, 50, 0.4) | (np.hypot((X - 130) / 24, (Y - 110) / 30) < 1)


@pytest.mark.parametrize("drawn", [BOWL, TIN, POT, BULGE, from_above(60, 120, 80, 40, 0)])
def test_vessels_and_drums_stand_upright(drawn):
    assert upright_body(drawn) is not None


@pytest.mark.parametrize(
    "drawn",
    [
        np.hypot((X - 96) / 80, (Y - 96) / 40) < 1,  # a lemon
        np.hypot(X - 96, Y - 96) < 80,  # a ball or a coin
        np.hypot((X - 96) / 80, (Y - 96) / 74) < 1,  # a cookie
        ((X - 96) / 80) ** 4 + ((Y - 96) / 50) ** 4 < 1,  # a pillow
        (abs(X - 96) < 80) & (abs(Y - 96) < 40),  # a log
        BOWL[::-1],  # a cake, or the front of a car
        from_above(70, 120, 50, 50, 0.4) | ((abs(X - 96) < 90) & (abs(Y - 134) < 6)),  # a hat
        np.roll(BOWL, 30, axis=1) | (Y > 100) & BOWL,  # not symmetric
        SLEEVES,
        from_above(50, 140, 50, 50, 0.4) | (np.hypot((X - 150) / 34, (Y - 110) / 36) < 1),  # a wing
    ],
)
def test_other_wide_outlines_are_left_alone(drawn):
    assert upright_body(drawn) is None


def test_vessels_are_as_deep_as_wide_and_handles_are_thin():
    """The drawings have no shading, which makes other objects flat."""
    print_ = 1 + 0.15 * np.sin(1.1 * X + 0.7 * Y) * np.sin(0.5 * X - 1.3 * Y)
    colours = (print_[..., None] * [180, 150, 60]).astype(np.uint8)
    bowl = relief(picture(BOWL, colours), count=3000).means
    assert np.ptp(bowl[:, 0]) == pytest.approx(np.ptp(bowl[:, 1]), rel=0.07)
    pot = relief(picture(POT, colours), count=3000).means
    assert np.ptp(pot[:, 0]) == pytest.approx(np.ptp(pot[:, 1]) * 60 / 90, rel=0.07)


def test_handle_that_points_to_the_viewer_ends_above_the_foot():
    """A raised camera sees such a handle lower than its roots; the wall shows nothing of it."""
    x, y = X - 150, Y - 100 - 0.3 * (X - 146)
    ring, body = abs(np.hypot(x / 26, y / 30) - 1) < 0.25, from_above(60, 130, 50, 50, 0.4)
    colours = np.where((ring & (X > 140))[..., None], [200, 30, 30], [40, 80, 200])
    mug = relief(picture(body | ring, colours), count=6000)
    red = mug.sh[:, 0, 0] > mug.sh[:, 0, 2]
    handle, wall = mug.means[red], mug.means[~red]
    assert handle[:, 2].min() > wall[wall[:, 1] < 0, 2].min()
    assert handle[:, 0].min() > 0.1 and handle[:, 1].min() > 0.1


def test_lid_with_a_berry_at_the_back_is_flat():
    cake = from_above(70, 115, 80, 80, 0.4) | (np.hypot(X - 96, Y - 37) < 8)
    made = relief(picture(cake), count=5000).means
    top = made[made[:, 2] > made[:, 2].max() - 0.03]
    assert np.ptp(top[:, :2], axis=0) == pytest.approx([0.8, 0.8], abs=0.2)


def test_brim_of_a_hat_is_flat():
    crown = from_above(80, 110, 35, 40, 0.4)
    made = relief(picture(from_above(110, 113, 80, 80, 0.4) | crown), count=5000).means
    upper = made[made[:, 2] > made[:, 2].min() + 0.2 * np.ptp(made[:, 2])]
    assert np.ptp(made[:, 1]) > 0.95 and np.ptp(upper[:, 1]) < 0.6


def test_ellipse_that_may_be_a_plate_gets_advice():
    plate = picture(np.hypot((X - 96) / 80, (Y - 96) / 46) < 1)
    with pytest.warns(UserWarning, match="set shape = upright and photo_elevation = 33"):
        relief(plate, count=500)
    made = relief(plate, count=3000, shape="upright", photo_elevation=33).means
    depth, width, height = np.ptp(made, axis=0)
    assert depth == pytest.approx(width, rel=0.05) and height < 0.15 * width
