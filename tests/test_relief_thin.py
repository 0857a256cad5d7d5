"""relief: wings, fish and wheels are thinner than they are wide."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.thin import TYRE, find_fish, find_thin, find_wheels, find_wings
from support.drawings import X, Y, extents, picture


def disc(x, y, a, b=None):
    return np.hypot((X - x) / a, (Y - y) / (b or a)) < 1


def butterfly(lean=0.0):
    turn = np.radians(lean)
    x = (X - 96) * np.cos(turn) + (Y - 96) * np.sin(turn)
    y = (Y - 96) * np.cos(turn) - (X - 96) * np.sin(turn)
    upper, lower = (np.hypot((abs(x) - 45) / a, (y - d) / 28) < 1 for a, d in ((40, -20), (30, 25)))
    return upper | lower | (np.hypot(x / 8, y / 40) < 1)


def bar(start, end, half=3.0):
    start, end = np.array(start), np.array(end)
    along = end - start
    part = ((X - start[0]) * along[0] + (Y - start[1]) * along[1]) / (along @ along)
    part = np.clip(part, 0, 1)
    return np.hypot(X - start[0] - part * along[0], Y - start[1] - part * along[1]) < half


HEART = (abs(X - 96) < 70) & (60 - 12 * np.sin(abs(X - 96) / 22) < Y) & (abs(X - 96) + Y < 165)
FISH = disc(75, 96, 60, 40) | ((X > 130) & (X < 175) & (abs(Y - 96) < 6 + 0.5 * (X - 130)))
MUG = (abs(X - 70) < 50) & (abs(Y - 96) < 60) | (abs(np.hypot(X - 120, Y - 96) - 36) < 9)
BICYCLE = (
    disc(45, 130, 38)
    | disc(148, 130, 38)
    | bar((45, 130), (80, 70))
    | bar((80, 70), (135, 70))
    | bar((148, 130), (128, 50))
    | bar((80, 70), (95, 130))
    | bar((135, 70), (95, 130))
)
CAR = disc(55, 130, 18) | disc(137, 130, 18) | ((abs(X - 96) < 85) & (abs(Y - 95) < 35))
TRUCK = disc(45, 130, 32) | disc(147, 130, 32) | ((abs(X - 96) < 80) & (abs(Y - 98) < 50))
CHERRIES = (
    disc(60, 140, 32) | disc(130, 140, 32) | bar((60, 110), (96, 20)) | bar((130, 110), (96, 20))
)


@pytest.mark.parametrize("lean", [pytest.param(0, marks=pytest.mark.slow), 8])
def test_a_butterfly_is_a_sheet_with_a_body(lean):
    """Its depth without this assumption is 0.33 of its width."""
    wings = find_wings(butterfly(lean))
    assert wings is not None
    assert np.degrees(wings.lean) == pytest.approx(lean, abs=1.5)
    made = relief(picture(butterfly(lean)), count=5000)
    far = made.means[abs(made.means[:, 1]) > 0.2]
    assert np.ptp(far[:, 0]) < 0.08 < np.ptp(made.means[:, 0]) < 0.15


@pytest.mark.parametrize("outline", [HEART, disc(96, 96, 80, 40), FISH, MUG, CAR, CHERRIES])
def test_other_objects_have_no_wings(outline):
    assert find_wings(outline) is None


def test_a_fish_is_thinner_than_high():
    made, round_ = (
        extents(relief(picture(FISH), count=5000, shape=shape), -1, 1)[0]
        for shape in ("auto", "round")
    )
    assert made == pytest.approx(0.6 * round_, rel=0.05)
    assert find_fish(FISH[:, ::-1]) is not None


@pytest.mark.parametrize("outline", [HEART, MUG, CAR, disc(96, 96, 80, 40), BICYCLE])
def test_other_objects_are_no_fish(outline):
    assert find_fish(outline) is None


def test_the_wheels_of_a_bicycle_are_discs():
    wheels = find_wheels(BICYCLE)
    assert wheels is not None
    for wheel, x in ((wheels.left, 45), (wheels.right, 148)):
        assert (wheel.x, wheel.y) == pytest.approx((x - 0.5, 129.5), abs=2)
        assert wheel.radius == pytest.approx(38, rel=0.05)
    flat = np.sqrt(wheels.flatten(np.full(BICYCLE.shape, 38.0**2)))
    assert flat[130, 45] == pytest.approx(TYRE * wheels.left.radius, rel=0.01)
    assert flat[20, 20] == pytest.approx(38, rel=0.01)


@pytest.mark.parametrize("outline", [CAR, TRUCK, CHERRIES, MUG, FISH])
def test_other_objects_have_no_such_wheels(outline):
    assert find_wheels(outline) is None


def test_a_round_object_stays_round():
    """The shape that the user chooses is kept."""
    assert find_thin(disc(96, 96, 80)) is None
    made = relief(picture(butterfly()), count=5000, shape="round")
    assert np.ptp(made.means[:, 0]) > 0.25
