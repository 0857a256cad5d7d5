"""Any number of threads gives what one gives, the same bits each time, and nothing waits for ever.

Two cores are enough: threads without a core wait their turn.
"""

import threading
from functools import cache

import numpy as np
import pytest

from phy124.boundaries import Ground, Sphere
from phy124.errors import Cancelled, InputError
from phy124.forces import Gravity, ParticleForce, Wind
from phy124.materials import LAWS, NeoHookean, Sand
from phy124.monitor.external_work import ExternalWork
from phy124.mpm import Unstable
from phy124.runtime.context import RunContext
from phy124.runtime.cores import MOST_THREADS
from phy124.scene import Scene
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import make_solver
from support.runs import resumed
from support.shapes import ball
from support.solids import coarse

COUNTS = (2, 3, 4, 7, 16)
DX = 1 / 16


def bar(count: int = 3000):
    """Particles of a bar that stands on the floor, longest along z, and their velocities."""
    rng = np.random.default_rng(1)
    x = rng.uniform((0.2, 0.2, 0.3), (0.6, 0.7, 1.4), (count, 3))
    return x, rng.normal(size=(count, 3))


def solver(threads: int, *, materials=None, material=None, external=None, **options):
    """The bar under gravity and wind, on a floor and a ball."""
    x, v = bar()
    external = external or ExternalWork()
    forces, walls = [Gravity(start=0.004), Wind(v=(3, 0, 0), rate=5.0)], [Ground(height=0.3)]
    walls.append(Sphere(centre=(0.5, 0.4, 0.2), radius=0.2))
    s = make_solver(
        x,
        np.full(len(x), 0.22 / len(x)),
        materials or [NeoHookean(E=1e4)],
        v=v,
        dx=DX,
        material=material,
        forces=external.wrap_forces(forces),
        boundaries=external.wrap_walls(walls, walls),
        accumulators=[external],
        threads=threads,
        **options,
    )
    s.clock.ceiling = 1e-3
    return s


@cache
def moved(threads: int, time: float = 0.012):
    """Positions and external impulse after a while."""
    external = ExternalWork()
    s = solver(threads, external=external)
    external.open(s.clock)
    mass = np.asarray(s.model.mass.numpy())
    external.begin(mass @ s.state.v.numpy())
    s.advance(time)
    exchanged = external.total(s.clock, np.zeros(3))
    return s.state.x.numpy().copy(), exchanged.impulse, exchanged.work, s.clock.substeps


