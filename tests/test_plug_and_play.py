"""Plug and play, measured: the same scene moves the Gaussians of every generator alike."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from phy124.gaussians import Gaussians
from phy124.generators import GENERATORS, make
from phy124.generators.neural.dreamgaussian.generator import DreamGaussian, Settings
from phy124.generators.neural.dreamgaussian.splats import Density, Splats
from phy124.generators.neural.lgm.generator import Lgm, to_gaussians
from phy124.generators.neural.lgm.model import LgmModel, Option, load
from phy124.generators.neural.orbit import TO_WORLD
from phy124.generators.ply_file import PlyFile
from phy124.io.axes import DIALECTS, rotate_gaussians
from phy124.io.ply import write_ply
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from reference import formula
from support.pages import ROOT

HALF = np.array([0.5, 0.3, 0.4])
"""Half sides of the box that every description below is of, m."""
TINY_LGM = Option((32, 32, 64), (False, True, True), (64, 32), (True, False), 32)


def centre_path(gaussians: Gaussians, scene: Scene, mass: float) -> np.ndarray:
    """Centre of mass at each frame [T,3], m, of an object of `mass` kg."""
    weight = float(prepare(gaussians, scene).particles.mass.sum())
    scene = scene.replaced({"material.density": scene.material.density * mass / weight})
    run, path = Simulation(prepare(gaussians, scene)), []
    fraction = run.setup.particles.mass / run.setup.particles.mass.sum()
    assert float(run.setup.particles.mass.sum()) == pytest.approx(mass, rel=1e-4)
    for _ in run:
        path.append(fraction @ run.solver.state.x.numpy())
    return np.array(path)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of two paths from a common start, relative to the longer reach."""
    a, b = a - a[0], b - b[0]
    reach = max(np.linalg.norm(path, axis=1).max() for path in (a, b))
    return np.linalg.norm(a - b, axis=1).max() / reach


def box(count: int, size: float, seed: int) -> Gaussians:
    """The box's surface, strewn with round Gaussians."""
    rng = np.random.default_rng(seed)
    points, areas = rng.uniform(-1, 1, (count, 3)), HALF.prod() / HALF
    face = rng.choice(3, count, p=areas / areas.sum())
    points[np.arange(count), face] = np.sign(points[np.arange(count), face])
    quats = np.tile([1, 0, 0, 0], (count, 1))
    scales, opacities = np.full((count, 3), size), np.full(count, 0.95)
    return Gaussians.from_rgb(
        points * (HALF - size), quats, scales, opacities, rng.random((count, 3))
    )


def as_lgm(gaussians: Gaussians) -> Gaussians:
    """The same object through LGM's 14 numbers."""
    theirs = rotate_gaussians(gaussians, TO_WORLD.T)
    columns = [theirs.means, theirs.opacities[:, None], theirs.scales, theirs.quats, theirs.rgb]
    return to_gaussians(np.concatenate(columns, axis=1))


def as_dreamgaussian(gaussians: Gaussians) -> Gaussians:
    """The same object through DreamGaussian's parameters."""
    theirs = rotate_gaussians(gaussians, TO_WORLD.T)
    parameters = {
        "xyz": torch.from_numpy(theirs.means),
        "f_dc": torch.from_numpy(theirs.sh),
        "opacity": torch.from_numpy(theirs.opacities).logit()[:, None],
        "scaling": torch.from_numpy(theirs.scales).log(),
        "rotation": torch.from_numpy(theirs.quats),
    }
    return Splats(parameters).gaussians()


