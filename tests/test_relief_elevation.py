"""relief: objects that were photographed from above stand upright."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from phy124.camera import Camera
from phy124.generators.relief import relief
from phy124.generators.relief.lathe import find_lathe
from phy124.generators.relief.rings import find_ring
from phy124.generators.relief.upright import Profile, upright_body
from phy124.rendering.compose.photograph import Photograph, match
from phy124.rendering.render import Renderer
from support.drawings import SIZE, X, Y, mug, outlines, picture

RED, BLUE = (220, 40, 40), (40, 60, 200)
DISTANCE = 2.0 * SIZE
TURN = np.linspace(0, 2 * np.pi, 33)


def raised(elevation):
    return Camera.orbit(0, elevation, 2.0, SIZE, fov_y=40)


def hull(points, elevation):
    """Draw the convex hull of points [N,3] as a raised camera sees it."""
    places, _ = raised(elevation).project(np.asarray(points, float))
    outline = cv2.convexHull(np.rint(16 * places).astype(np.int32))
    drawn = np.zeros((SIZE, SIZE), np.uint8)
    return cv2.fillConvexPoly(drawn, outline, 1, shift=4) > 0


def circle(radius, height):
    angles = np.linspace(0, 2 * np.pi, 65)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(65, height)], axis=1)


def cup(elevation, rim=0.5, foot=0.35):
    """Draw a blue cup with a red lid."""
    lid = circle(rim, 0.25)
    solid = hull([*lid, *circle(foot, -0.25)], elevation)
    return picture(solid, np.where(hull(lid, elevation)[..., None], RED, BLUE))


def ring(elevation, radius=0.4, wide=0.08, high=0.08):
    """Draw the mask of a ring with a round section that lies on the floor."""
    around = np.stack([circle(radius + wide * np.cos(t), high * np.sin(t)) for t in TURN], axis=1)
    return np.any([hull(np.concatenate(pair), elevation) for pair in pairwise(around)], axis=0)


def find_in(mask):
    rows, columns = np.nonzero(mask)
    middle = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
    return find_ring(mask, middle, DISTANCE, None)


@pytest.fixture(scope="module")
def renderer():
    return Renderer(device="cpu")


@pytest.mark.parametrize("elevation", [18, 27, 36])
def test_the_outline_of_a_cup_shows_the_elevation(elevation):
    solid = np.asarray(cup(elevation).getchannel("A")) > 0
    rows = np.flatnonzero(solid.any(axis=1))
    lathe = find_lathe(Profile.of(solid), rows[[0, -1]].mean(), DISTANCE)
    assert lathe is not None
    assert np.degrees(lathe.camera.elevation) == pytest.approx(elevation, abs=4)
    assert lathe.radii[0] / lathe.radii[-1] == pytest.approx(0.7, abs=0.06)


@pytest.mark.parametrize(
    "solid",
    [
        np.hypot(X - 96, Y - 96) < 80,  # a ball
        (abs(X - 96) < 80) & (abs(Y - 96) < 40),  # a drum from the front
        (np.hypot(X - 96, (Y - 96) / 0.5) < 80) & (Y < 110),  # a heap from the front
    ],
)
def test_other_outlines_show_no_elevation(solid):
    assert find_lathe(Profile.of(solid), 96.0, DISTANCE) is None


def test_a_cup_stands_upright_and_its_lid_is_flat(renderer):
    shown = cup(27)
    made = relief(shown, count=6000)
    wanted, drawn = outlines(renderer, made, shown, 27)
    assert (wanted & drawn).sum() / (wanted | drawn).sum() > 0.95
    x, y, z = made.means.T
    lid = z > z.max() - 0.004
    across = np.ptp(made.means[lid], axis=0)
    assert across[0] == pytest.approx(across[1], rel=0.05)
    assert across[1] == pytest.approx(np.ptp(y), rel=0.05)
    assert np.ptp(z) / np.ptp(y) == pytest.approx(0.5, abs=0.05)
    red = made.sh[:, 0, 0] > made.sh[:, 0, 2]
    inner = np.hypot(x - x[lid].mean(), y) < 0.8 * across[1] / 2
    assert red[lid & inner].mean() > 0.99
    assert red[z < z.max() - 0.06].mean() < 0.01


@pytest.mark.parametrize(
    ("foot", "elevation"), [(0.2, 15), (0.2, 25), (0.2, 40), (0.26, 25), (0.26, 40)]
)
def test_a_mug_is_recognised_beside_the_centre_with_its_handle(foot, elevation):
    """Its axis leans in the picture, and its handle joins it at the rim."""
    body = hull([*circle(0.3, 0.3), *circle(foot, -0.3)] + np.array([0, -0.12, 0]), elevation)
    rows = np.flatnonzero(body.any(axis=1))
    handle = X[0, np.flatnonzero(body[rows[30]])[-1]], Y[rows[30], 0]
    solid = body | (abs(np.hypot(X - handle[0], Y - handle[1]) - 22) < 5) & (handle[0] - 9 < X)
    seen = upright_body(solid)
    assert seen is not None
    assert np.count_nonzero(seen ^ body) < 0.015 * np.count_nonzero(body)


def test_a_lying_egg_is_no_vessel():
    assert upright_body(np.hypot((X - 96) / 80, (Y - 96) / 48) < 1) is None


def test_a_bowl_is_recognised_from_high_above():
    assert upright_body(hull([*circle(0.5, 0.2), *circle(0.2, -0.2)], 40)) is not None


@pytest.mark.parametrize(
    ("wall", "elevation"),
    [
        ([(0.2, 0), (0.35, 0.12), (0.5, 0.32)], 40),  # a bowl whose lower wall is hidden
        ([(0.4, 0), (0.42, 0.4)], 40),  # a pot
        ([(0.45, 0), (0.5, 0.15)], 25),  # a petri dish
    ],
)
def test_only_a_bowl_continues_below_its_visible_wall(wall, elevation):
    (foot, _), (rim, high) = wall[0], wall[-1]
    solid = hull(np.concatenate([circle(radius, z - high / 2) for radius, z in wall]), elevation)
    rows = np.flatnonzero(solid.any(axis=1))
    lathe = find_lathe(Profile.of(solid), rows[[0, -1]].mean(), DISTANCE)
    assert lathe is not None
    assert lathe.radii[0] / lathe.radii[-1] == pytest.approx(foot / rim, abs=0.06)
    assert np.ptp(lathe.heights) / lathe.radii[-1] == pytest.approx(high / rim, rel=0.12)


@pytest.mark.parametrize(("elevation", "high"), [(20, 0.08), (30, 0.12), (45, 0.08)])
def test_outline_and_hole_show_how_a_ring_lies(elevation, high):
    lying = find_in(ring(elevation, high=high))
    assert lying is not None
    assert np.degrees(lying.camera.elevation) == pytest.approx(elevation, abs=4)
    assert lying.wide / lying.radius == pytest.approx(0.08 / 0.4, abs=0.06)
    assert lying.high / lying.radius == pytest.approx(high / 0.4, abs=0.06)


@pytest.mark.parametrize(
    "solid",
    [
        abs(np.hypot(X - 96, Y - 96) - 60) < 20,  # a ring from the front
        abs(np.hypot((X - 96) * 2, Y - 96) - 60) < 20,  # an upright frame
        (np.hypot((X - 96) / 80, (Y - 96) / 40) < 1) & (np.hypot(X - 70, Y - 96) > 15),
        np.asarray(mug().getchannel("A")) > 0,
    ],
)
def test_other_outlines_with_a_hole_show_no_ring(solid):
    assert find_in(solid) is None


def test_a_ring_lies_on_the_floor_with_its_hole_open(renderer):
    shown = picture(ring(30))
    made = relief(shown, count=4000)
    wanted, drawn = outlines(renderer, made, shown, 30)
    assert (wanted & drawn).sum() / (wanted | drawn).sum() > 0.9
    x, y, z = made.means.T
    width = np.ptp(y)
    assert np.ptp(x) == pytest.approx(width, rel=0.02)
    assert np.ptp(z) / width == pytest.approx(0.16 / 0.96, abs=0.05)
    away = np.hypot(x - (x.min() + x.max()) / 2, y - (y.min() + y.max()) / 2)
    assert away.min() / width > 0.25


def test_the_photograph_of_a_cup_is_matched_from_its_elevation():
    shown = cup(27)
    camera, likeness = match(relief(shown, count=6000), Photograph.of(shown, shown))
    ahead, _, up = np.subtract(camera.eye, camera.target)
    assert np.degrees(np.arctan2(up, ahead)) == pytest.approx(27, abs=5)
    assert likeness > 20


def test_boxes_stand_upright():
    half = np.array([0.25, 0.4, 0.2])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    cosine, sine = np.cos(np.radians(35)), np.sin(np.radians(35))
    corners = corners @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    z = relief(picture(hull(corners, 35)), count=4000).means[:, 2]
    level = (z > z.max() - 0.02).mean() + (z < z.min() + 0.02).mean()
    area = half.prod() / half
    assert level == pytest.approx(area[2] / area.sum(), abs=0.08)


def test_thickness_and_back_look_do_not_change_the_kind_of_object():
    whole, flat = (relief(cup(25), count=3000, thickness=t) for t in (1.0, 0.5))
    # Only wide Gaussians at the ends are moved, and not equally far.
    away = np.abs(flat.means - whole.means * [0.5, 1, 1]).max(axis=1)
    assert np.mean(away < 1e-6) > 0.9 and away.max() < whole.scales.max()
    with pytest.warns(UserWarning, match=r"back_look = plain.*no effect"):
        relief(cup(25), count=3000, back_look="plain")


def test_a_known_elevation_turns_the_object_upright():
    """The picture from this elevation stays the same."""
    plank = picture((abs(X - 96) < 30) & (abs(Y - 96) < 80))
    front, made = (
        relief(plank, count=4000, shape="flat", photo_elevation=elevation)
        for elevation in (None, 30)
    )
    x, _, z = made.means.T
    top, bottom = z > np.quantile(z, 0.9), z < np.quantile(z, 0.1)
    assert abs(x[top].mean() - x[bottom].mean()) < 0.05
    places, raised_places = (
        raised(elevation).project(gaussians.means.astype(float))[0]
        for gaussians, elevation in ((front, 0), (made, 30))
    )
    # Only Gaussians at the ends are moved, by up to their width of 0.85 pixels.
    away = np.abs(raised_places - places).max(axis=1)
    assert np.mean(away < 0.01) > 0.95 and away.max() < 1


@pytest.mark.filterwarnings("ignore:shape = auto")
def test_the_shape_can_be_chosen():
    solid = np.hypot((X - 96) / 80, (Y - 96) / 40) < 1
    deep = {
        shape: np.ptp(relief(picture(solid), count=2000, shape=shape).means[:, 0])
        for shape in ("auto", "round", "upright", "flat")
    }
    assert deep["round"] == pytest.approx(0.5, abs=0.05)
    assert deep["auto"] == pytest.approx(deep["round"], abs=0.05)
    assert deep["upright"] == pytest.approx(1.0, abs=0.08)
    assert deep["flat"] < 0.3
