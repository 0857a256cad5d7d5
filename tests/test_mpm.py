"""The solver against exact solutions and invariants, in both precisions and both forms."""

import threading

import numpy as np
import pytest
import warp as wp

from phy124.boundaries import Ground, HalfSpace
from phy124.errors import Cancelled
from phy124.forces import Acceleration, Gravity, ParticleForce, SetVelocity, TotalForce
from phy124.kernels import transfer
from phy124.kernels.build import kernel
from phy124.kernels.transfer import spline
from phy124.materials import NeoHookean
from phy124.mpm import Solver, Unstable
from phy124.mpm.timestep import Maxima
from phy124.mpm.workers import HOST
from phy124.schema.region import Region
from phy124.studies.validation import bodies
from phy124.studies.validation.bodies import make_solver

DX = 1 / 8
FORMS = [("float32", True), ("float32", False), ("float64", False)]


def block(per_axis: int = 8) -> np.ndarray:
    """A cube of 0.5 m around (0, 0, 1)."""
    return bodies.block(per_axis, 0.5, (0, 0, 1))


def solver(x: np.ndarray, material=None, size: float = 0.5, **options) -> Solver:
    volume = np.full(len(x), size**3 / len(x))
    options.setdefault("dx", DX)
    return make_solver(x, volume, [material or NeoHookean(E=1e4, nu=0.3)], **options)


def momentum(s: Solver) -> np.ndarray:
    return (s.model.mass.numpy().astype(float)[:, None] * s.state.v.numpy()).sum(axis=0)


def angular_momentum(s: Solver) -> np.ndarray:
    """With what APIC keeps in C: sum m (x cross v + dx^2/4 axial(C))."""
    m, x = s.model.mass.numpy().astype(float)[:, None], s.state.x.numpy().astype(float)
    v, C = s.state.v.numpy().astype(float), s.state.C.numpy().astype(float)
    axial = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    return (m * (np.cross(x, v) + s.model.dx**2 / 4 * axial)).sum(axis=0)


@pytest.mark.parametrize(("precision", "form"), FORMS)
def test_free_fall_is_exact(precision, form):
    """Half a kick at the start makes the parabola exact, whatever the substeps."""
    s = solver(block(), forces=[Gravity()], precision=precision, simd=form)
    for until in (0.05, 0.11, 0.2):
        s.advance(until)
    error = s.state.x.numpy() - (s.model.rest - [0, 0, 9.81 * 0.2**2 / 2])
    assert np.abs(error).max() < (1e-12 if precision == "float64" else 5e-6)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-5), ("float64", 1e-12)])
def test_rigid_rotation_keeps_angular_momentum_and_orthogonal_f(precision, tolerance):
    omega = np.array([0.0, 0, 3.0])
    x = block()
    spin = np.array([[0, -3.0, 0], [3.0, 0, 0], [0, 0, 0]])
    C = np.broadcast_to(spin, (len(x), 3, 3))
    material = NeoHookean(E=1e6, nu=0.3)
    s = solver(x, material, v=np.cross(omega, x - [0, 0, 1]), C=C, precision=precision)
    before = angular_momentum(s)
    s.advance(0.1)
    drift = np.linalg.norm(angular_momentum(s) - before) / np.linalg.norm(before)
    assert drift < tolerance
    F = s.state.F.numpy().astype(float)
    strain = np.einsum("nki,nkj->nij", F, F) - np.eye(3)
    # What a stiff body stretches by spinning: rho (omega r)^2 / E.
    assert np.abs(strain).max() < 20 * 1000 * (3 * 0.43) ** 2 / 1e6
    turn = np.arctan2(F[:, 1, 0], F[:, 0, 0])
    assert np.abs(turn - 0.3).max() < 0.01


@pytest.mark.parametrize(("precision", "form"), FORMS)
def test_momentum_is_conserved_without_forces(rng, precision, form):
    x = block()
    s = solver(x, v=rng.normal(size=x.shape), precision=precision, simd=form)
    before = momentum(s)
    scale = np.abs(s.model.mass.numpy()[:, None] * s.state.v.numpy()).sum()
    s.advance(0.3)
    assert s.clock.substeps > 10
    limit = 1e-14 if precision == "float64" else 1e-6
    assert np.abs(momentum(s) - before).max() < limit * scale


def test_at_rest_without_forces_nothing_moves_a_bit():
    s = solver(block())
    s.advance(0.5)
    assert np.array_equal(s.state.x.numpy(), s.model.rest.astype(np.float32))
    assert not s.state.v.numpy().any()