@pytest.mark.usefixtures("coarse_solids")
def test_one_box_from_four_generators_falls_and_bounces_alike(tmp_path):
    """Equal mass and shape, but other Gaussians in number, size and place: within 3 %."""
    write_ply(tmp_path / "box.ply", box(9000, 0.02, 1))
    described = {
        "arrays": box(6000, 0.02, 0),
        "ply": PlyFile(str(tmp_path / "box.ply"))(),
        "lgm": as_lgm(box(12000, 0.015, 2)),
        "dreamgaussian": as_dreamgaussian(box(6000, 0.025, 3)),
    }
    fall = {"object.lift": 0.5, "material.E": 4e4, "time.frames": 12, "time.fps": 20.0}
    scene = Scene.named("drop").replaced({"accuracy": {"cells": 12}, **fall})
    paths = {name: centre_path(g, scene, 500.0) for name, g in described.items()}
    figures = {name: apart(path, paths["arrays"]) for name, path in paths.items()}
    lowest = paths["arrays"][:, 2].min()
    assert paths["arrays"][0, 2] - lowest > 0.5 and paths["arrays"][-1, 2] > lowest + 0.05
    assert max(figures.values()) < 0.03, figures
    assert sum(figure > 0 for figure in figures.values()) == 3, "they are different Gaussians"


@pytest.mark.slow
def test_results_of_real_generators_fly_alike(tmp_path):
    """Relief, its PLY, LGM and DreamGaussian with made-up weights: any shape, the same flight."""
    picture = np.zeros((64, 64, 4), np.uint8)
    y, x = np.mgrid[:64, :64]
    picture[(x - 32) ** 2 + 1.5 * (y - 32) ** 2 < 500] = 220, 180, 40, 255
    relief = make("relief")(picture, seed=0, progress=lambda *arguments: None)
    write_ply(tmp_path / "relief.ply", relief)
    with torch.device("meta"):
        empty = LgmModel(TINY_LGM)
    model = load(formula.state_dict(empty), TINY_LGM)
    views = formula.inputs("views", (5, 3, 32, 32), 0, 1)
    lgm = Lgm(model=model, multiview=lambda image, *, seed, progress: views, device="cpu")
    settings = Settings(steps=2, points=400, known_size=16, sizes=(16,), density=Density(start=9))
    dream = DreamGaussian(guidance=lambda image: Nothing(), settings=settings, device="cpu")
    made = {
        "relief": relief,
        "ply": make(str(tmp_path / "relief.ply"))(
            picture, seed=0, progress=lambda *arguments: None
        ),
        "lgm": lgm(picture),
        "dreamgaussian": dream(picture),
    }
    scene = Scene.named("drop").replaced(
        {"accuracy": {"cells": 12}, "object.lift": 2.0, "object.velocity": [3.0, 1.0, 2.0]}
        | {"time.frames": 8}
    )
    t = np.arange(8) / scene.time.fps
    exact = np.stack([3 * t, t, 2 * t - 9.81 * t**2 / 2], axis=1)
    for name, gaussians in made.items():
        path = centre_path(gaussians, scene, 300.0)
        assert apart(path, exact) < 0.005, name


class Nothing:
    """A guidance without an opinion."""

    def __call__(self, images, poses, ratio, draw):
        return 0 * images.sum()


def test_generator_of_the_docs_has_a_name(monkeypatch):
    """docs/examples: used by name and as an object."""
    monkeypatch.setitem(GENERATORS, "ball", None)  # so that it is taken out again
    runpy.run_path(str(ROOT / "docs/examples/20_generator.py"))
    made = make("ball")(np.zeros((4, 4, 4), np.uint8), seed=1, progress=lambda *arguments: None)
    assert isinstance(made, Gaussians)
    assert np.ptp(made.means, axis=0).max() == pytest.approx(1, abs=0.1)
    scene = Scene.named("drop").replaced({"accuracy": "draft", "time.frames": 2})
    assert len(Simulation(prepare(made, scene)).run()) == 2


def test_the_table_of_dialects_is_the_reader_s(tmp_path):
    """docs/guide/plugins.md names every dialect with the axes that `read_ply` takes for it."""
    page = (Path(__file__).parents[1] / "docs/guide/plugins.md").read_text("utf-8")
    cells = [
        [c.strip() for c in line.split("|")[1:5]]
        for line in page.splitlines()
        if line.count("|") == 6
    ]
    table = {dialect.strip("`"): (up, front) for _, dialect, up, front in cells if "`" in dialect}
    assert table == DIALECTS
