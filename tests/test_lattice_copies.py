"""Bodies whose nodes have copies, in motion (phy124/lattice/copies.py)."""

import numpy as np
import pytest

from phy124.boundaries import Held
from phy124.forces import Grab, TotalForce, WrenchForce
from phy124.lattice.rest import RestLattice
from phy124.materials import NeoHookean
from phy124.monitor.lattice import LatticeTotals
from phy124.particles.solid import Solid
from phy124.schema.region import Region
from support.lattices import DX, block, fork, make

DAMPED = NeoHookean(E=1e5, nu=0.3, density=1000, damping=300.0)


def pressed_fork(force=4.0, **options):
    """Return the solver of a fork whose prongs, 0.4 cells apart, are pressed together."""

    def push(low, force):
        region = Region(lower=(0.7, -1, low), upper=(2, 1, low + 0.1))
        return TotalForce(f=(0, 0, force), region=region)

    forces = [push(0.0, force), push(0.14, -force)]
    return make(fork(root=3, long=6, per=5), DAMPED, forces=forces, **options)


def positions(solver):
    """Return the positions of the surface points."""
    surface = solver.surface
    u = solver.nodes_state.u.numpy()[surface.nodes]
    return surface.x + np.einsum("pk,pki->pi", surface.weights, u)


def test_copies_keep_mass_centre_and_linear_motions():
    lattice = make(fork()).lattice
    x, points = lattice.x, lattice.points_of(np.arange(len(lattice.rows))).reshape(-1, 3) * DX
    repeated = lattice.source != np.arange(len(lattice))
    assert repeated.any() and not lattice.mass[repeated].any()
    assert np.allclose(lattice.ties @ x, x[lattice.tied])
    volume = np.asarray(make(fork()).model.volume.numpy(), float)
    assert np.isclose(lattice.mass.sum(), 1000 * volume.sum())
    assert np.allclose(lattice.mass @ x / lattice.mass.sum(), volume @ points / volume.sum())
    assert np.allclose(lattice.respond(1000 * volume), 1)


def test_nodes_served_only_by_repetitions_move_with_the_body():
    solver = make(fork(), v=(1, 2, 3))
    lattice = solver.lattice
    assert len(np.unique(lattice.nodes_of())) < len(lattice)
    assert np.allclose(solver.nodes_state.v.numpy(), (1, 2, 3))


def test_points_of_scattered_voxels_have_finite_weights():
    """Some of these points keep a single node, or nodes in one plane."""
    filled = np.random.default_rng(3).random((40, 40, 16))[10:30, :20] < 0.15
    surface = make(Solid(np.zeros(3, int), DX / 5, filled.astype(np.float32))).surface
    assert np.allclose(surface.weights.sum(axis=1), 1) and np.abs(surface.weights).max() < 1.5


def test_nodes_of_which_cells_use_one_copy_have_no_copies():
    whole = make(block((0.4, 0.3, 0.3)))
    x, mass, volume = whole.model.rest, whole.model.mass.numpy(), whole.model.volume.numpy()
    copies = np.ones((len(whole.lattice.rows), 27), np.int64)
    lattice = RestLattice.of(x, mass, volume, DX, copies=copies)
    assert np.array_equal(lattice.rows, whole.lattice.rows)
    assert np.array_equal(lattice.source, np.arange(len(whole.lattice)))


def test_whole_bodies_repeat_no_node():
    lattice = make(block((0.4, 0.3, 0.3))).lattice
    assert np.array_equal(lattice.source, np.arange(len(lattice)))
    assert not lattice.copied.any() and not lattice.sides.any()


