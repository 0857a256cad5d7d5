"""Static parts: seen in every frame as they are, unknown to the solver."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from phy124.budget.effects import Effects
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import Canvas
from phy124.particles import make_particles
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.materials import assign_materials
from support.runs import resumed
from support.shapes import ball
from support.solids import coarse

pytestmark = pytest.mark.usefixtures("coarse_solids")

COUNT = 300
NAMES = ("means", "quats", "scales", "opacities", "sh")


def beside(first: Gaussians, other: Gaussians) -> Gaussians:
    """Both, the Gaussians of each in turn, so that static and moving ones alternate."""
    order = np.argsort(np.concatenate([np.arange(len(g)) / len(g) for g in (first, other)]))
    both = {n: np.concatenate([getattr(first, n), getattr(other, n)])[order] for n in NAMES}
    return Gaussians(**both)


def two_balls(times: int = 1) -> Gaussians:
    """A ball of `COUNT` Gaussians on the left, and beside it one with so many in each place."""
    right = ball(COUNT).transform(1.0, np.array([0, 1.5, 0]))
    return beside(ball(COUNT), right.select(np.tile(np.arange(COUNT), times)))


STATIC = {"parts": [{"static": True, "region": {"lower": [-9, 0, -9]}}]}
PAIR = {"object.size": 2.5, "accuracy": {"cells": 20}, "time.frames": 4, "object.lift": 0.25}


def drop(changes: dict) -> Scene:
    return Scene.named("drop").replaced(changes)


@pytest.fixture(scope="module")
def pair() -> Simulation:
    """A ball falls, the other hangs beside it."""
    with coarse():
        return Simulation(prepare(two_balls(), drop(PAIR | STATIC)))


@pytest.fixture(scope="module")
def clip(pair):
    return pair.run()


def test_static_gaussians_are_in_every_frame_bit_for_bit(pair, clip):
    still = pair.setup.gaussians.means[:, 1] > 0
    assert still.sum() == COUNT and len(still) == 2 * COUNT
    for name in ("means", "quats", "scales"):
        values = getattr(clip, name)
        rest = getattr(pair.setup.gaussians, name)
        assert (values[:, still] == rest[still]).all(), name
    assert np.array_equal(clip.opacities, pair.setup.gaussians.opacities)
    moved = np.abs(clip.means[-1] - clip.means[0]).max(axis=1)
    assert (moved[~still] > 0.01).all()


def test_the_solver_never_hears_of_them(pair, clip):
    """Five times as many static ones: as many particles and launches as before."""
    more = Simulation(prepare(two_balls(5), drop(PAIR | STATIC)))
    report = more.run().report
    assert pair.setup.particles.x[:, 1].max() < 0
    counts = [{n: k for n, (_, k) in r.solver.timings.items()} for r in (pair, more)]
    assert counts[0] == counts[1]
    # The size of an object is a quantile's: 0.5 % apart here.
    assert len(more.solver.model) == pytest.approx(len(pair.solver.model), rel=0.01)
    everything = Simulation(prepare(two_balls(), drop(PAIR)))
    everything.run()
    assert set(everything.solver.timings) == set(counts[0])
    assert len(everything.setup.particles) > 1.9 * len(pair.setup.particles)
    half = everything.report()["mass"] / 2
    assert clip.report["mass"] == pytest.approx(half, rel=0.01)
    assert "static Gaussians: 1500 never enter the solver" in report["effects"]["ran"]
    assert (report["static"], report["gaussians"]) == (5 * COUNT, 6 * COUNT)


def test_effects_name_them_before_the_run():
    assert "static Gaussians" in Effects.of(drop(PAIR | STATIC)).ran
    left_out = {o.name: o.why for o in Effects.of(drop(PAIR)).left_out}
    assert left_out["static Gaussians"] == "no part of the scene is static"


@pytest.mark.parametrize("binding", ["particles", "lattice"])
def test_colours_of_static_gaussians_do_not_turn(rng, binding):
    """Degree 1, under a spin: streamed frames and those of the clip are alike."""
    inputs = two_balls()
    inputs = replace(inputs, sh=rng.normal(size=(2 * COUNT, 4, 3)).astype(np.float32))
    spin = {"object.spin": [0, 0, 3.0], "velocities": True, "binding": binding}
    run = Simulation(prepare(inputs, drop(PAIR | STATIC | spin)))
    frames = list(run)
    clip, still = run.clip(), run.setup.gaussians.means[:, 1] > 0
    assert clip.rotations is not None and clip.velocities is not None
    for frame in (frames[3], clip.frame(3)):
        sh = frame.gaussians.sh
        assert np.array_equal(sh[still], run.setup.gaussians.sh[still])
        assert np.abs(sh[~still] - run.setup.gaussians.sh[~still]).max() > 0.01
        assert np.array_equal(frame.gaussians.means, clip.means[3])
        assert not frame.velocities[still].any()
        assert frame.velocities[~still].any(axis=1).all()
    assert np.array_equal(frames[3].gaussians.sh, clip.frame(3).gaussians.sh)


def test_a_cut_leaves_the_moving_half_filled():
    """The foot of a ball is static: what is above is still a solid body, not a shell."""
    foot = {"parts": [{"static": True, "region": {"upper": [9, 9, 0.3]}}]}
    particles = {"accuracy": {"cells": 10, "solver": "mpm"}, "object.lift": 0.0}
    scene = drop(particles | foot)
    whole = Simulation(prepare(ball(), drop(particles)))
    run = Simulation(prepare(ball(), scene))
    assert run.setup.particles.x[:, 2].min() > 0.3
    above = whole.setup.particles.x[:, 2] > 0.3
    assert len(run.setup.particles) == above.sum()
    assert run.setup.particles.volume.sum() == pytest.approx(
        whole.setup.particles.volume[above].sum()
    )


def test_all_ways_to_pick_them_and_later_parts_win(tmp_path):
    """The mask takes the right half, the Gaussians 0 to 9 are given back to a material."""
    gaussians = ball(COUNT)
    mask = np.zeros((10, 10), np.uint8)
    mask[:, 5:] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    picked = [
        {"static": True, "mask": str(tmp_path / "mask.png")},
        {"material": {"law": "metal"}, "gaussians": [0, 10]},
        {"static": True, "gaussians": [20, 25]},
    ]
    scene = drop({"parts": picked})
    particles = make_particles(gaussians, density=1000.0, spacing=0.1, binding="particles")
    result, moves = assign_materials(particles, gaussians.means, scene, Canvas.of(gaussians.means))
    right = gaussians.means[:, 1] > (gaussians.means[:, 1].min() + gaussians.means[:, 1].max()) / 2
    expected = ~right
    expected[20:25], expected[:10] = False, True
    assert np.array_equal(moves, expected)
    selected = result.gaussian >= 0
    assert np.array_equal(np.sort(result.gaussian[selected]), np.arange(moves.sum()))
    numbers = np.flatnonzero(moves)[result.gaussian[selected]]
    assert np.array_equal(result.x[selected], gaussians.means[numbers])
    assert set(result.material[selected][numbers < 10]) == {1}
    assert set(result.material[selected][numbers >= 10]) == {0}


def test_a_paused_run_with_static_gaussians_goes_on_bit_for_bit(tmp_path, clip):
    run = Simulation(prepare(two_balls(), drop(PAIR | STATIC)))
    again = resumed(run, 1, tmp_path / "pause").run()
    assert np.array_equal(again.means, clip.means)


def test_refusals():
    everything = {"parts": [{"static": True, "region": {}}]}
    with pytest.raises(InputError, match="every Gaussian is static"):
        Simulation(prepare(ball(COUNT), drop(everything)))
    both = {"static": True, "region": {}, "material": {"law": "sand"}}
    with pytest.raises(InputError, match="a static part has no material"):
        drop({"parts": [both]})
    chosen = drop(PAIR | STATIC)
    assert Scene.from_data(chosen.data()) == chosen