@pytest.mark.parametrize("form", [True, False])
def test_total_mass_arrives_on_the_grid(form):
    s = solver(block(), simd=form)
    s.step(0.0, 0.0)
    on_grid = s.grid.nodes.numpy()[:-1, 3].sum(dtype=float)
    assert np.isclose(on_grid, 1000 * 0.5**3, rtol=1e-6)


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_splines_are_a_partition_of_unity(real):
    f = np.linspace(0.5, 1.5, 101, endpoint=False)
    t = transfer.types(real)

    @kernel(f"test_spline_{real.__name__}")
    def evaluate(f: wp.array(dtype=real), out: wp.array(dtype=t.vec3)):
        out[wp.tid()] = spline(f[wp.tid()])

    out = wp.zeros(len(f), dtype=t.vec3, device="cpu")
    wp.launch(evaluate, len(f), [wp.array(f, dtype=real, device="cpu")], [out], device="cpu")
    w = out.numpy()
    assert np.abs(w.sum(axis=1) - 1).max() < 3e-7
    assert np.abs(w @ [0, 1, 2] - f).max() < 3e-7
    assert w.min() >= 0


@pytest.mark.parametrize(("precision", "form"), FORMS)
def test_scatter_then_gather_reproduces_linear_velocities(rng, precision, form):
    x, gradient = block(), rng.normal(size=(3, 3))
    v = x @ gradient.T + [1, 2, 3]
    C = np.broadcast_to(gradient, (len(x), 3, 3))
    s = solver(x, v=v, C=C, precision=precision, simd=form)
    s.step(0.0, 0.0)
    limit = 1e-12 if precision == "float64" else 2e-5
    assert np.abs(s.state.v.numpy() - v).max() < limit
    assert np.abs(s.state.C.numpy() - gradient).max() < 20 * limit


def test_simd_rows_and_plain_loops_are_one_algorithm(rng):
    x, v = block(), rng.normal(size=(512, 3))
    runs = []
    for form in (True, False):
        s = solver(x, v=v, forces=[Gravity()], boundaries=[Ground(height=0.7)], simd=form)
        s.advance(0.1)
        runs.append(s.state.x.numpy())
    assert s.model.form == "plain"
    assert np.abs(runs[0] - runs[1]).max() < 1e-5
    assert transfer.scatter_rows is not transfer.scatter


def test_two_slabs_one_after_the_other_do_as_one(rng):
    x, v = block(16), rng.normal(size=(4096, 3))

    def run(threads: int) -> np.ndarray:
        walls = [Ground(height=0.7), HalfSpace(point=(0, 0.3, 1), normal=(0, -1, 0))]
        s = solver(
            x[np.argsort(x[:, 0])],
            v=v,
            forces=[Gravity()],
            boundaries=walls,
            dx=DX / 2,
            threads=threads,
        )
        for _ in range(40):
            s.step(2e-3, 2e-3)
        return s.state.x.numpy()

    assert np.abs(run(2) - run(1)).max() < 1e-5


def test_each_thread_measures_its_own_particles(rng):
    """Both threads determine the limits of the substep, each for half of the particles."""
    v = rng.normal(size=(4096, 3))
    runs = {threads: solver(block(16), v=v, dx=DX / 2, threads=threads) for threads in (1, 2)}
    for s in runs.values():
        s.clock.ceiling = 2e-3
        s.advance(0.02)
        assert all("measure" in worker.timings for worker in s.workers)
    single, two = (np.array(s.clock.extremes) for s in runs.values())
    np.testing.assert_allclose(single, two, rtol=1e-4)
    maxima = [Maxima.of(part.maxima.numpy()) for part in runs[2].slabs.parts]
    assert maxima[0].upper[0] < maxima[1].upper[0]


def test_the_second_thread_ends_with_the_frame():
    before = threading.active_count()
    s = solver(block(16), dx=DX / 2, threads=2)

    def stop() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        s.advance(0.1, after=stop)
    assert threading.active_count() == before
    s.advance(0.1)
    assert threading.active_count() == before


