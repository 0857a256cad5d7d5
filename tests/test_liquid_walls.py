"""Moving walls in a liquid, and walls next to freely moving solids."""

import numpy as np
import pytest

from phy124.boundaries import Container, HalfSpace, Path, Swing
from phy124.mpm import FreeBody
from phy124.schema.region import Region
from support.liquids import TANK, G, block, heights, liquid, run

pytestmark = pytest.mark.usefixtures("coarse_solids")
WRITTEN = ("distances", "owners", "eighths", "open", "covers", "shares")


def test_piston_raises_the_level():
    motion = Path(times=(0.0, 0.5), points=((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)))
    piston = HalfSpace(point=(0, 0, 0), normal=(1, 0, 0), contact="slip", motion=motion)
    tank = Container(inside=Region(lower=(-1, 0, 0), upper=(1, 1, 1e9)), contact="slip")
    solver = run(liquid(block((0, 0, 0), (1, 1, 0.5), 8), 8, [tank, piston]), 30)
    assert heights(solver).mean() == pytest.approx(0.5 / 0.9, rel=0.02)
    assert solver.state.x.numpy()[:, 0].min() > 0.1 - 0.25 * solver.model.dx


def test_no_liquid_is_behind_a_piston_of_a_cell_per_step():
    motion = Path(times=(0.0, 0.1), points=((0.0, 0.0, 0.0), (0.2, 0.0, 0.0)), smooth=False)
    piston = HalfSpace(point=(0, 0, 0), normal=(1, 0, 0), contact="slip", motion=motion)
    tank = Container(inside=Region(lower=(-1, 0, 0), upper=(1, 1, 1e9)), contact="slip")
    solver = liquid(block((0, 0, 0), (1, 1, 0.5), 8), 8, [tank, piston])
    for frame in range(1, 5):
        solver.advance(frame / 40)
        assert solver.state.x.numpy()[:, 0].min() > 2.0 * frame / 40


def test_box_that_shrinks_below_its_liquid_does_not_explode():
    """The box has room for two thirds of the liquid in the end; speeds stay near the wall's."""
    motion = Path(times=(0.0, 1.0), points=((0.0, 0.0, 0.0), (-0.5, 0.0, 0.0)))
    wall = HalfSpace(point=(1, 0, 0), normal=(-1, 0, 0), contact="slip", motion=motion)
    box = Container(inside=Region(lower=(0, 0, 0), upper=(2, 1, 1)), contact="slip")
    solver = liquid(block((0, 0, 0), (1, 1, 0.75), 8), 8, [box, wall])
    fastest = 0.0
    for _ in range(6):
        run(solver, 12)
        fastest = max(fastest, np.linalg.norm(solver.state.v.numpy(), axis=1).max())
    x = solver.state.x.numpy()
    assert min(solver.crowding, solver.lasting) > 0.1
    assert fastest < 3
    assert ((x > 0) & (x < (0.5, 1, 1))).all()
    assert np.linalg.norm(solver.state.v.numpy(), axis=1).mean() < 0.1


def test_walls_and_solids_ignore_the_order_of_workers():
    swing = Swing(amplitude=(0, 0, 0.02), frequency=2.0)
    floor = HalfSpace(point=(0, 0, 0.03), normal=(0, 0, 1), contact="slip", motion=swing)
    ball = FreeBody("ball", "sphere", (0.15,) * 3, (0.62, 0.5, 0.16))
    x = block((0, 0, 0.5), (1, 1, 0.75), 16)
    solver = liquid(x, 16, [floor, TANK], threads=2, offset=0.25, free=[ball])
    solver.start()
    results = []
    for order in (1, -1):
        solver.walls.place(0.0)
        solver.cells.restore_walls()
        solver.walls.centre(solver.cells)
        for phase in solver._phases.group("move"):
            for worker in solver.workers[::order]:
                worker.run(phase)
        results.append([getattr(solver.cells, name).numpy().copy() for name in WRITTEN])
    for name, first, second in zip(WRITTEN, *results, strict=True):
        np.testing.assert_array_equal(first, second, err_msg=name)


@pytest.mark.parametrize("width", [1.2, 2.4, 4.1])
def test_still_water_fits_tanks_whose_walls_cut_cells(width):
    """Few parts of cells at the walls are open, and in a narrow tank both walls are near."""
    side = width / 8
    tank = Container(inside=Region(lower=(0, 0, 0), upper=(side, side, 1e9)), contact="slip")
    x = block((0, 0, 0), (side, side, 1), 8)
    x[:, :2] *= side / (2 * x[:, :2].mean(axis=0))
    solver = run(liquid(x, 8, [tank], offset=1 - width % 1 / 2), 24)
    before = solver.impulses.wrench("wall_0_z_low").numpy()[2]
    press = (run(solver, 24).impulses.wrench("wall_0_z_low").numpy()[2] - before) * 2
    assert press == pytest.approx(G * solver.model.total_mass, rel=0.02)
    assert np.abs(solver.state.v.numpy()).max() < 0.1
