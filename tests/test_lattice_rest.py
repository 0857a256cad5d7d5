"""The lattice at rest: masses of its nodes, and ties of light nodes to heavy ones."""

import numpy as np

from phy124.lattice.rest import RestLattice
from phy124.particles.solid import Solid
from support.lattices import DX, block, integration_points


def test_ties_extrapolate_linear_motions():
    solid = block((0.35, 0.325, 0.325), low=(0.075, 0.075, 0.0875), per=8)
    x, volume = integration_points(solid, DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    assert len(lattice.tied) > 10
    assert np.allclose(lattice.ties @ lattice.x, lattice.x[lattice.tied])
    assert np.isclose(lattice.mass.sum(), volume.sum())
    assert np.allclose(lattice.mass @ lattice.x, volume @ x)


def test_light_nodes_get_mass_from_heavy_ones():
    solid = block((0.35, 0.325, 0.325), low=(0.075, 0.075, 0.0875), per=8)
    x, volume = integration_points(solid, DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    assert lattice.mass[lattice.mass > 0].min() > 0.0199 * DX**3


def test_light_material_is_not_tied_to_heavy_material():
    """Tied surface points would have no weight on nodes with mass, and so no contact."""
    solid = block((0.35, 0.325, 0.65), low=(0.075, 0.075, 0.0875), per=8)
    x, volume = integration_points(solid, DX)
    even = RestLattice.of(x, volume, volume, DX)
    uneven = RestLattice.of(x, volume * np.where(x[:, 2] < 0.4, 1e-4, 1), volume, DX)
    assert 10 < len(uneven.tied) < 1.2 * len(even.tied)
    assert np.isclose(uneven.mass.sum(), (volume * np.where(x[:, 2] < 0.4, 1e-4, 1)).sum())


def test_masses_of_huge_bodies_do_not_overflow():
    solid = block((0.35, 0.325, 0.325), low=(0.075, 0.075, 0.0875), per=8)
    x, volume = integration_points(solid, DX)
    small = RestLattice.of(x, volume, volume, DX)
    with np.errstate(over="raise", divide="raise", invalid="raise"):
        huge = RestLattice.of(x, volume * 1e12, volume, DX)
    assert np.allclose(huge.mass, small.mass * 1e12)


def test_ties_leave_no_node_without_mass():
    rng = np.random.default_rng(47)
    fraction = (rng.random((7, 7, 7)) < 0.35).astype(np.float32)
    fraction *= rng.random((7, 7, 7)).astype(np.float32)
    x, volume = integration_points(Solid(np.zeros(3, int), DX / 2, fraction), DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    free = np.setdiff1d(np.arange(len(lattice)), lattice.tied)
    assert lattice.mass[free].min() > 0


def test_sliver_at_a_corner_joins_the_cell_behind_it():
    """By itself it would hang on one node, and its own nodes would have no mass and no ties."""
    fraction = np.zeros((6, 6, 6), np.float32)
    fraction[:4, :4, :4] = 1
    fraction[3, 3, 3], fraction[4, 4, 4] = 0.3, 0.003
    x, volume = integration_points(Solid(np.zeros(3, int), DX, fraction), DX)
    assert volume.reshape(-1, 8).sum(axis=1).min() > 0.3 * DX**3
    assert len(x) == 8 * 4**3
    lattice = RestLattice.of(x, volume, volume, DX)
    assert lattice.mass[lattice.mass > 0].min() > 1e-3 * DX**3


def test_needles_have_nodes_of_finite_mass():
    """None of their cells is filled as much as the smallest fraction of a thick body's cells."""
    fraction = np.zeros((8, 8, 8), np.float32)
    fraction[1:7, 3, 3], fraction[7, 3, 3] = 1e-4, 1e-38
    x, volume = integration_points(Solid(np.zeros(3, int), DX / 2, fraction), DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    assert np.isclose(volume.sum(), 6e-4 * (DX / 2) ** 3)
    assert lattice.mass[lattice.mass > 0].min() > 1e-3 * lattice.mass.max()


def test_light_nodes_are_tied_to_their_own_sheet():
    """Two sheets with a gap of two cells would otherwise be glued to each other."""
    fraction = np.zeros((14, 14, 12), np.float32)
    fraction[1:13, 1:13, 2:4] = fraction[1:13, 1:13, 8:10] = 1
    x, volume = integration_points(Solid(np.zeros(3, int), DX / 2, fraction), DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    low = lattice.index[:, 2] < 3
    tied, donor = lattice.ties.nonzero()
    assert len(tied) > 10
    assert np.array_equal(low[lattice.tied[tied]], low[donor])


def test_sliver_behind_a_gap_has_no_nodes_of_almost_no_mass():
    """Only one heavy node shares a cell with its outer nodes, which does not determine a motion.

    Without ties, they have down to 5e-13 of the mass of a node inside the block.
    """
    x, volume = integration_points(block((4 * DX, 4 * DX, 4 * DX)), DX)
    corners = np.stack(np.meshgrid(*[[-1, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    x = np.concatenate([x, (5.03 + 0.02 * corners) * DX])
    volume = np.concatenate([volume, np.full(8, 0.002 / 8 * DX**3)])
    lattice = RestLattice.of(x, volume, volume, DX)
    assert lattice.mass[lattice.mass > 0].min() > 1e-3 * DX**3
    assert np.allclose(lattice.ties @ lattice.x, lattice.x[lattice.tied])
    assert np.isclose(lattice.mass.sum(), volume.sum())
    assert np.allclose(lattice.mass @ lattice.x, volume @ x)