def test_fault_of_the_second_thread_is_raised(monkeypatch):
    before = threading.active_count()
    s = solver(block(16), dx=DX / 2, threads=2)

    def fail(phase: int) -> None:
        raise OSError("out of luck")

    for _ in range(20):  # the threads part at another place each time
        with monkeypatch.context() as patched:
            patched.setattr(s.workers[1], "run", fail)
            with pytest.raises(OSError, match="out of luck"):
                s.advance(s.clock.time + 0.01)
        assert threading.active_count() == before
        s.advance(s.clock.time + 0.01)


def test_particle_force_is_newtons_on_each_particle():
    x = block(4)
    s = solver(x, forces=[ParticleForce(f=(0.001, 0, 0))])
    s.advance(0.1)
    a = 0.001 / (1000 * 0.5**3 / len(x))
    assert np.allclose(s.state.x.numpy() - x, [a * 0.1**2 / 2, 0, 0], atol=1e-5)


def test_total_force_does_not_depend_on_the_particle_count():
    moves = []
    for n in (4, 8):
        s = solver(block(n), forces=[TotalForce(f=(50.0, 0, 0))])
        s.advance(0.1)
        moves.append((s.state.x.numpy() - s.model.rest).mean(axis=0))
    assert np.allclose(moves[0], [50 / 125 * 0.1**2 / 2, 0, 0], atol=1e-5)
    assert np.allclose(moves[0], moves[1], atol=1e-5)


def test_a_force_on_a_region_spares_the_rest():
    region = Region(lower=(0, -9, -9))
    x = np.concatenate([block() - [2, 0, 0], block() + [2, 0, 0]])
    s = solver(x, forces=[Acceleration(a=(0, 1.0, 0), region=region)])
    s.advance(0.1)
    moved = (s.state.x.numpy() - x)[:, 1]
    assert np.abs(moved[:512]).max() < 1e-6
    assert np.allclose(moved[512:], 0.005, atol=1e-5)


def test_a_force_acts_only_in_its_window_of_time():
    s = solver(block(), forces=[Acceleration(a=(1.0, 0, 0), start=0.1, end=0.2)])
    s.advance(0.3)
    v = s.state.v.numpy()[:, 0]
    assert np.abs(v - 0.1).max() < 2 * 0.02 * s.clock.last_dt / 0.02


def test_set_velocity_translates():
    s = solver(block(), forces=[SetVelocity(v=(0, 0.5, 0))])
    s.advance(0.2)
    assert np.allclose(s.state.x.numpy() - s.model.rest, [0, 0.1, 0], atol=1e-4)


def test_a_region_without_particles_is_a_clear_error():
    with pytest.raises(ValueError, match=r"forces\.region = .*it holds no particle"):
        solver(block(), forces=[Acceleration(region=Region(lower=(5, 5, 5)))])


def test_the_window_follows_the_particles():
    s = solver(block(), v=np.tile([30.0, 0, 0], (512, 1)))
    s.advance(0.2)
    assert np.allclose(s.state.x.numpy() - s.model.rest, [6, 0, 0], atol=1e-4)
    assert s.grid.low[0] * DX > 4
    assert s.grid.count < 30**3


def test_a_boundary_out_of_reach_costs_no_launch():
    far = HalfSpace(point=(0, 0, -50.0))
    s = solver(block(), boundaries=[far])
    s.advance(0.01)
    assert "halfspace" not in s.timings


def test_launches_per_substep_are_those_the_scene_calls_for():
    bare = solver(block())
    bare.advance(0.05)
    others = {"measure", *HOST}
    counted = {name: count for name, (_, count) in bare.timings.items() if name not in others}
    assert set(counted) == {"clear", "p2g neo_hookean", "grid", "g2p neo_hookean"}
    assert set(counted.values()) == {bare.clock.substeps}
    walled = solver(block(), forces=[Gravity()], boundaries=[Ground(height=0.7)])
    walled.advance(0.05)
    assert set(walled.timings) - set(bare.timings) == {"ground"}


def test_a_particle_that_is_no_number_is_noticed_not_followed():
    s = solver(block())
    v = s.state.v.numpy().copy()
    v[7] = np.nan
    s.state.v.assign(v)
    with pytest.raises(Unstable, match="NaN or infinite"):
        s.advance(0.1)


def test_snapshot_and_restore_go_on_bit_for_bit(rng):
    s = solver(block(), v=rng.normal(size=(512, 3)), forces=[Gravity()])
    s.advance(0.05)
    kept = s.snapshot()
    s.advance(0.1)
    first = s.state.x.numpy().copy()
    s.restore(kept)
    s.advance(0.1)
    assert np.array_equal(s.state.x.numpy(), first)
