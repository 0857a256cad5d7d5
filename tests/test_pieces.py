"""Separate pieces of a body in one cell, or around one node (phy124/particles/pieces.py)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from phy124.particles.lattice import cells_of, lattice_of, points_of
from phy124.particles.solid import Solid
from phy124.studies.validation.bodies import fill_solid
from support.lattices import DX, E, Statics, block, fork, rod

PLACES = [(0, 0, 0), (0.1, 0.7, 0.8), (0.5, 0.5, 0.3)]


def points(solid):
    return lattice_of(solid, density=1000, dx=DX)


def test_solid_bodies_have_no_copies():
    ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 7
    for solid in (block((0.8, 0.6, 0.4)), Solid(np.zeros(3, int), DX / 3, ball.astype(np.float32))):
        assert points(solid).copies is None
    for start in ((0.2, 0.3, 0.4), (0.5, 0.5, 0.5), (0.1, 0.7, 0.9)):
        assert points(rod(0.5, (1, 0.36, 0), np.array(start))).copies is None


def curvature(solid, start, turn):
    """Return how far a beam bends that is held at its start and pushed at its end [1/cells^4].

    Args:
        solid: The beam; its length from `start` is 12 cells.
        start: Where the beam is held [3], cells.
        turn: Directions along the beam, of its width, and of the push, as columns [3,3].

    Returns:
        Inverse of the second moment of area, computed from the curvature of the middle part.
    """
    along, _, out = turn.T
    statics = Statics(solid, lambda x: (x - start) @ along < 0)
    s = (statics.x - start) @ along
    u = statics.solve(statics.push(s > 11, out)) @ out
    inner = (s > 2.5) & (s < 9.5)
    bent = np.polyfit(s[inner], u[inner], 3)
    return (36 * bent[0] + 2 * bent[1]) * E * DX / (11.5 - 6)


@pytest.mark.parametrize(
    ("thick", "along", "place"),
    [
        (0.5, (1, 0.36, 0), (0.1, 0.7, 0.9)),
        (0.5, (1, 0.36, 0), (0.5, 0.5, 0.5)),
        (0.5, (1, 0.5, 0.3), (0.5, 0.5, 0.5)),
        (1.0, (1, 0.5, 0.3), (0.5, 0.5, 0.3)),
    ],
)
def test_rods_of_slivers_stay_whole_and_bend_like_beams(thick, along, place):
    """A slanted rod of half a cell fills less than 0.15 of most of its cells."""
    along = np.array(along) / np.linalg.norm(along)
    across = np.cross(along, (0, 1, 0)) / np.hypot(along[0], along[2])
    solid = rod(thick, along, np.array(place))
    turn = np.stack([along, np.cross(across, along), across], axis=1)
    assert curvature(solid, place, turn) == pytest.approx(64 / math.pi / thick**4, rel=0.1)


@pytest.mark.parametrize(
    ("thick", "degrees", "roll", "height"),
    [
        (0.3, 0, 0, 0.0),
        (0.3, 20, 25, 0.2),
        (0.3, 45, 0, 0.0),
        pytest.param(0.5, 0, 0, 0.0, marks=pytest.mark.slow),
        (0.5, 20, 25, 0.0),
        pytest.param(0.7, 45, 0, 0.25, marks=pytest.mark.slow),
        pytest.param(1.0, 30, 0, 0.25, marks=pytest.mark.slow),
        (1.5, 45, 0, 0.5),
    ],
)
def test_plates_bend_like_beams(thick, degrees, roll, height):
    """Narrow plates on voxels of half a cell, the rims of which fill parts of voxels.

    In the first case the outermost nodes are so light that they are tied.
    """
    angle, start = math.radians(degrees), np.array([0.13, 0.27, height])
    along = np.array([math.cos(angle), 0, math.sin(angle)])
    turn = np.stack([along, (0, 1, 0), np.cross(along, (0, 1, 0))], axis=1)
    a, b = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    turn = turn @ np.array([[1, 0, 0], [0, a, -b], [0, b, a]])
    half, middle = np.array([7, 1, thick / 2]), start + 5 * along
    reach = np.abs(turn) @ half

    def distance(x):
        return DX * (np.abs((x / DX - middle) @ turn) - half).max(axis=-1)

    solid = fill_solid(distance, (middle - reach) * DX, (middle + reach) * DX, DX / 2)
    assert curvature(solid, start, turn) == pytest.approx(12 / 2 / thick**3, rel=0.04)


def test_thin_slanted_sheet_stays_whole():
    """Its voxels touch each other only along edges and at corners."""
    x, _, z = np.indices((40, 12, 40))
    sheet = Solid(np.zeros(3, int), DX / 4, (x == z).astype(np.float32))
    assert points(sheet).copies is None


@pytest.mark.parametrize("root", [0, 2], ids=["unconnected", "connected"])
def test_prongs_have_separate_nodes(root):
    prongs = points(fork(root=root))
    assert prongs.copies.max() == 1
    assert (prongs.piece is None) == (root > 0)


def test_cell_with_two_pieces_has_points_for_each():
    solid = fork(thick=0.3, gap=0.3)
    x, volume = points(solid).x.reshape(-1, 8, 3), points(solid).volume
    prongs = x[:, :, 0].min(axis=1) > 2.2 * DX
    assert volume.sum() == pytest.approx(solid.volume)
    middle = 0.45 * DX
    assert ((x[prongs, :, 2] < middle).all(axis=1) | (x[prongs, :, 2] > middle).all(axis=1)).all()


def test_copies_follow_their_cells():
    every = points(fork())
    cells = cells_of(every)
    order = np.arange(len(cells.x))[::-1]
    backwards = replace(cells, cell=order)
    assert np.array_equal(points_of(backwards, every).copies, every.copies[::-1])


@pytest.mark.parametrize("place", [*PLACES[:2], pytest.param(PLACES[2], marks=pytest.mark.slow)])
@pytest.mark.parametrize(("thick", "gap"), [(1.0, 0.4), (0.3, 0.3)])
def test_joined_plates_bend_like_single_ones(place, thick, gap):
    """They are joined at one end only; with common nodes they would bend like a thick one."""

    def bend(solid, whole=False):
        statics = Statics(solid, lambda x: x[:, 0] - place[0] < 2, whole=whole)
        tip = statics.x[:, 0] - place[0] > 12
        push = statics.push(tip, (0, 0, 1.0))
        return statics.solve(push)[tip, 2].mean()

    shape = {"thick": thick, "gap": gap, "root": 3, "low": place}
    both, single = bend(fork(**shape)), bend(fork(**shape, prongs=1))
    assert bend(fork(**shape), whole=True) < 0.3 * single / 2
    assert 0.75 < both / (single / 2) < 1.05


@pytest.mark.parametrize("place", PLACES[:2])
def test_pushed_tooth_of_a_comb_leaves_the_others_at_rest(place):
    comb = fork(prongs=3, thick=0.8, gap=0.4, low=place)
    statics = Statics(comb, lambda x: x[:, 0] - place[0] < 1)
    x = statics.x - np.array(place)
    tooth = np.floor(x[:, 2] / 1.2)
    tip = x[:, 0] > 11
    u = statics.solve(statics.push(tip & (tooth == 1), (0, 0, 1.0)))[:, 2]
    moved = [abs(u[tip & (tooth == k)].mean()) for k in range(3)]
    assert moved[1] > 20 * max(moved[0], moved[2])


@pytest.mark.parametrize(
    "place",
    [
        pytest.param(place, marks=[pytest.mark.slow] * (index != 1))
        for index, place in enumerate(PLACES)
    ],
)
def test_ring_with_a_narrow_gap_opens_like_a_slender_ring(place):
    """A force P at the gap widens a thin ring by (2 + pi / 2) P R^3 / E I, a quarter of the way
    round. The motion of points at the gap depends on the distribution of the force.
    """
    radius, thick, wide, gap = 6.0, 1.0, 2.0, 0.5
    middle = np.array([7.5, 7.5, wide / 2]) + place

    def distance(x):
        x = x / DX - middle
        away = np.abs(np.hypot(x[..., 0], x[..., 1]) - radius) - thick / 2
        sides = np.abs(x[..., 2]) - wide / 2
        slot = gap / 2 - np.where(x[..., 0] > 0, np.abs(x[..., 1]), math.inf)
        return DX * np.maximum(np.maximum(away, sides), slot)

    reach = radius + thick / 2
    low, high = middle - (reach, reach, wide / 2), middle + (reach, reach, wide / 2)
    ring = fill_solid(distance, low * DX, high * DX, DX / 4)
    statics = Statics(ring, lambda x: np.zeros(len(x), bool))
    x = statics.x - middle
    ends = [(x[:, 0] > 0) & (x[:, 1] * side > 0) & (abs(x[:, 1]) < 1.0) for side in (1, -1)]
    push = statics.push(ends[0], (0, 1.0, 0)) - statics.push(ends[1], (0, 1.0, 0))
    u = statics.solve(push)[:, 1]

    def moved(side):
        near = (abs(x[:, 0]) < 1) & (x[:, 1] * side > 0)
        offset = x[near] - (0, side * radius, 0)
        terms = np.column_stack([np.ones(len(offset)), offset])
        return np.linalg.lstsq(terms, u[near], rcond=None)[0][0]

    stiffness = E * wide * DX * (thick * DX) ** 3 / 12
    exact = (2 + math.pi / 2) * (radius * DX) ** 3 / stiffness
    assert moved(1) - moved(-1) == pytest.approx(exact, rel=0.01)
