"""Numerical fracture is noticed: a bar pulled until its particles lose each other."""

import numpy as np
import pytest

from phy124.materials import NeoHookean, Sand
from phy124.monitor.tearing import APART, Tearing
from phy124.mpm import Solver
from phy124.studies.validation.bodies import lattice, make_solver

CELLS = 16


def searched(solver: Solver) -> Tearing:
    """The search for tears of a solver."""
    tearing = Tearing()
    tearing.bind(solver)
    return tearing


def pulled(
    particles_per_axis: int, speed: float, law=NeoHookean, *, frames: int = 20, cells: int = CELLS
) -> tuple[Solver, Tearing]:
    """A bar of 1 m whose ends fly apart at `speed` m/s each; looked at in every frame."""
    h = 1 / cells / particles_per_axis
    x = lattice([round(side / h) for side in (0.25, 0.25, 1.0)], h)
    rate = np.zeros((len(x), 3, 3))
    rate[:, 2, 2] = 2 * speed
    v = np.einsum("pij,pj->pi", rate, x - 0.5)
    volume = np.full(len(x), h**3)
    s = make_solver(x, volume, [law(E=1e4)], dx=1 / cells, v=v, C=rate, threads=1)
    tearing = searched(s)
    for frame in range(frames):
        s.advance((frame + 1) * 0.02)
        tearing.after_attempt()
    return s, tearing


def widest_gap(s: Solver) -> float:
    """The longest stretch of the bar without any particle, in cells."""
    return float(np.diff(np.sort(s.state.x.numpy()[:, 2])).max() / s.model.dx)


def test_a_bar_that_holds_is_not_reported():
    s, tearing = pulled(2, 2.0)
    assert widest_gap(s) < 1
    assert tearing.count == 0
    assert not tearing.notes()


def test_a_bar_that_parts_is_reported_with_the_remedy():
    s, tearing = pulled(2, 7.0, frames=40)
    assert widest_gap(s) > 3
    assert tearing.likely
    assert tearing.stretch > APART * 2
    assert tearing.torn
    (note,) = tearing.notes()
    assert "accuracy.particles_per_axis" in note
    assert f"{tearing.loose} particles" in note
    assert 0.1 < tearing.loose / len(s.model.rest) < 0.9
    assert tearing.briefly == "the grid tears the material"


def test_a_bar_about_to_part_is_reported_with_the_place():
    _, tearing = pulled(2, 7.0, frames=5)
    assert tearing.likely and not tearing.torn
    (note,) = tearing.notes()
    assert "of law neo_hookean, at (" in note
    assert f"up to {tearing.stretch:.1f} times" in note


def test_lone_particles_at_rest_are_not_called_stretched():
    """Each stands for more than a cell, as the particle of a floater does."""
    h, dx = 0.025, 0.05
    x = np.concatenate([lattice((4,) * 3, h), [[1.0, 1, 1], [1.5, 1, 1], [1, 1.5, 1]]])
    volume = np.concatenate([np.full(64, h**3), np.full(3, (1.3 * dx) ** 3)])
    s = make_solver(x, volume, [NeoHookean(E=1e4)], dx=dx, threads=1)
    tearing = searched(s)
    tearing.after_attempt()
    assert tearing.count == 0


def test_a_thin_stem_that_parts_is_reported():
    """Two blocks and a rod of one cell between them, looked at when the rod has sprung back."""
    s = dumb_bell(speed=4.0)
    tearing = searched(s)
    assert tearing.loose == 0
    s.advance(0.6)
    tearing.after_attempt()
    assert widest_gap(s) > 3
    assert tearing.loose == pytest.approx(len(s.model.rest) / 2, rel=0.1)
    assert tearing.likely


def dumb_bell(speed: float) -> Solver:
    """Blocks of 10 cells, a rod of one cell and 6 long; they fly apart at `speed` m/s each."""
    dx, h = 0.05, 0.025
    block = lattice((20,) * 3, h)
    rod = lattice((2, 2, 12), h, (0.225, 0.225, 0.5))
    x = np.concatenate([block, rod, block + [0, 0, 0.8]])
    v = np.zeros_like(x)
    v[:, 2] = speed * np.clip((x[:, 2] - 0.65) / 0.15, -1, 1)
    return make_solver(x, np.full(len(x), h**3), [NeoHookean(E=1e4)], dx=dx, v=v, threads=1)


def test_more_particles_per_cell_are_the_remedy():
    """The remedy in the note helps: the same pull with closer particles does not tear."""
    s, tearing = pulled(4, 6.0, frames=40)
    assert widest_gap(s) < 1.2
    assert not tearing.likely


@pytest.mark.parametrize("cells", [12, 24])
def test_a_finer_grid_is_not(cells):
    """The spacing in cells decides, and is the same on every grid for the same stretch."""
    assert not pulled(2, 3.0, cells=cells)[1].likely
    assert pulled(2, 7.0, cells=cells)[1].likely


def test_fluids_may_separate():
    _, tearing = pulled(2, 7.0, Sand)
    assert tearing.count == 0


@pytest.mark.parametrize("stretch", [1.0, 2.3, 2.5])
def test_the_spacing_is_that_along_the_largest_stretch(stretch):
    s, _ = pulled(2, 0.0, frames=0)
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    F = turned @ np.diag([1 / np.sqrt(stretch)] * 2 + [stretch])
    s.state.F.assign(np.tile(F.astype(np.float32), (len(s.model.rest), 1, 1)))
    tearing = searched(s)
    tearing.after_attempt()
    assert tearing.count == (len(s.model.rest) if stretch / 2 > APART else 0)
    if tearing.count:
        assert tearing.stretch == pytest.approx(stretch, rel=1e-4)
