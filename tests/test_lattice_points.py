"""Integration points of a solid on its lattice, and the points of its surface."""

import math

import numpy as np
import pytest
import scipy
from scipy.spatial import KDTree

from phy124.generators.shapes import make_shape
from phy124.kernels.lattice.partners import OTHER
from phy124.lattice.rest import splines
from phy124.lattice.surface import EVEN, FLAT, IN_EDGE, Lazy, _inverses
from phy124.lattice.tips import _three_in_a_row, points_in_tips, rows_of
from phy124.particles.lattice import PER_CELL, surface_points
from phy124.particles.solid import Solid, find_interior
from phy124.scene import Scene
from phy124.simulation import prepare
from phy124.studies.validation.bodies import fill_solid
from support.lattices import DX, block, integration_points, lattice_scene, make, rod
from support.solids import box_of_discs


def test_full_cells_have_gauss_points():
    x, volume = integration_points(block((0.2, 0.1, 0.1)), DX)
    offset = np.abs(x[:8] - 0.05)
    assert np.allclose(offset, DX / (2 * math.sqrt(3)))
    assert np.allclose(volume, DX**3 / 8)


def test_points_of_full_cells_have_one_order():
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    x, volume = integration_points(solid, DX)
    full = np.isclose(volume.reshape(-1, 8).sum(axis=1), DX**3)
    cells = x.reshape(-1, 8, 3)[full]
    assert np.allclose(cells - cells[:, :1], (cells - cells[:, :1])[0])


def test_cut_cells_keep_volume_centre_and_moments():
    solid = block((0.25, 0.35, 0.075), low=(0.075, 0.05, 0.025), per=4)
    x, volume = integration_points(solid, DX)
    low, size = np.array([0.075, 0.05, 0.025]), np.array([0.25, 0.35, 0.075])
    assert np.isclose(volume.sum(), size.prod())
    centre = volume @ x / volume.sum()
    assert np.allclose(centre, low + size / 2)
    second = np.einsum("p,pi,pj->ij", volume, x - centre, x - centre) / volume.sum()
    assert np.allclose(second, np.diag(size**2 / 12), rtol=0, atol=1e-12)


def test_grids_of_which_one_is_twice_as_fine_share_their_voxels():
    rough = Solid(np.zeros(3, int), 0.051, np.linspace(0, 1, 64).reshape(4, 4, 4))
    assert rough.resample(0.1).voxels is rough.resample(0.05).voxels
    fresh = Solid(rough.first, rough.voxel, rough.fraction).resample(0.1)
    assert np.array_equal(fresh.voxels.spread, rough.resample(0.05).voxels.spread)


@pytest.mark.parametrize("thick", [0.3, pytest.param(0.5, marks=pytest.mark.slow), 1.0])
@pytest.mark.parametrize("degrees", [0, 20, pytest.param(45, marks=pytest.mark.slow)])
def test_plates_keep_their_moments(thick, degrees):
    """Plates on voxels of half a cell, as the pipeline makes them."""
    half = np.array([0.6, 0.2, thick * DX / 2])
    angle, middle = math.radians(degrees), np.array([0.013, 0.02, 0.031])
    turn = np.array([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, 0]])
    turn[2, 2] = math.cos(angle)

    def distance(x):
        return (np.abs((x - middle) @ turn) - half).max(axis=-1)

    reach = np.abs(turn) @ half
    solid = fill_solid(distance, middle - reach, middle + reach, DX / 2)
    x, volume = integration_points(solid, DX)
    place = (x - middle) @ turn
    inner = np.abs(place[:, 0]) < 0.4
    height, share = place[inner, 2], volume[inner] / volume[inner].sum()
    second = share @ (height - share @ height) ** 2  # a plate within one voxel may lie anywhere
    assert second == pytest.approx((thick * DX) ** 2 / 12, rel=0.06 if thick < 0.5 else 0.04)


@pytest.mark.parametrize("along", [(1, 0, 0), (1, 0.5, 0.3), (1, 1, 1)])
@pytest.mark.parametrize("thick", [0.4, 0.6, 1.0])
def test_thin_rods_keep_their_moments(thick, along):
    """They are one or two voxels of half a cell thick, as stems are in the pipeline."""
    start, along = np.array([0.37, 0.11, 0.62]), np.array(along) / np.linalg.norm(along)
    x, volume = integration_points(rod(thick, along, start), DX)
    arm = x / DX - start
    inner = (arm @ along > 1) & (arm @ along < 11)
    arm, share = arm[inner], volume[inner] / volume[inner].sum()
    across = arm - np.outer(arm @ along, along)
    across -= share @ across
    second = np.linalg.eigvalsh(np.einsum("p,pi,pj->ij", share, across, across))
    assert second[1:] == pytest.approx(np.full(2, thick**2 / 16), rel=0.25 if thick < 0.5 else 0.1)


