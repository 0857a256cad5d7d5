"""Use of a GPU from the command line and the page, for pictures, networks, and on a second card."""

import json

import numpy as np
import pytest
import warp as wp

from demo.work import Done, steps
from phy124.__main__ import main
from phy124.camera import Camera
from phy124.io.ply import write_ply
from phy124.motion.blocks import BLOCK
from phy124.motion.deform import Deformer
from phy124.rendering.film import film
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import make_stage
from phy124.runtime.context import RunContext
from phy124.scene import Scene, View
from phy124.simulation import Simulation, prepare
from support.orders import small_order
from support.shapes import ball, splats

pytestmark = pytest.mark.gpu
FEW = {"accuracy": {"cells": 8, "solver": "mpm"}, "time.frames": 3}


def test_the_command_line_makes_a_clip_and_films_it(gpu, tmp_path, capsys):
    write_ply(tmp_path / "ball.ply", ball(500))
    out = tmp_path / "out"
    arguments = ["simulate", str(tmp_path / "ball.ply"), "--scene", "press", "--out", str(out)]
    options = ["--device", gpu, "--json", "--set", "accuracy.cells=8", "time.frames=3"]
    assert main([*arguments, *options, "view.size=64"]) == 0
    assert (out / "front.mp4").exists()
    assert str(out) in json.dumps(json.loads(capsys.readouterr().out))


def test_the_page_makes_a_clip(gpu, tmp_path):
    events = [event for event in steps(small_order(tmp_path, device=gpu)) if event is not None]
    assert isinstance(events[-1], Done)


@pytest.mark.parametrize("size", [(64, 64), (250, 190)])
@pytest.mark.parametrize("degree", [0, 3])
def test_pictures_are_those_of_the_cpu(gpu, size, degree):
    g = splats(np.random.default_rng(0), 3000, degree=degree)
    camera = Camera.orbit(30, 20, 1.4, size)
    ours, theirs = (Renderer(device=device)(g, camera, alpha=True) for device in ("cpu", gpu))
    assert np.abs(theirs - ours).max() <= 1 / 255


def test_the_stage_is_that_of_the_cpu(gpu):
    clip = Simulation(prepare(ball(500), Scene.named("press").replaced(FEW))).run()
    frame, camera, drawn = list(clip.frames())[-1], Camera.orbit(30, 20, 3.0, (96, 64)), []
    for device in ("cpu", gpu):
        stage = make_stage(clip, View(stage="studio"), device=device)
        drawn.append(Renderer(device=device)(frame.gaussians, camera, stage=stage.at(frame)))
    assert np.abs(drawn[1] - drawn[0]).max() <= 2 / 255


def test_films_have_every_output(gpu, tmp_path):
    scene = Scene.named("drop").replaced({**FEW, "contacts": True})
    clip = Simulation(prepare(ball(500), scene, RunContext(device=gpu))).run()
    view = View(size=64, views=("front",), outputs=("depth", "normals", "flow"))
    assert all(path.exists() for path in film(clip, view, tmp_path, device=gpu))


def test_networks_compute_in_half_precision(gpu):
    torch = pytest.importorskip("torch")
    if gpu != "cpu" and not torch.cuda.is_available():
        pytest.skip("this torch cannot use the GPU")
    from phy124.generators.neural.lgm.generator import Lgm
    from phy124.generators.neural.lgm.model import LgmModel, load
    from reference import formula
    from reference.formula import TINY

    weights = formula.state_dict(LgmModel(TINY))
    views, made = formula.inputs("views", (4, 3, 64, 64), 0, 1), []
    for device, dtype in (("cpu", torch.float32), (gpu, None)):
        generator = Lgm(option=TINY, device=device, dtype=dtype)
        generator.model = load(weights, TINY, device=generator.device, dtype=generator.dtype)
        generator.model.rotations = "each"
        made.append(generator.from_views(views))
    if gpu != "cpu":
        assert generator.dtype == torch.float16
    assert len(made[1]) == pytest.approx(len(made[0]), rel=0.02)
    assert np.isfinite(made[1].means).all()
    extents = [np.percentile(g.means, (5, 95), axis=0) for g in made]
    np.testing.assert_allclose(extents[1], extents[0], atol=0.02)


def test_more_gaussians_than_a_block_deform(gpu):
    g = ball(2 * BLOCK)
    deform = Deformer(g, device=gpu)
    F = np.tile(np.eye(3, dtype=np.float32), (len(g), 1, 1))
    moved = deform(g.means + np.float32(0.5), F, index=1, time=0.1).gaussians
    np.testing.assert_allclose(moved.means, g.means + 0.5, atol=1e-6)


def test_a_second_card_computes_the_same(gpu):
    if gpu == "cpu" or wp.get_cuda_device_count() < 2:
        pytest.skip("this machine has no second CUDA device")
    scene = Scene.named("press").replaced(FEW)
    single, other = (
        Simulation(prepare(ball(500), scene, RunContext(device=f"cuda:{i}"))).run()
        for i in range(2)
    )
    np.testing.assert_allclose(single.means, other.means, atol=1e-3)
    g, camera = ball(500), Camera.orbit(30, 20, 1.4, 64)
    first, second = (Renderer(device=f"cuda:{i}")(g, camera) for i in range(2))
    np.testing.assert_allclose(second, first, atol=1 / 255)
