"""relief: furniture and vehicles seen obliquely stand on their feet, and their depth is a guess."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phy124.generators.relief import VIEW_DISTANCE, relief
from phy124.generators.relief.oblique import find_oblique
from phy124.generators.relief.surface import View
from support.drawings import SIZE, X, Y, picture

HALF = np.array([35.0, 30.0, 65.0])
"""Half the sides of a bed [pixels]."""
PARTS = [((-1, -0.6, -1), (1, 0.5, 1)), ((-1, -1, 0.9), (1, 0.5, 1))] + [
    ((x, 0.4, z), (x + 0.25, 1, z + 0.15)) for x in (-1, 0.75) for z in (-1, 0.85)
]
"""Opposite corners of the mattress, the headboard and the legs, relative to half the sides."""


def drawn(yaw, pitch=14.0):
    """Draw the mask of the bed; x points to the right, y down, and z towards the camera."""
    turn, mask = Rotation.from_euler("yx", [yaw, -pitch], degrees=True), np.zeros((SIZE, SIZE))
    for low, high in PARTS:
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
        x, y, z = turn.apply(corners * HALF).T
        seen = np.stack([x, y], axis=1) / (1 - z / (2.5 * SIZE))[:, None] + SIZE / 2
        cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(seen).astype(np.int32)), 1.0)
    return mask > 0


def box_of(mask):
    return find_oblique(mask, View.of(mask, VIEW_DISTANCE * SIZE))


def disc(x, y, a, b=None):
    return np.hypot((X - x) / a, (Y - y) / (b or a)) < 1


@pytest.fixture(scope="module")
def bed():
    with pytest.warns(UserWarning, match=r"two sides.*depth is a guess.*shape = round"):
        return relief(picture(drawn(60)), count=8000)


def test_the_box_has_the_direction_and_the_sides_of_the_bed():
    box = box_of(drawn(60))
    assert box is not None
    yaw, pitch = np.degrees(np.arcsin(box.turn[0, 2])), np.degrees(np.arcsin(box.turn[2, 1]))
    assert (yaw, abs(pitch)) == pytest.approx((60, 14), abs=6)
    assert box.half / box.half[2] == pytest.approx(HALF / HALF[2], rel=0.4)


def test_an_object_seen_obliquely_stands_on_its_feet(bed):
    """An inflated bed ends in a keel, which is a fifth as deep as wide."""
    low = bed.means[bed.means[:, 2] < bed.means[:, 2].min() + 0.03]
    depth, width = np.ptp(low[:, :2], axis=0)
    assert min(depth, width) > 0.5 * np.ptp(bed.means[:, 1])


def test_the_walls_of_the_box_are_vertical(bed):
    """As large below as above, apart from the headboard."""
    up = bed.means[:, 2] - bed.means[:, 2].min()
    high, low = (np.ptp(bed.means[part, 1]) for part in (up > 0.25, up < 0.1))
    assert high > 0.5 * low


@pytest.mark.parametrize(
    "mask",
    [
        drawn(0),  # from its side
        disc(55, 135, 14)
        | disc(137, 135, 14)
        | ((abs(X - 96) < 85) & (abs(Y - 110) < 20)),  # a car
        disc(96, 60, 40) | disc(96, 120, 45) | disc(70, 165, 16, 22) | disc(122, 160, 16, 22),
        (abs(X - 96) < 60) & (abs(Y - 96) < 70),
    ],
)
def test_other_objects_are_not_carved(mask):
    assert box_of(mask) is None
