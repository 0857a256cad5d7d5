import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.painted import Canvas
from phy124.materials import FixedCorotated, NeoHookean
from phy124.scene import Part, Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.simulation.materials import assign
from phy124.studies.validation.bodies import make_solver
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

GRID = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 8)] * 3), axis=-1).reshape(-1, 3)
FRONT = Canvas.of(GRID)
NOBODY = np.full(len(GRID), -1)


def test_a_region_picks_what_lies_in_it():
    part = Part(region=Region(upper=(0, 9, 9)))
    assert np.array_equal(assign(GRID, NOBODY, [part], FRONT) == 1, GRID[:, 0] <= 0)


def test_later_parts_win():
    parts = [Part(region=Region()), Part(region=Region(lower=(0, -9, -9)))]
    assert np.array_equal(assign(GRID, NOBODY, parts, FRONT), np.where(GRID[:, 0] >= 0, 2, 1))


def test_a_mask_is_seen_from_the_front(tmp_path):
    """Image right is +y, image top is +z; the object fills the middle half of this picture."""
    mask = np.zeros((80, 80), np.uint8)
    mask[:40, 40:] = 255
    Image.fromarray(mask).save(tmp_path / "m.png")
    part = Part(mask=str(tmp_path / "m.png"))
    chosen = assign(GRID, NOBODY, [part], Canvas.of(GRID, (0.25, 0.25, 0.75, 0.75))) == 1
    assert np.array_equal(chosen, (GRID[:, 1] > 0) & (GRID[:, 2] > 0))


def test_gaussians_bring_the_fillers_near_them():
    gaussian = np.where(GRID[:, 0] > 0.3, 1, np.where(GRID[:, 0] < -0.3, 0, -1))
    chosen = assign(GRID, gaussian, [Part(gaussians=(1, 2))], FRONT)
    assert np.array_equal(chosen == 1, GRID[:, 0] > 0)


def test_gaussians_that_ride_along_pick_what_is_near_them():
    means = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    part = Part(gaussians=(1, 2), material=FixedCorotated(E=1e5))
    chosen = assign(GRID, NOBODY, [part], FRONT, means)
    assert np.array_equal(chosen == 1, GRID[:, 0] > 0)
    scene = Scene(parts=(part.model_copy(update={"gaussians": (0, 100)}),), binding="lattice")
    coarse = scene.replaced({"accuracy": {"cells": 8}, "time.frames": 1})
    assert 0 < prepare(ball(), coarse).particles.material.mean() < 1


def test_refusals(tmp_path):
    with pytest.raises(InputError, match="a part needs a region, a mask or gaussians"):
        Scene.from_data({"parts": [{"material": {"law": "neo_hookean"}}]})
    with pytest.raises(InputError, match="it holds no particle"):
        assign(GRID, NOBODY, [Part(region=Region(lower=(5, 5, 5)))], FRONT)
    with pytest.raises(InputError, match="There is no such file"):
        assign(GRID, NOBODY, [Part(mask=str(tmp_path / "none.png"))], FRONT)


def test_one_law_of_two_stiffnesses_is_one_launch():
    soft, hard = NeoHookean(E=1e4), NeoHookean(E=1e6)
    x = GRID[np.argsort(GRID[:, 0])]
    material = (x[:, 0] > 0).astype(int)
    s = make_solver(x, np.full(len(x), 1e-3), [soft, hard], dx=0.25, material=material)
    s.advance(0.01)
    assert [name for name in s.timings if name.startswith("p2g")] == ["p2g neo_hookean"]
    rows = s.model.groups[0].theta.numpy()
    assert np.allclose(rows[~(x[:, 0] > 0)], soft.theta(), rtol=1e-6)
    assert np.allclose(rows[x[:, 0] > 0], hard.theta(), rtol=1e-6)


def test_two_laws_are_two_launches_and_momentum_stays(rng):
    x = GRID[np.argsort(GRID[:, 0], kind="stable")]
    material = (x[:, 0] > 0).astype(int)
    v = rng.normal(size=x.shape)
    laws = [NeoHookean(density=100.0), FixedCorotated(density=5000.0)]
    s = make_solver(x, np.full(len(x), 1e-3), laws, dx=0.25, material=material, v=v)
    m = s.model.mass.numpy().astype(float)[:, None]
    assert np.isclose(m.max() / m.min(), 50)
    before = (m * s.state.v.numpy()).sum(axis=0)
    s.advance(0.02)
    assert np.abs((m * s.state.v.numpy()).sum(axis=0) - before).max() < 1e-6 * np.abs(m * v).sum()
    assert {name for name in s.timings if "p2g" in name} == {
        "p2g neo_hookean",
        "p2g fixed_corotated",
    }


def test_the_stiff_half_bends_less():
    """A ball, one half soft: pushed against the floor, the soft half gives way more."""
    soft = {"law": "neo_hookean", "E": 1e4}
    scene = Scene.named("press").replaced(
        {
            "material": {"law": "neo_hookean", "E": 4e5},
            "parts": [{"material": soft, "region": {"upper": [9, 0, 9]}}],
            "accuracy": {"cells": 12},
            "time.frames": 7,
        }
    )
    clip = Simulation(prepare(ball(), scene)).run()
    moved = np.linalg.norm(clip.means[-1] - clip.means[0], axis=1)
    left = clip.means[0, :, 1] < -0.2
    right = clip.means[0, :, 1] > 0.2
    assert moved[left].mean() > 1.2 * moved[right].mean()
    assert "several materials" in clip.report["effects"]["ran"]
