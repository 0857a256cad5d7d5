"""relief: the flat upper edge of a body from which other parts rise."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.ends import continue_silhouette
from phy124.generators.relief.shoulders import find_shoulder
from phy124.generators.relief.surface import Surface, View
from support.drawings import SIZE, X, Y, extents, picture

POT = (abs(X - 96) < 60 - (Y - 80) / 8) & (Y > 80) & (Y < 180)
STALK = (abs(X - 90) < 6) & (Y > 20) & (Y < 90)
PLANT = POT | STALK
HIGH_POT = ((abs(X - 96) < 40) & (Y > 40) & (Y < 180)) | ((abs(X - 90) < 4) & (Y > 20) & (Y < 50))


def shoulder_of(mask):
    alpha = np.pad(mask.astype(np.float64), 8)
    return find_shoulder(continue_silhouette(np.dstack([alpha] * 4), 8))


def test_the_edge_of_a_pot_is_found_beside_the_stalk():
    shoulder = shoulder_of(PLANT)
    assert shoulder is not None
    body = np.flatnonzero(np.isfinite(shoulder.edge))
    assert (body[0], body[-1]) == pytest.approx((44, 163), abs=1)
    assert shoulder.edge[body] == pytest.approx(88)
    assert np.flatnonzero(~shoulder.visible[body]) + body[0] == pytest.approx(np.arange(92, 104))


@pytest.mark.parametrize(
    "mask",
    [
        (np.hypot(X - 96, Y - 110) < 60) | STALK,  # an apple
        ((abs(X - 96) < 60 - abs(Y - 120) / 2) & (abs(Y - 120) < 60)) | STALK,  # an urn
        (abs(X - 96) < 60) & (abs(Y - 100) < 60),  # a box
        ((abs(X - 96) < 80) & (abs(Y - 88) < 8)) | (POT & (abs(X - 96) < 30)) | STALK,  # a table
    ],
)
def test_other_objects_have_no_such_edge(mask):
    assert shoulder_of(mask) is None


@pytest.mark.parametrize("mask", [PLANT, pytest.param(HIGH_POT, marks=pytest.mark.slow)])
def test_a_pot_is_as_deep_at_its_edge_as_below_and_the_stalk_stays_thin(mask):
    made = relief(picture(mask), count=20_000, shape="round")
    edge = np.flatnonzero(mask[:, 50] | mask[:, 60])[0]
    rows = np.flatnonzero(mask.any(axis=1))
    top = 0.5 - (edge - rows[0]) / (np.ptp(rows) + 1)
    at_edge, below = extents(made, top - 0.15, top - 0.05), extents(made, top - 0.4, top - 0.2)
    assert at_edge[0] > 0.8 * below[0]
    assert extents(made, top + 0.06, 0.48)[0] < 0.2 * below[0]


def test_an_angular_body_is_less_deep_than_wide():
    suitcase = (abs(X - 96) < 70) & (abs(Y - 110) < 60)
    handle = (abs(X - 96) < 25) & (Y > 30) & (Y < 60) & ~((abs(X - 96) < 15) & (Y > 40))
    wheels = (abs(abs(X - 96) - 55) < 10) & (Y > 100) & (Y < 172)
    solid = suitcase | handle | wheels
    assert shoulder_of(solid) is not None
    depth, width = extents(relief(picture(solid), count=6000), -0.1, 0.1)
    assert 0.2 * width < depth < 0.6 * width


def test_separate_parts_are_joined_in_their_places():
    shoulder, alpha = shoulder_of(PLANT), np.pad(PLANT.astype(np.float64), 8)
    assert shoulder is not None
    parts = shoulder.separate(alpha, 8)
    assert np.array_equal(shoulder.join(parts, alpha) > 0.5, alpha > 0.5)
    gap = parts[shoulder.row :].any(axis=1).argmin() + shoulder.row
    assert not parts[gap : gap + 8].any()


@pytest.mark.parametrize("eye", [60.0, 150.0])
def test_the_body_ends_at_a_horizontal_plane(eye):
    """Below and above the camera, whose height is that of the row `eye`."""
    shoulder, alpha = shoulder_of(PLANT), np.pad(PLANT.astype(np.float64), 8)
    assert shoulder is not None
    view = View(np.array([104.0, eye, 0.0]), 2.0 * SIZE)
    surface = shoulder.close(Surface.of(np.where(alpha > 0.5, 900.0, -1.0)), view, alpha)
    rows, column = np.arange(88, 110), 130
    half, m = np.sqrt(surface.w[rows, column]), surface.m[rows, column]
    z = m + half if eye < 88 else m - half
    height = (rows - eye) * view.k(z)
    cut = (abs(z) < 29) & (rows > 91)
    assert cut.any()
    back = np.copysign(30.0, eye - 88)
    assert height[cut] == pytest.approx((87.5 - eye) * view.k(np.array(back)), abs=0.01)
