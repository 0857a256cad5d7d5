"""The viscous step of projected liquids: free surfaces, slopes, walls, and its cost."""

import numpy as np
import pytest

from phy124.boundaries import HalfSpace, Path
from phy124.liquid.viscosity import Viscosity
from phy124.studies.validation.experiments.sinking import VISCOSITY, exact_loss, sink
from support.liquids import DENSITY, G, block, liquid, run

FLOOR = HalfSpace(point=(0, 0, 0), normal=(0, 0, 1), contact="slip")


@pytest.fixture
def iterations(monkeypatch):
    counts, solve = [], Viscosity.solve

    def count(*arguments):
        counts.append(solve(*arguments))
        return counts[-1]

    monkeypatch.setattr(Viscosity, "solve", count)
    return counts


def test_column_sinks_as_trouton_says_and_the_floor_bears_it():
    loss, force = sink(6, VISCOSITY)
    assert loss == pytest.approx(exact_loss(), rel=0.05)
    assert force == pytest.approx(1, rel=0.05)


def test_viscosity_does_not_slow_a_free_rotation():
    x = block((-0.25, -0.25, 0), (0.25, 0.25, 0.25), 16)
    spins = []
    for viscosity in (0.0, 1e4):
        solver = liquid(x, 16, [], gravity=(0, 0, 0), viscosity=viscosity)
        v = np.stack([-x[:, 1], x[:, 0], 0 * x[:, 0]], axis=1)
        solver.state.v.assign(v.astype(np.float32))
        run(solver, 12)
        spins.append(np.cross(solver.state.x.numpy(), solver.state.v.numpy())[:, 2].sum())
    assert spins[1] > 0.8 * spins[0]


def test_viscous_block_slides_down_a_smooth_slope():
    angle = np.radians(20)
    normal = (-np.sin(angle), 0.0, np.cos(angle))
    along = np.array([-np.cos(angle), 0.0, -np.sin(angle)])
    rotation = np.array([along, [0, 1, 0], normal])
    x = block((-0.25, -0.25, 0), (0.25, 0.25, 0.25), 16) @ rotation
    slope = HalfSpace(point=(0, 0, 0), normal=normal, contact="slip")
    solver = run(liquid(x, 16, [slope], viscosity=3000), 12)
    duration = solver.clock.time - solver.clock.last_dt / 2
    speed = solver.state.v.numpy().mean(axis=0) @ along
    assert speed == pytest.approx(G * np.sin(angle) * duration, rel=0.05)


def test_sticky_wall_drags_along_a_liquid_at_rest():
    motion = Path(times=(0, 1), points=((0, 0, 0), (0.3, 0, 0)), smooth=False)
    plate = HalfSpace(point=(0, 0, 0), normal=(0, 0, 1), contact="sticky", motion=motion)
    x = block((-0.25, -0.25, 0), (0.25, 0.25, 0.5), 16)
    solver = run(liquid(x, 16, [plate], gravity=(0, 0, 0), viscosity=1000), 4)
    impulse = solver.impulses.wrench("wall_0").numpy()[0]
    momentum = (solver.model.mass.numpy() * solver.state.v.numpy()[:, 0]).sum()
    assert momentum == pytest.approx(impulse, rel=0.05)
    assert momentum > 0.3 * 0.3 * DENSITY * 0.5**3


def test_viscous_block_on_an_oblique_wall_throws_out_no_jets():
    x = block((-0.25, -0.25, 0.2), (0.25, 0.25, 0.7), 24)
    slope = HalfSpace(point=(0, 0, 0), normal=(0.1, 0, 1), contact="slip")
    y = np.abs(run(liquid(x, 24, [slope], viscosity=1000), 16).state.x.numpy()[:, 1])
    assert y.max() < 1.2 * np.percentile(y, 99)


def test_stiff_viscous_equation_takes_few_iterations(iterations):
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 16)
    solver = run(liquid(x, 16, [FLOOR], viscosity=1e5), 6)
    assert len(iterations) <= 12
    assert max(iterations) < 300
    speed = 3 * DENSITY * G * 0.5**2 / (2 * 3 * 1e5)  # several times that of the top
    assert np.abs(solver.state.v.numpy()).max() < speed


def test_liquid_in_free_fall_needs_few_viscous_iterations(iterations):
    run(liquid(block((0, 0, 0), (0.5, 0.5, 0.5), 8), 8, [], viscosity=1e4), 6)
    assert max(iterations) <= 10


def test_viscous_liquid_with_two_threads_is_repeatable():
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 8)
    first, second = (
        run(liquid(x, 8, [FLOOR], viscosity=1000, threads=2), 6).state.x.numpy() for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)
