"""Workers share the particles evenly, and each has nodes enough for its own."""

import itertools

import numpy as np
import pytest

from phy124.materials import NeoHookean
from phy124.mpm import workers
from phy124.mpm.workers import GROWN, MIN_PARTICLES, layers, run_timed, usable_workers
from phy124.studies.validation.bodies import make_solver
from support.shapes import cloud

DX = 1 / 8


def solver(count: int, x: np.ndarray | None = None, **options):
    """Particles of a bar that is longest along y."""
    if x is None:
        x = cloud(600, size=1.0, corner=0.0, dx=DX) * (1, 3, 1)
        x = x[np.argsort(layers(x, 1, DX), kind="stable")]
    volume = np.full(len(x), 3 / len(x))
    return make_solver(x, volume, [NeoHookean(E=1e4)], dx=DX, threads=count, **options)


def particles_of(part) -> np.ndarray:
    """Indices of the particles of a part."""
    every = np.arange(part.particles.start, part.particles.stop)
    return every[part.chosen.numpy()] if len(part.chosen) else every


@pytest.mark.parametrize("count", [2, 3, 7])
def test_slabs_are_even_along_the_longest_axis(count):
    s = solver(count)
    x, owned = s.model.rest, [particles_of(part) for part in s.slabs.parts]
    assert sorted(np.concatenate(owned)) == list(range(len(x)))
    assert max(map(len, owned)) - min(map(len, owned)) <= 1
    for first, next_one in itertools.pairwise(owned):
        assert x[first, 1].max() <= x[next_one, 1].min() + DX


def test_slabs_are_runs_in_memory_at_first():
    assert all(len(part.chosen) == 0 for part in solver(4).slabs.parts)


def test_more_workers_than_particles_leave_some_without_any():
    s = solver(5, np.array([[0.5, 0.5, 0.5], [0.6, 0.6, 0.6]]))
    assert [len(worker.parts) for worker in s.workers].count(0) == 3
    s.step(1e-4, 1e-4)


@pytest.mark.parametrize("count", [2, 4])
def test_private_nodes_hold_slab_and_halo(count):
    s = solver(count)
    s.step(1e-4, 1e-4)
    for part in s.slabs.parts:
        reach = s.grid.reach(
            *(f(s.model.rest[particles_of(part)], axis=0) for f in (np.min, np.max))
        )
        assert (part.nodes.low <= reach[0]).all()
        assert (part.nodes.low + part.nodes.size >= reach[1]).all()
        assert part.nodes.size[1] < s.grid.size[1]
    spans = [
        (p.nodes.nodes.ptr, p.nodes.nodes.ptr + 16 * (p.nodes.count + 1)) for p in s.slabs.parts
    ]
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(spans))


def mix(s) -> None:
    """Let particles change places, so that slabs reach through all of the bar; measure."""
    s.state.x.assign(np.random.default_rng(0).permutation(s.state.x.numpy()))
    s.grid.stale = True
    s.clock.expire()
    s.step(1e-4, 1e-4)


def test_overlapping_slabs_are_recut():
    s = solver(4)
    s.step(1e-4, 1e-4)
    first = s.slabs.share
    mix(s)
    assert s.slabs.share < GROWN * first
    x = s.state.x.numpy()
    ends = [x[particles_of(part), 1] for part in s.slabs.parts]
    assert all(a.max() <= b.min() + 1.1 * DX for a, b in itertools.pairwise(ends))


def test_snapshot_includes_recut_slabs():
    s, fresh = solver(4), solver(4)
    s.step(1e-4, 1e-4)
    mix(s)
    fresh.restore(s.snapshot())
    pairs = zip(s.slabs.parts, fresh.slabs.parts, strict=True)
    assert all(np.array_equal(particles_of(a), particles_of(b)) for a, b in pairs)
    for item in (s, fresh):
        item.state.v.assign(np.random.default_rng(0).normal(size=s.model.rest.shape))
        for _ in range(6):
            item.step(1e-4, 1e-4)
    assert np.array_equal(s.state.x.numpy(), fresh.state.x.numpy())
    assert fresh.slabs.share == s.slabs.share


def test_slabs_of_few_nodes_stay_though_they_overlap(monkeypatch):
    """Lists of indices cost more than overlapping nodes do."""
    monkeypatch.setattr(workers, "NODES", 1000)
    s = solver(4)
    s.step(1e-4, 1e-4)
    first = s.slabs.share
    mix(s)
    assert s.slabs.share > GROWN * first
    assert all(len(part.chosen) == 0 for part in s.slabs.parts)


def test_number_of_workers_is_chosen_or_profitable(monkeypatch):
    monkeypatch.setattr(workers, "free_cores", lambda: 8)
    assert usable_workers(MIN_PARTICLES, "cpu") == 1
    assert usable_workers(3 * MIN_PARTICLES, "cpu") == 3
    assert usable_workers(100 * MIN_PARTICLES, "cpu") == 8
    assert usable_workers(10, "cpu", 5) == 5
    assert usable_workers(100 * MIN_PARTICLES, "cuda:0", 5) == 1


def test_time_is_added_up_by_name():
    timings = {}
    for _ in range(3):
        run_timed(timings, "p2g", lambda: None)
    assert timings["p2g"][1] == 3 and timings["p2g"][0] >= 0