def test_prongs_that_share_cells_meet_and_do_not_pass():
    solver = pressed_fork()
    surface = solver.surface
    along, height = surface.x[:, 0], surface.x[:, 2]
    lower, upper = (
        (along > 0.7) & (abs(height - z) < 0.02) & (surface.normal[:, 2] * side > 0.5)
        for z, side in ((0.1, 1), (0.14, -1))
    )
    gaps = []
    for k in range(8):
        solver.advance(0.05 * (k + 1))
        x = positions(solver)
        gaps.append(x[upper, 2].mean() - x[lower, 2].mean())
    assert lower.any() and upper.any()
    assert min(gaps) < 0.15 * DX and min(gaps) > -0.2 * DX
    assert np.allclose(LatticeTotals(solver).read(solver.clock).momentum, 0, rtol=0, atol=1e-9)
    solver = pressed_fork(-4.0)
    solver.advance(0.2)
    x = positions(solver)
    assert x[upper, 2].mean() - x[lower, 2].mean() > 0.6 * DX


@pytest.mark.parametrize("threads", [1, 2])
def test_run_with_copies_resumes_bit_for_bit(threads):
    first, second = (pressed_fork(precision="float32", threads=threads) for _ in range(2))
    first.advance(0.05)
    saved = first.snapshot()
    first.advance(0.1)
    second.restore(saved)
    second.advance(0.1)
    assert np.array_equal(first.nodes_state.u.numpy(), second.nodes_state.u.numpy())
    assert np.array_equal(first.state.F.numpy(), second.state.F.numpy())


def test_vector_units_agree_with_plain_kernels_on_copies():
    plain, vectors = (
        pressed_fork(precision="float32", vectors=vectors) for vectors in (False, True)
    )
    for solver in (plain, vectors):
        solver.advance(0.05)
    apart = plain.state.x.numpy() - vectors.state.x.numpy()
    assert np.abs(apart).max() < 1e-4 * DX


def test_step_from_a_copy_stays_in_its_piece():
    lattice = make(fork()).lattice
    nodes = np.flatnonzero(lattice.copied)
    ahead = lattice.step_from(nodes, np.tile([-1, 0, 0], (len(nodes), 1)))
    cells = lattice.source[lattice.nodes_of()]
    for a, b in zip(lattice.source[nodes], ahead, strict=True):
        assert b < 0 or ((cells == a).any(axis=1) & (cells == b).any(axis=1)).any()
    assert (ahead >= 0).mean() > 0.9


def test_clamp_holds_each_prong_by_its_own_nodes():
    """The held end of one prong stays, although the other prong moves right beside it."""
    clamp = Held(lower=(0.7, -1, -1), upper=(2, 1, 0.11))
    push = TotalForce(f=(0, 0, 2.0), region=Region(lower=(0.7, -1, 0.13), upper=(2, 1, 1)))
    solver = make(fork(root=3, long=6, per=5), DAMPED, boundaries=[clamp], forces=[push])
    solver.advance(0.1)
    moved = solver.state.x.numpy() - solver.model.rest
    x = solver.model.rest
    low, high = ((x[:, 0] > 0.75) & (x[:, 2] * side > 0.12 * side) for side in (-1, 1))
    assert np.abs(moved[low]).max() < 0.05 * np.abs(moved[high, 2]).mean()


@pytest.mark.parametrize("kind", ["grab", "wrench"])
def test_hand_on_one_prong_leaves_the_other_at_rest(kind):
    """The hand holds all of the upper prong's tip, and its radius ends before the lower prong."""
    clamp, tip = Held(lower=(-1, -1, -1), upper=(0.25, 1, 1)), (0.85, 0.1, 0.22)
    path = {"times": (0, 0.1), "targets": (tip, (0.85, 0.1, 0.42))}
    hands = {
        "grab": Grab(point=tip, radius=0.06, stiffness=500.0, damping=5.0, **path),
        "wrench": WrenchForce(point=tip, radius=0.06, force=(0, 0, 50.0)),
    }
    solver = make(fork(root=3, long=6, per=5), DAMPED, boundaries=[clamp], forces=[hands[kind]])
    solver.advance(0.05)
    x = solver.model.rest
    moved = np.abs(solver.state.x.numpy() - x).max(axis=1)
    lower, upper = ((x[:, 0] > 0.6) & ((x[:, 2] > 0.12) == high) for high in (False, True))
    assert moved[upper].max() > 0.1 * DX
    assert moved[lower].max() < 0.05 * moved[upper].max()
