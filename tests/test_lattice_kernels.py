"""The lattice's kernels: SIMD and plain forms, and CUDA."""

import numpy as np
import pytest
import warp as wp

from phy124.boundaries import Ground, HalfSpace, Held
from phy124.forces import Acceleration
from phy124.kernels.lattice import nodes, points, work
from phy124.kernels.lattice.simd import has_stress
from phy124.kernels.lattice.stress import CLOSING, GRADIENT, SPEED
from phy124.lattice import impulses, kernels, material, solids
from phy124.lattice import walls as lattice_walls
from phy124.lattice.trials import COMPARE, TRIAL, Trials
from phy124.lattice.workers import MEASURE
from phy124.materials import FixedCorotated, Hencky, NeoHookean
from phy124.monitor.diagnostics import Totals
from phy124.monitor.lattice import LatticeTotals
from phy124.mpm.workers import run_launches
from phy124.schema.region import Region
from support.lattices import SOFT, block, make


@pytest.mark.parametrize("damping", [0.0, 100.0])
def test_simd_and_plain_stress_agree(damping):
    material = NeoHookean(E=1e5, nu=0.3, density=1000, damping=damping)
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    forces, limits = [], []
    for vectors in (True, False):
        solver = make(solid, material, precision="float32", vectors=vectors)
        rng = np.random.default_rng(1)
        solver.nodes_state.u.assign(0.02 * rng.normal(size=(solver.nodes, 3)))
        solver.nodes_state.v.assign(0.5 * rng.normal(size=(solver.nodes, 3)))
        solver.nodes_state.lagging.assign(solver.nodes_state.v)
        trials = Trials(solver.model, solver.crew, np.zeros((solver.nodes, 3)))
        trials.u.assign(solver.nodes_state.u)
        solver.runner.complete(TRIAL)
        solver.runner.complete(COMPARE)
        forces.append(trials.after.numpy().copy())
        solver.runner.complete(MEASURE)
        limits.append(solver.crew.take_maxima())
    assert np.abs(forces[0] - forces[1]).max() < 2e-6 * np.abs(forces[1]).max()
    for which in (GRADIENT, CLOSING):
        assert limits[0][which] == pytest.approx(limits[1][which], rel=1e-3)
    assert limits[0][SPEED] >= limits[1][SPEED]


def test_simd_stress_is_chosen_by_the_stress_function():
    """A plug-in may name its own law as it likes."""
    law = NeoHookean(damping=1.0).device_law
    assert has_stress(law) and has_stress(law._replace(name="rubber"))
    assert not has_stress(Hencky().device_law._replace(name="neo_hookean_log"))


@pytest.mark.parametrize("law", [pytest.param(FixedCorotated, marks=pytest.mark.slow), Hencky])
def test_forces_of_inverted_points_derive_from_the_energy(law):
    """Otherwise, a few points that a hard impact turned inside out would add energy for ever."""
    solver = make(block((0.3, 0.3, 0.3)), law(E=1e5, nu=0.3, density=1000))
    rng = np.random.default_rng(1)
    u = [0.1, 0, -1.6] * solver.lattice.x + 0.002 * rng.normal(size=(solver.nodes, 3))
    way = rng.normal(size=u.shape)

    def energy(displaced):
        solver.nodes_state.u.assign(displaced)
        solver.follow()
        return Totals(solver.model, solver.state).read(solver.clock).elastic

    slope = (energy(u + 1e-7 * way) - energy(u - 1e-7 * way)) / 2e-7
    assert np.linalg.det(np.asarray(solver.state.F.numpy(), float)).max() < 0
    solver.nodes_state.u.assign(u)
    (worker,) = solver.workers
    run_launches({}, solver.crew.force(worker))
    force = worker.forces.numpy()[: len(u)]
    assert (force * way).sum() == pytest.approx(-slope, rel=1e-5)


def test_simd_and_plain_points_agree():
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    region = Region(lower=(-1, -1, 0.2), upper=(2, 2, 2))
    states = []
    for vectors in (True, False):
        push = Acceleration(a=(1, 0, 0), region=region)
        solver = make(solid, forces=[push], precision="float32", vectors=vectors)
        rng = np.random.default_rng(1)
        solver.nodes_state.u.assign(0.02 * rng.normal(size=(solver.nodes, 3)))
        solver.nodes_state.v.assign(0.5 * rng.normal(size=(solver.nodes, 3)))
        for worker in solver.workers:
            run_launches({}, solver.crew.locate(worker))
        assert (solver.state.v.numpy() == solver.crew._kept.numpy()).all()
        located = solver.state.x.numpy().copy(), solver.state.v.numpy().copy()
        solver.follow()
        followed = (getattr(solver.state, name).numpy() for name in ("x", "v", "C", "F"))
        states.append((*located, *followed))
    for simd, plain in zip(*states, strict=True):
        assert np.abs(simd - plain).max() < 3e-6 * np.abs(plain).max()