@pytest.mark.parametrize("threads", COUNTS)
def test_any_number_of_threads_agrees_and_repeats(threads):
    single, some = moved(1), moved(threads)
    np.testing.assert_allclose(some[0], single[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(some[1], single[1], rtol=0, atol=1e-5 * np.abs(single[1]).max())
    assert some[2] == pytest.approx(single[2], rel=1e-5) and some[3] == single[3]
    again = moved.__wrapped__(threads)
    assert np.array_equal(some[0], again[0]) and np.array_equal(some[1], again[1])


@pytest.mark.parametrize("threads", COUNTS)
def test_mass_and_momentum_of_all_slabs_come_together(threads):
    """The sums scattered by several threads equal those of one thread, node by node."""
    grids = []
    for count in (1, threads):
        s = make_solver(*bar_and_volume(), [NeoHookean(E=1e4)], v=bar()[1], dx=DX, threads=count)
        s._measure_if_due()
        s._scatter(0.0, 0.0)
        grids.append(s.grid.nodes.numpy()[:-1].astype(np.float64))
    single, some = grids
    assert some[:, 3].sum() == pytest.approx(s.model.total_mass, rel=1e-6)
    momentum, exchanged = some[:, 3] @ some[:, :3], s.model.mass.numpy() @ s.state.v.numpy()
    scale = np.abs(s.model.mass.numpy()[:, None] * s.state.v.numpy()).sum()
    np.testing.assert_allclose(momentum, exchanged, rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(some[:, 3], single[:, 3], rtol=2e-6, atol=0)
    weighed = [grid[:, :3] * grid[:, 3:] for grid in grids]
    np.testing.assert_allclose(*weighed, rtol=0, atol=1e-6 * np.abs(weighed[0]).max())


def bar_and_volume():
    """Positions and volumes of the bar's particles."""
    x, _ = bar()
    return x, np.full(len(x), 0.22 / len(x))


def test_materials_of_several_laws_are_cut_one_by_one():
    x, _ = bar()
    material = (np.arange(len(x)) >= 1800).astype(int)
    laws = {"materials": [NeoHookean(E=1e4), Sand(E=1e4)], "material": material}
    single, some = solver(1, **laws), solver(3, **laws)
    for s in (single, some):
        s.advance(0.006)
    assert len(some.slabs.parts) == 6
    assert [part.count for part in some.slabs.parts] == [600, 400] * 3
    np.testing.assert_allclose(some.state.x.numpy(), single.state.x.numpy(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(some.state.total.numpy(), single.state.total.numpy(), atol=1e-4)


def test_rejected_substeps_are_those_of_one_thread():
    """A blow that one substep must not take whole."""
    results = []
    for threads in (1, 3):
        x, volume = bar_and_volume()
        s = make_solver(
            x,
            volume,
            [NeoHookean(E=1e4)],
            dx=DX,
            threads=threads,
            forces=[ParticleForce(f=(0, 3000.0, 0))],
        )
        s.advance(0.004)
        results.append((s.rejection.rejected, s.clock.substeps, s.state.x.numpy()))
    (rejected, substeps, first), some = results
    assert rejected > 0 and some[:2] == (rejected, substeps)
    np.testing.assert_allclose(some[2], first, rtol=0, atol=1e-4)


def test_broken_particle_in_any_slab_is_reported():
    before, s = threading.active_count(), solver(4)
    s.advance(0.002)
    v = s.state.v.numpy()
    v[-1] = np.nan
    s.state.v.assign(v)
    with pytest.raises(Unstable, match="NaN"):
        s.advance(0.02)
    assert threading.active_count() == before


SCENE = {"accuracy": {"cells": 10}, "time.frames": 5}


@pytest.fixture(scope="module")
def whole():
    """The clip of a run with three threads."""
    with coarse():  # also in the tests that compare their runs with it
        setup = prepare(ball(600), Scene.named("wind").replaced(SCENE), RunContext(threads=3))
        yield Simulation(setup).run()


@pytest.mark.parametrize(
    "threads",
    [None, pytest.param(3, marks=pytest.mark.slow), 2, pytest.param(1, marks=pytest.mark.slow)],
)
def test_resume_is_exact_or_names_other_threads(tmp_path, whole, threads):
    run = Simulation(prepare(ball(600), Scene.named("wind").replaced(SCENE), RunContext(threads=3)))
    context = RunContext(threads=threads)
    clip = resumed(run, 2, tmp_path / "pause.safetensors", context=context).run()
    said = [note for note in clip.report["notes"] if "thread" in note]
    if threads in (None, 3):
        assert np.array_equal(clip.means, whole.means) and not said
        assert clip.report["substeps"] == whole.report["substeps"]
    else:
        np.testing.assert_allclose(clip.means, whole.means, rtol=0, atol=1e-5)
        assert f"paused with 3 CPU thread(s) and continued with {threads}" in said[0]


def test_a_frame_that_is_taken_back_takes_back_its_slabs(whole):
    """Cancelled in the middle of a frame and taken up again, with three threads."""

    class Once:
        left = 30

        def __call__(self, *_: object) -> None:
            self.left -= 1
            if self.left == 0:
                raise Cancelled

    progress = Once()
    run = Simulation(
        prepare(
            ball(600), Scene.named("wind").replaced(SCENE), RunContext(threads=3, progress=progress)
        )
    )
    with pytest.raises(Cancelled):
        run.run()
    assert run.count < 5
    assert np.array_equal(run.run().means, whole.means)


@pytest.mark.parametrize("threads", [0, -2, MOST_THREADS + 1])
def test_a_number_of_threads_that_cannot_be_used_is_refused(threads):
    with pytest.raises(InputError, match="1 to 256 threads"):
        Simulation(prepare(ball(600), Scene.named("press"), RunContext(threads=threads)))


@pytest.mark.slow
@pytest.mark.parametrize("threads", [2, 7])
@pytest.mark.parametrize("name", [*preset_names(), *(f"drop {law}" for law in LAWS.by_name)])
def test_every_preset_and_law_does_as_with_one_thread(name, threads):
    preset, _, law = name.partition(" ")
    changes = {"accuracy": {"cells": 10}, "time.frames": 4}
    scene = Scene.named(preset).replaced({**changes, **({"material.law": law} if law else {})})
    runs = (
        Simulation(prepare(ball(500), scene, RunContext(threads=n))).run()
        for n in (1, threads, threads)
    )
    single, some, again = runs
    assert np.array_equal(some.means, again.means)
    # Walls begin to act, and grains to yield, in another substep once rounding differs.
    assert np.abs(some.means - single.means).max() < 2e-3
    assert np.quantile(np.abs(some.means - single.means), 0.99) < 1e-4
