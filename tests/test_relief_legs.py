"""relief: the legs and wheels of objects that are seen from their side are on both sides."""

import numpy as np
import pytest
from PIL import Image

from phy124.generators.relief import relief
from phy124.generators.relief.legs import find_legs
from phy124.generators.relief.single import _legs_beside
from phy124.rendering.render import Renderer
from support.drawings import X, Y, outlines, picture


@pytest.fixture(scope="module")
def renderer():
    return Renderer()


def block(left, right, top, bottom):
    return (left < X) & (right > X) & (top < Y) & (bottom > Y)


def disc(x, y, a, b=None):
    return np.hypot((X - x) / a, (Y - y) / (b or a)) < 1


def image(mask):
    return np.asarray(picture(mask)) / 255


def heights(gaussians, side):
    """Lowest height on one side, m."""
    return gaussians.means[side * gaussians.means[:, 0] > 0.02, 2].min()


LEGS = [
    block(x, x + 12, 100, bottom) for x, bottom in ((30, 170), (50, 164), (110, 170), (130, 164))
]
HORSE = disc(90, 85, 70, 32) | np.any(LEGS, axis=0) | disc(160, 50, 22, 14) | disc(148, 65, 14, 24)
GRAZING = disc(90, 85, 70, 32) | np.any(LEGS, axis=0) | disc(152, 105, 14, 30)
CAR = disc(55, 135, 14) | disc(137, 135, 14) | block(11, 181, 90, 130) | block(30, 120, 60, 95)
BIRD = (
    disc(90, 80, 70, 40) | disc(155, 40, 22) | block(75, 82, 100, 180) | block(100, 107, 100, 176)
)
BISON = (
    disc(90, 88, 72, 30)
    | disc(125, 78, 45, 36)
    | disc(165, 88, 18, 26)
    | block(28, 110, 70, 110)
    | block(34, 52, 90, 145)
    | block(120, 138, 90, 145)
)


@pytest.fixture(scope="module")
def horse():
    return relief(picture(HORSE), count=8000)


@pytest.fixture(scope="module")
def car():
    return relief(picture(CAR), count=8000)


@pytest.fixture
def no_table(monkeypatch):
    """Fitting a table takes most of the time; that a horse is none is seen in `horse`."""
    monkeypatch.setattr("phy124.generators.relief.single.find_table", lambda *_: None)


def test_legs_are_in_pairs_on_both_sides(horse):
    """Without this assumption, all legs are in the vertical plane through the length."""
    low = horse.means[horse.means[:, 2] < -0.15]
    assert abs(low[:, 0]).min() > 0.01
    for side in (-1, 1):
        along = low[side * low[:, 0] > 0, 1]
        gap = np.diff(np.sort(along)).max()
        assert np.ptp(along) > 0.45 and 0.3 < gap < 0.5  # one foreleg, and one hind leg


def test_a_stout_animal_is_no_table():
    """A round stool covers 0.89 of the outline, which is less than it covers of a table's."""
    made = relief(picture(BISON), count=5000)
    assert np.ptp(made.means[:, 0]) < 0.6 * np.ptp(made.means[:, 1])


def test_feet_on_both_sides_stand_on_the_same_ground(horse):
    assert heights(horse, 1) == pytest.approx(heights(horse, -1), abs=0.01)


def test_the_front_camera_still_sees_the_picture(renderer, horse):
    wanted, seen = outlines(renderer, horse, picture(HORSE))
    assert (wanted & seen).sum() / (wanted | seen).sum() > 0.93


@pytest.mark.slow
def test_wheels_are_on_both_sides(car):
    low = car.means[car.means[:, 2] < -0.16]
    assert abs(low[:, 0]).min() > 0.01
    assert len(low[low[:, 0] > 0]) == pytest.approx(len(low[low[:, 0] < 0]), rel=0.1)


def test_a_car_has_flat_sides(car):
    """Without this assumption, the bonnet is a third as deep as the cabin."""
    bonnet = car.means[(car.means[:, 1] > 0.25) & (car.means[:, 1] < 0.35)]
    assert np.ptp(bonnet[:, 0]) > 0.8 * np.ptp(car.means[:, 0])


def test_few_points_are_enough_for_legs(no_table):
    assert len(relief(picture(HORSE), count=200).means) > 50


def test_a_bird_has_one_leg_on_each_side():
    legs = find_legs(image(BIRD))
    assert sorted(leg.sides for leg in legs.legs) == [(-1,), (1,)]
    near = next(leg for leg in legs.legs if leg.sides == (1,))
    assert near.part[:, :95].any() and not near.part[:, 95:].any()  # its foot is lower


def test_a_head_that_hangs_below_the_belly_is_not_a_leg():
    legs = find_legs(image(GRAZING))
    assert legs.body[120, 155]
    assert len(legs.legs) == 4


def test_points_of_legs_inside_the_body_are_removed(horse):
    along, up = horse.means[:, 1], horse.means[:, 2]
    inner = horse.means[(abs(along + 0.03) < 0.2) & (abs(up - 0.08) < 0.05)]
    assert abs(inner[:, 0]).min() > 0.1


TEDDY = disc(96, 60, 40) | disc(96, 120, 45) | disc(70, 160, 16, 22) | disc(122, 160, 16, 22)
BOAT = disc(96, 80, 80, 30)


@pytest.mark.parametrize("mask", [TEDDY, BOAT, block(20, 170, 60, 130)])
def test_other_objects_have_no_legs(mask):
    assert _legs_beside(image(mask)) is None


def test_a_picture_from_behind_keeps_the_legs_in_the_plane(no_table):
    mirrored = Image.fromarray(np.asarray(picture(HORSE))[:, ::-1])
    made = relief(picture(HORSE), count=5000, back=mirrored)
    low = made.means[made.means[:, 2] < -0.15]
    assert abs(low[:, 0]).min() < 0.01