def test_surface_points_lie_on_a_box():
    rows = surface_points(block((0.4, 0.3, 0.3)), DX)
    out = np.maximum(-rows[:, :3], rows[:, :3] - (0.4, 0.3, 0.3))
    assert np.allclose(out.max(axis=1), 0)
    assert {tuple(x) for x in np.round(rows[:, :3], 9)} >= {(0.4, 0.3, 0.3)}


def test_face_towards_a_static_part_has_surface_points():
    low = {"static": True, "region": {"upper": (9.0, 9.0, 0.5)}}
    scene = Scene.from_data({**lattice_scene().data(), "object": {"size": 1.0}, "parts": [low]})
    cube = make_shape("box", (1.0, 1.0, 1.0), (0.5, 0.5, 0.5))
    rows = prepare(cube, scene).particles.surface
    below = rows[:, 5] < -0.9
    assert below.sum() > 200  # There are 64 cells.
    assert rows[below, 2] == pytest.approx(0.5, abs=0.01)
    assert rows[:, 2].min() > 0.49


@pytest.mark.parametrize("side", [1.27, 1.52])
def test_voxels_larger_than_cells_keep_the_substep(side):
    """If voxels lay across cells, some nodes would have stiffness but hardly any mass."""
    steps = (np.arange(-5, 5) + 0.5) * side * DX
    distance = np.linalg.norm(np.stack(np.meshgrid(steps, steps, steps)), axis=0)
    filled = np.clip((0.42 - distance) / (side * DX) + 0.5, 0, 1).astype(np.float32)
    ball = Solid(np.full(3, -5), side * DX, filled).resample(DX / 2, per_cell=2)
    usual = make(block((0.8, 0.8, 0.8))).limits.substep_at_rest
    assert make(ball).limits.substep_at_rest > 0.9 * usual


@pytest.mark.parametrize("per", [1.3, 1.7, 2.3, 3.1])
def test_surface_points_cover_a_ball_of_resampled_voxels(per):
    radius, fine = 0.42, DX / per
    steps = (np.arange(-20, 20) + 0.5) * fine
    distance = np.linalg.norm(np.stack(np.meshgrid(steps, steps, steps)), axis=0)
    filled = np.clip((radius - distance) / fine + 0.5, 0, 1).astype(np.float32)
    ball = Solid(np.full(3, -20), fine, filled).resample(DX / 2)
    rows = surface_points(ball, DX)
    away = np.linalg.norm(rows[:, :3], axis=1) - radius
    assert np.abs(away).max() < 0.2 * DX
    rng = np.random.default_rng(1)
    around = rng.normal(size=(2000, 3))
    around *= radius / np.linalg.norm(around, axis=1, keepdims=True)
    gap, _ = KDTree(rows[:, :3]).query(around)
    assert gap.max() < 0.6 * DX


@pytest.mark.parametrize("thick", [0.02, 0.022, 0.04])
@pytest.mark.parametrize(
    "lift",
    [
        pytest.param(lift, marks=[pytest.mark.slow] * (lift not in (0.012, 0.044)))
        for lift in (0, 0.012, 0.03, 0.044, 0.055)
    ],
)
def test_both_faces_of_a_plate_have_surface_points(thick, lift):
    middle = np.array([0, 0, lift + thick / 2])
    plate = box_of_discs(np.array([1, 0.7, thick]), np.eye(3), middle, 0.012)
    rows = surface_points(find_interior(plate).resample(1 / 32, per_cell=2), 1 / 16)
    inner = rows[(np.abs(rows[:, :2]) < (0.4, 0.25)).all(axis=1)]
    for sign in (1, -1):
        face = inner[inner[:, 5] * sign > 0.9]
        assert len(face) > 0.9 * (0.8 * 0.5) * 32**2
        assert np.allclose(face[:, 2], middle[2] + sign * thick / 2, atol=0.002)


def test_needle_has_surface_points():
    """A needle fills 1 % of each of its cells."""
    solid = block((1.0, 0.01, 0.01), dx=0.02)
    assert len(surface_points(solid, DX)) > 10
    tip = block((1.0, 0.02, 0.01), dx=0.02)  # fills 2 % of each cell; haze fills less than 0.5 %
    assert len(surface_points(tip, DX)) >= len(surface_points(solid, DX))