def test_simd_and_plain_totals_agree():
    material = NeoHookean(E=1e5, nu=0.3, density=1000, damping=50)
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    solver = make(solid, material, precision="float32")
    solver.clock.last_dt = 1e-3
    rng = np.random.default_rng(1)
    solver.nodes_state.v.assign(0.5 * rng.normal(size=(solver.nodes, 3)))
    u = rng.normal(size=(solver.nodes, 3))
    broken = u.copy()
    broken[7, 1] = np.inf
    for displaced, damaged in ((1e-4 * u, False), (0.01 * u, False), (0.2 * broken, True)):
        solver.nodes_state.u.assign(displaced)
        solver.follow()
        simd = LatticeTotals(solver).read(solver.clock)
        plain = Totals(solver.model, solver.state).read(solver.clock)
        assert (plain.broken > 0 and plain.inverted > 0) == damaged
        for name in ("broken", "inverted", "first_broken", "first_inverted"):
            assert getattr(simd, name) == getattr(plain, name), name
        for name in ("elastic", "lag", "min_J", "max_J"):
            assert getattr(simd, name) == pytest.approx(getattr(plain, name), rel=1e-11), name


def test_simd_and_plain_shock_agree():
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    forces = []
    for vectors in (True, False):
        solver = make(solid, precision="float32", vectors=vectors)
        solver.clock.begin(0.01, 0.01)
        rng = np.random.default_rng(1)
        solver.nodes_state.u.assign(0.01 * rng.normal(size=(solver.nodes, 3)))
        solver.nodes_state.v.assign(0.5 * rng.normal(size=(solver.nodes, 3)))
        (worker,) = solver.workers
        run_launches({}, solver.crew.shock(worker, solver.clock.values))
        forces.append(worker.forces.numpy().copy())
    assert np.abs(forces[0] - forces[1]).max() < 1e-5 * np.abs(forces[1]).max() > 0


@pytest.mark.parametrize("flat", [1.0, 0.05])
def test_artificial_viscosity_takes_energy_in_any_kick(flat):
    """A kick may be longer than the viscosity allows, because a longer substep preceded it."""
    solver = make(block((0.5, 0.4, 0.3), per=4))
    x = solver.lattice.x
    solver.nodes_state.u.assign([0, 0, flat - 1] * x)
    v = x * [-30, -20, -50 * flat] + 2 * np.random.default_rng(1).normal(size=x.shape)
    solver.nodes_state.v.assign(v)
    (worker,) = solver.workers
    movable = np.flatnonzero(solver.nodes_state.inverse.numpy() > 0)
    inverse = solver.nodes_state.inverse.numpy()[movable, None]
    for kick in (1e-5, 0.01, 1.0):
        solver.clock.begin(kick, kick)
        worker.forces.zero_()
        run_launches({}, solver.crew.shock(worker, solver.clock.values))
        force = worker.forces.numpy()[movable]
        work = kick * (force * (v[movable] + kick / 2 * inverse * force)).sum()
        assert work < 0


def test_simd_and_plain_contact_agree():
    solid = block((0.425, 0.5, 0.325), low=(0.025, 0.05, 0.0), per=4)
    results = []
    for vectors in (True, False):
        walls = [Ground(friction=0.4), HalfSpace(point=(0, 0, 0.3), normal=(0, 0.2, -1))]
        v = (1.0, 0.5, -2.0)
        solver = make(solid, v=v, boundaries=walls, precision="float32", vectors=vectors)
        solver.walls.keep_impulses()
        solver.record()
        for _ in range(5):
            solver.step(5e-4, 5e-4)
        sums, kept = solver.walls.sums.numpy(), solver.walls.impulses.sums.numpy()
        assert np.allclose(kept.sum(axis=0), sums[:, :3].sum(axis=0), rtol=1e-12)
        results.append([array.copy() for array in (solver.nodes_state.v.numpy(), sums, kept)])
        snapshot = solver.snapshot()
        solver.step(5e-4, 5e-4)
        solver.restore(snapshot)
        assert np.array_equal(solver.walls.impulses.sums.numpy(), results[-1][2])
    for simd, plain in zip(*results, strict=True):
        assert np.abs(plain).max() > 0.1
        assert np.abs(simd - plain).max() < 1e-4 * np.abs(plain).max()


@pytest.mark.slow
@pytest.mark.parametrize("arch", [75, 80, 86, 90, 100])
def test_lattice_compiles_for_cuda(arch, tmp_path):
    walls = [Ground(), Held()]
    laws = [(SOFT.device_law, False), (Hencky(damping=1.0).device_law, True)]
    kind = wp.float32, "cuda"
    made = *kernels.of_workers(laws, *kind), *lattice_walls.kernels(walls, *kind, several=True)
    made += *solids.kernels_of(["box", "sphere"], *kind), *material.kernels_of(*kind)
    made += (
        *impulses.kernels(wp.float32),
        work.make_node_work(wp.float32),
        work.make_contact_work(wp.float32),
        work.make_push_work(wp.float32),
        points.make_locate(wp.float32),
        points.make_push(wp.float32),
        nodes.make_copy(wp.float32),
    )
    modules = {kernel.module.name: kernel.module for kernel in made}
    for name, module in modules.items():
        folder = tmp_path / name
        folder.mkdir()
        wp.compile_aot_module(module, arch=arch, module_dir=str(folder), use_ptx=True)
        assert list(folder.glob("*.ptx")), name