@pytest.mark.slow
@pytest.mark.parametrize("size", [(0.4, 0.4, 0.4), (0.4, 0.03, 0.03)])
def test_sharp_parts_touch_with_their_inner_points(size):
    solver = make(block(size, low=(0.05, 0.05, 0.05), per=20))
    inner = solver.surface.x[solver.surface.is_inner]
    assert KDTree(solver.model.rest).query(inner)[0].max() < 1e-6
    to_face = np.minimum(inner - 0.05, 0.05 + np.array(size) - inner)
    assert (np.sort(to_face, axis=1)[:, 1] < DX).all()


def test_surface_points_in_tips_follow_tied_nodes(rng):
    solver = make(block((0.4, 0.05, 0.05), low=(0.08, 0.01, 0.02), per=20))
    lattice, surface = solver.lattice, solver.surface
    u = rng.normal(size=(len(lattice), 3))
    u[lattice.tied] = lattice.ties @ u
    bare = ~surface.normal.any(axis=1)
    moved = np.einsum("pn,pna->pa", surface.weights[bare], u[surface.nodes[bare]])
    inner = KDTree(solver.model.rest).query(surface.x[bare])[1]
    a, b, c = np.moveaxis(splines(lattice.offset[inner]), 1, 0)
    weights = np.einsum("pi,pj,pk->pijk", a, b, c).reshape(-1, 27)
    expected = np.einsum("pn,pna->pa", weights, u[lattice.nodes_of(np.asarray(inner) // PER_CELL)])
    assert len(lattice.tied) and np.allclose(moved, expected, rtol=0, atol=1e-9)
    assert not surface.weights[bare][lattice.mass[surface.nodes[bare]] == 0].any()


def test_material_outside_of_the_surface_touches():
    solver = make(block((0.4, 0.4, 0.4), low=(0.09, 0.09, 0.09), per=20))
    lattice, surface = solver.lattice, solver.surface
    top = surface.normal[:, 2] > 0.9
    x, normal, body = surface.x[top], surface.normal[top], np.zeros((top.sum(), 1))
    rows, deeper = (np.hstack([x - depth * DX * normal, normal, body]) for depth in (0.3, 0.5))
    assert not len(points_in_tips(rows, lattice)[0])
    outside = rows_of(points_in_tips(deeper, lattice)[0], lattice)[:, :3]
    assert len(outside) and (outside[:, 2] > 0.29 + 0.17).all()


def test_groups_of_three_nodes_keep_all_weights():
    """A pair of nodes needs one group, wherever it begins and also at the end."""
    motion = scipy.sparse.csr_matrix([[0.0] * 4 + [0.5, 0.0, 0.25] + [0.0, 0.25, 0.0] * 4])
    nodes, weights = _three_in_a_row(motion)
    assert nodes.shape == weights.shape == (1, 27)
    expected = motion.toarray()[0]
    assert np.array_equal(np.bincount(nodes[0], weights[0], len(expected)), expected)


def test_slopes_give_the_gradient_at_every_surface_point(rng):
    solver = make(block((0.4, 0.3, 0.2)))
    surface, gradient = solver.surface, rng.normal(size=(3, 3))
    u = solver.lattice.x @ gradient
    slopes = np.swapaxes(u[surface.nodes], 1, 2) @ surface.slopes[np.arange(surface.count)]
    assert surface.count and np.allclose(slopes, gradient.T)


def test_flat_points_are_found_alone_as_well_as_together():
    surface = make(block((0.4, 0.3, 0.2))).surface
    every = np.arange(surface.count)
    near = np.linalg.norm(surface.x[:, None] - surface.x, axis=2) <= surface.dx
    near &= (surface.normal @ surface.normal.T > OTHER) & (surface.kind != IN_EDGE)
    length = np.linalg.norm(near @ surface.normal, axis=1)
    expected = length > FLAT * near.sum(axis=1)
    assert expected.any() and not expected.all()
    some = surface.evenness[every[:5]]
    assert np.array_equal(some, surface.evenness[every][:5])
    assert np.array_equal(surface.evenness[every] == EVEN, expected)


def test_lazy_values_are_computed_once(rng):
    asked = []

    def compute(points):
        asked.extend(points)
        return 10 * points

    lazy = Lazy(np.zeros(9, int), compute)
    for points in ([4, 2], [2, 7, 4], [], [0]):
        chosen = np.array(points, int)
        assert np.array_equal(lazy[chosen], 10 * chosen)
    assert asked == [4, 2, 7, 0]


def test_inverses_of_moments_leave_out_axes_without_an_extent(rng):
    arms = (
        rng.normal(size=(4, 27, 3))
        * np.array([[1, 1, 1], [1, 1, 0], [1, 0, 0], [1, 1, 1e-4]])[:, None]
    )
    moments = np.swapaxes(arms, 1, 2) @ arms
    expected = np.linalg.pinv(moments, rcond=1e-6, hermitian=True)
    assert np.allclose(_inverses(moments), expected, rtol=1e-9)
