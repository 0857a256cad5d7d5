"""Frames from particle states, against the paper's Sigma_t = F Sigma_0 F^T and affine motions."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions, rotation_matrices, sh_basis
from phy124.kernels import deform
from phy124.motion.deform import Deformer
from phy124.particles import make_particles
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.repeated import REPEATED
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

IDENTITY = np.eye(3)


def random_gaussians(n, rng, thinnest=-2.0, degree=0):
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = 10 ** rng.uniform(thinnest, 0, (n, 3))
    sh = rng.normal(size=(n, (degree + 1) ** 2, 3)) * 0.2
    return Gaussians(rng.random((n, 3)), quats, scales, rng.random(n), sh)


def rotations(n, rng):
    q = rng.normal(size=(n, 4))
    return rotation_matrices(q)


def moved(gaussians, F, deformer=None):
    """Frame of the Gaussians under F [N,3,3] or [3,3] about the origin."""
    F = np.broadcast_to(F, (len(gaussians), 3, 3))
    x = np.einsum("nij,nj->ni", F, gaussians.means.astype(float))
    return (deformer or Deformer(gaussians))(x, F, index=1, time=0.1).gaussians


def covariance_error(result, gaussians, F):
    """Largest error of Sigma relative to its own size."""
    wanted = F @ gaussians.covariances() @ np.swapaxes(F, -1, -2)
    size = np.linalg.norm(wanted, axis=(1, 2))
    return (np.linalg.norm(result.covariances() - wanted, axis=(1, 2)) / size).max()


def turns(quats, others):
    """Angles between orientations [N], degrees."""
    dots = np.abs((quats.astype(float) * others).sum(axis=1))
    return np.degrees(2 * np.arccos(np.minimum(dots, 1)))


@pytest.fixture
def gaussians(rng):
    return random_gaussians(2000, rng)


def test_the_first_frame_is_the_object_at_rest(gaussians, rng):
    at_rest = moved(gaussians, IDENTITY)
    assert np.array_equal(at_rest.means, gaussians.means)
    assert np.array_equal(at_rest.scales, gaussians.scales)
    assert np.abs(at_rest.quats - gaussians.quats).max() < 1e-7
    colourful = random_gaussians(50, rng, degree=3)
    assert np.array_equal(moved(colourful, IDENTITY).sh, colourful.sh)


@pytest.mark.parametrize("kind", ["near", "any", "mirrored", "cond 1e4", "flat", "line"])
def test_covariance_is_the_papers_for_every_f(kind, gaussians, rng):
    n = len(gaussians)
    stretch = 10 ** rng.uniform(-4, 0, (n, 1, 3))
    F = {
        "near": IDENTITY + 0.1 * rng.normal(size=(n, 3, 3)),
        "any": rng.normal(size=(n, 3, 3)),
        "mirrored": rotations(n, rng) * [1, 1.2, -0.5] @ rotations(n, rng),
        "cond 1e4": rotations(n, rng) * stretch @ rotations(n, rng),
        "flat": rotations(n, rng) * [1, 0.5, 0] @ rotations(n, rng),
        "line": rotations(n, rng) * [2, 0, 0] @ rotations(n, rng),
    }[kind]
    result = moved(gaussians, F)
    assert covariance_error(result, gaussians, F) < 1e-5
    assert (result.scales >= 0).all() and np.isfinite(result.scales).all()
    assert np.abs(np.linalg.norm(result.quats, axis=1) - 1).max() < 1e-6


def test_scales_are_the_papers_eigenvalues(gaussians, rng):
    """Sigma = Q Lambda Q^T, S = Lambda^(1/2), where eigh is accurate: no thin Gaussians."""
    round_ones = random_gaussians(500, rng, thinnest=-0.7)
    F = IDENTITY + 0.2 * rng.normal(size=(500, 3, 3))
    values, axes = np.linalg.eigh(F @ round_ones.covariances() @ np.swapaxes(F, 1, 2))
    result = moved(round_ones, F)
    order = np.argsort(result.scales, axis=1)
    scales = np.take_along_axis(result.scales, order, axis=1)
    assert scales == pytest.approx(np.sqrt(values), rel=2e-5)
    columns = np.take_along_axis(rotation_matrices(result.quats), order[:, None], axis=2)
    aligned = np.abs(np.einsum("nij,nij->nj", columns, axes))
    apart = (np.diff(np.sqrt(values), axis=1) > 0.05 * np.sqrt(values[:, 1:])).all(axis=1)
    assert aligned[apart].min() > 1 - 1e-6


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e3])
def test_needles_and_sheets_of_every_size_keep_their_thin_axes(size, rng):
    quats = rng.normal(size=(300, 4))
    shapes = np.array([[1, 1e-4, 1e-4], [1, 1, 1e-2], [1, 1, 1]]) * size
    scales = shapes[rng.integers(0, 3, 300)]
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    thin = Gaussians.from_rgb(np.zeros((300, 3)), quats, scales, np.ones(300), np.ones((300, 3)))
    assert moved(thin, IDENTITY).scales == pytest.approx(thin.scales, rel=1e-6)
    spun = moved(thin, rotations(300, rng))
    assert np.sort(spun.scales) == pytest.approx(np.sort(thin.scales), rel=1e-5)


def test_collapse_keeps_the_orientation_and_recovers(gaussians):
    deformer = Deformer(gaussians)
    gone = moved(gaussians, 0 * IDENTITY, deformer)
    assert (gone.scales == 0).all()
    assert turns(gone.quats, gaussians.quats).max() < 0.1
    back = moved(gaussians, IDENTITY, deformer)
    assert covariance_error(back, gaussians, IDENTITY) < 1e-5


def test_orientations_are_continuous_along_smooth_motions(rng):
    """Fast spin and large strain: numerics case 24."""
    gaussians = random_gaussians(400, rng, thinnest=-1.0)
    deformer = Deformer(gaussians)
    spin, strain = rng.normal(size=(2, 400, 3, 3))
    spin = 0.5 * (spin - np.swapaxes(spin, 1, 2))
    F, last = np.broadcast_to(IDENTITY, (400, 3, 3)), gaussians
    for k in range(80):
        step = 0.15 * spin + 0.1 * np.sin(0.3 * k) * strain
        F = F + step @ F + 0.5 * step @ step @ F
        result = moved(gaussians, F, deformer)
        assert covariance_error(result, gaussians, F) < 1e-5
        assert (result.quats * last.quats).sum(axis=1).min() >= 0
        assert turns(result.quats, last.quats).max() < 63  # no turn of a cube is farther than 62.8
        last = result


def test_a_slow_spin_is_followed_exactly(gaussians):
    """Six turns in steps of 10 degrees: the quaternion goes on, it does not jump or relabel."""
    deformer, last = Deformer(gaussians), gaussians
    for k in range(1, 217):
        a = np.radians(10 * k)
        spin = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        result = moved(gaussians, spin, deformer)
        assert np.abs(turns(result.quats, last.quats) - 10).max() < 0.1
        assert np.allclose(result.scales, gaussians.scales, rtol=1e-5)
        last = result


@pytest.mark.parametrize("scales", [[1, 1, 1], [1, 1, 0.01], [1, 0.01, 0.01]])
def test_equal_axes_do_not_flicker(scales, rng):
    """Rounding noise of a float32 solver, spheres, discs and needles: axes stay where they are."""
    n = 500
    shapes = np.tile(scales, (n, 1))
    still = Gaussians.from_rgb(
        np.zeros((n, 3)), rng.normal(size=(n, 4)), shapes, np.ones(n), np.ones((n, 3))
    )
    still = moved(still, IDENTITY)
    deformer = Deformer(still)
    for _ in range(20):
        noise = 3e-7 * rng.uniform(-1, 1, size=(n, 3, 3))
        result = moved(still, IDENTITY + noise, deformer)
        assert turns(result.quats, still.quats).max() < 0.1


@settings(REPEATED, max_examples=40)
@given(entries=st.lists(st.floats(-1e4, 1e4, width=32), min_size=9, max_size=9))
def test_any_finite_f_gives_a_finite_frame(entries):
    gaussians = random_gaussians(20, np.random.default_rng(5), thinnest=-4)
    F = np.reshape(entries, (3, 3))
    result = moved(gaussians, F)
    assert np.isfinite(result.quats).all() and np.isfinite(result.scales).all()
    assert np.linalg.norm(result.quats, axis=1) == pytest.approx(np.ones(20), abs=1e-6)
    wanted = F @ gaussians.covariances() @ F.T
    error = np.abs(result.covariances() - wanted).max(axis=(1, 2))
    assert (error <= 1e-5 * np.abs(wanted).max(axis=(1, 2)) + 1e-75).all()


def test_max_stretch_limits_spikes_only(gaussians):
    F = np.diag([100, 0.1, 0.1])
    longest = gaussians.scales.max(axis=1)
    held = moved(gaussians, F, Deformer(gaussians, max_stretch=4))
    assert (held.scales.max(axis=1) / longest).max() == pytest.approx(4)
    mild = moved(gaussians, np.diag([2, 0.7, 0.7]), Deformer(gaussians, max_stretch=4))
    assert np.array_equal(mild.scales, moved(gaussians, np.diag([2, 0.7, 0.7])).scales)
    assert moved(gaussians, F).scales.max() > 50


def test_colours_turn_with_the_material(rng):
    gaussians = random_gaussians(200, rng, degree=3)
    turn = rotations(200, rng)
    stretch = IDENTITY + 0.1 * (lambda s: s + np.swapaxes(s, 1, 2))(rng.normal(size=(200, 3, 3)))
    deformer = Deformer(gaussians)
    result = moved(gaussians, turn @ stretch, deformer)
    assert turns(deformer.rotations, quaternions(turn)).max() < 0.1
    view = np.array([[0.6, 0, 0.8]])
    before = np.einsum("nvk,nkc->nvc", sh_basis(view @ turn, 16), gaussians.sh)
    after = np.einsum("vk,nkc->nvc", sh_basis(view, 16), result.sh)
    assert np.abs(after - before).max() < 1e-4


def test_plain_colours_need_no_rotations(gaussians):
    deformer = Deformer(gaussians)
    moved(gaussians, 2 * IDENTITY, deformer)
    assert deformer.rotations is None


def affine(rng):
    return IDENTITY + 0.4 * rng.normal(size=(3, 3)), np.array([0.1, -0.2, 0.3])


def test_fluid_gaussians_stay_near_their_particles(rng):
    gaussians = random_gaussians(300, rng)
    particles = make_particles(gaussians, density=1000, spacing=0.07)
    x = particles.x.astype(float)

    def means(factor, flows):
        deformer = Deformer(gaussians, particles, flows=np.full(300, flows))
        F = np.tile(factor * IDENTITY, (len(x), 1, 1))
        return deformer(x, F, index=0, time=0).gaussians.means

    np.testing.assert_allclose(means(1.9, True), means(1.9, False), atol=5e-3)
    farther = np.linalg.norm(means(50.0, False) - means(2.0, False), axis=1)
    assert farther.max() > 1.0
    np.testing.assert_allclose(means(50.0, True), means(2.0, False), atol=5e-3)


@pytest.mark.parametrize("flows", [True, False])
def test_gaussians_of_mixed_fluid_fill_the_pool_like_its_particles(flows, rng):
    """A mean over scattered particles would lie in the middle, and leave a gap along the walls."""
    gaussians = random_gaussians(2000, rng)
    particles = make_particles(gaussians, density=1000, spacing=0.07)
    x, F = 10 * rng.random((len(particles), 3)), np.tile(IDENTITY, (len(particles), 1, 1))
    deformer = Deformer(gaussians, particles, flows=np.full(2000, flows))
    frame = deformer(x, F, index=0, time=0, velocities=x)
    means, speeds = frame.gaussians.means, frame.velocities
    beside_walls = (np.abs(means - 5) > 4.5).any(axis=1).mean()
    assert beside_walls == pytest.approx(1 - 0.9**3, abs=0.04) if flows else beside_walls < 0.1
    assert np.abs(speeds - means).max() < 0.2


@pytest.mark.parametrize("binding", ["particles", "lattice"])
def test_affine_motions_are_exact_for_both_bindings(binding, rng):
    centres = rng.random((600, 3)) * [1, 1, 0.2]
    gaussians = random_gaussians(600, rng)
    gaussians = Gaussians(
        centres, gaussians.quats, 0.05 * gaussians.scales, gaussians.opacities, gaussians.sh
    )
    particles = make_particles(gaussians, density=1000, spacing=0.07, binding=binding)
    deformer = Deformer(gaussians, particles)
    rest = deformer(particles.x, np.tile(IDENTITY, (len(particles), 1, 1)), index=0, time=0)
    assert rest.gaussians.means == pytest.approx(gaussians.means, abs=1e-7)
    for F in (
        rotations(1, rng)[0],
        np.array([[1, 0.8, 0], [0, 1, 0], [0, 0, 1.0]]),
        affine(rng)[0],
    ):
        x, shift = particles.x.astype(float), np.array([0.1, -0.2, 0.3])
        copies = np.tile(F, (len(x), 1, 1))
        frame = deformer(x @ F.T + shift, copies, index=3, time=0.5, velocities=x)
        wanted = centres @ F.T + shift
        assert np.abs(frame.gaussians.means - wanted).max() < 1e-5
        assert covariance_error(frame.gaussians, gaussians, F) < 1e-5
        assert (frame.index, frame.time) == (3, 0.5)
        assert frame.velocities is not None and frame.velocities.shape == (600, 3)
        if binding == "particles":
            assert frame.velocities == pytest.approx(centres, abs=1e-6)


def test_the_order_of_the_gaussians_does_not_matter(gaussians, rng):
    order, F = rng.permutation(2000), IDENTITY + 0.3 * rng.normal(size=(2000, 3, 3))
    result, shuffled = moved(gaussians, F), moved(gaussians.select(order), F[order])
    for name in ("means", "quats", "scales"):
        assert np.array_equal(getattr(result, name)[order], getattr(shuffled, name))


def test_refusals_say_what_is_wrong(gaussians, three_gaussians):
    with pytest.raises(InputError, match=r"max_stretch = 0.5: .* smaller than they are at rest"):
        Deformer(gaussians, max_stretch=0.5)
    with pytest.raises(ValueError, match="not made from these 2000 Gaussians"):
        other = make_particles(three_gaussians, density=1, spacing=0.1, binding="particles")
        Deformer(gaussians, other)
    deformer = Deformer(three_gaussians)
    F = np.tile(IDENTITY, (3, 1, 1))
    with pytest.raises(FloatingPointError, match="1 of 3 particles are NaN or infinite"):
        deformer(np.array([[np.nan, 0, 0], [0, 0, 0], [0, 0, 0]]), F, index=0, time=0)
    with pytest.raises(ValueError, match=r"\(2, 3\) for 3 particles"):
        deformer(np.zeros((2, 3)), F, index=0, time=0)


def test_axes_that_become_equal_do_not_flicker(rng):
    """Balls pressed along no axis of theirs: two equal axes, known from the last frame only."""
    n = 500
    balls = Gaussians.from_rgb(
        np.zeros((n, 3)), rng.normal(size=(n, 4)), np.ones((n, 3)), np.ones(n), np.ones((n, 3))
    )
    turn = rotations(n, rng)
    pressed = turn * [1.5, 1.5, 0.7] @ np.swapaxes(turn, 1, 2)
    deformer = Deformer(balls)
    last = moved(balls, pressed, deformer)
    for _ in range(20):
        noise = 3e-7 * rng.uniform(-1, 1, size=(n, 3, 3))
        result = moved(balls, pressed + noise, deformer)
        assert turns(result.quats, last.quats).max() < 0.1
        last = result


def test_torn_material_is_shown_stretched_as_far_as_it_can_hold(gaussians, rng):
    turn = rotations(1, rng)[0]
    limit = np.full(len(gaussians), 2.4)
    torn = turn @ np.diag([300.0, 0.2, 0.01])
    power = np.log(2.4) / np.log(300)
    seen = turn @ np.diag(np.array([300.0, 0.2, 0.01]) ** power)
    held = moved(gaussians, torn, Deformer(gaussians, holds=limit))
    wanted = seen @ gaussians.covariances() @ seen.T
    np.testing.assert_allclose(held.covariances(), wanted, rtol=1e-4, atol=1e-5 * wanted.max())
    longest = gaussians.scales.max(axis=1)
    assert (held.scales.max(axis=1) <= 2.4001 * longest).all()
    assert (moved(gaussians, torn).scales.max(axis=1) > 20 * longest).any()
    whole = np.diag([2.3, 1.5, 0.7])  # its norm is above the limit, its stretch is not
    same = moved(gaussians, whole, Deformer(gaussians, holds=limit))
    assert np.array_equal(same.scales, moved(gaussians, whole).scales)


def test_a_flattened_needle_stays_finite(gaussians):
    limit = np.full(len(gaussians), 2.4)
    F = np.diag([1e4, 1e-9, 0.0])
    held = moved(gaussians, F, Deformer(gaussians, holds=limit))
    assert np.isfinite(held.scales).all() and np.isfinite(held.quats).all()


def stretched_gaussians(count: int, rng) -> Gaussians:
    """Gaussians whose axes are up to a hundred thousand times as long as others."""
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales, grey = 10 ** rng.uniform(-5, 0, (count, 3)), np.full((count, 3), 0.5)
    return Gaussians.from_rgb(rng.random((count, 3)), quats, scales, rng.random(count), grey)


@pytest.mark.parametrize("count", [1, 8, 1003])
def test_eight_at_a_time_are_deformed_as_one_by_one(rng, count):
    """Gaussians of torn and of flowing material, needles, discs and points, with small and large
    rotations."""
    rest = stretched_gaussians(count, rng)
    rest.scales[::11, 1] = 0
    rest.scales[::13, 2] = 1e-20
    rest.scales[::23] = 0
    rest.scales[::5, 1] = rest.scales[::5, 0]
    holds = np.where(rng.random(count) < 0.2, 1.1, np.inf)
    limits = np.where(rng.random(count) < 0.3, 1.5, np.inf)
    balls = rng.random(count) < 0.3
    change = rng.normal(0, 0.4, (count, 3, 3))
    change[::7] *= 1e-3
    turned = np.where(rng.random(count) < 0.1, -1.0, 1.0)[:, None, None]
    results = []
    for kernel, each in ((deform.deform_shapes, 1), (deform.deform_shapes_simd, 8)):
        threads = -(-count // each)
        model = [
            wp.array(rest.quats, dtype=wp.vec4f),
            wp.array(rest.scales, dtype=wp.vec3f),
            wp.array(holds, dtype=wp.float64),
            wp.array(limits, dtype=wp.float64),
            wp.array(balls, dtype=wp.bool),
        ]
        still = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
        out = [wp.array(still, dtype=wp.vec4f), wp.array(rest.quats, dtype=wp.vec4f)]
        out.append(wp.zeros(count, dtype=wp.vec3f))
        frames = []
        for part in (0.3, 0.6, 1.0):
            F = turned * (np.eye(3) + part * change)
            inputs = [*model, wp.clone(out[1]), wp.array(F, dtype=wp.mat33d)]
            wp.launch(kernel, threads, inputs, out, device="cpu")
            frames.append([array.numpy().copy() for array in out])
        results.append(frames)
    for first, eight in zip(*results, strict=True):
        for name, a, b in zip(("inner", "quats", "scales"), first, eight, strict=True):
            np.testing.assert_allclose(b, a, rtol=3e-6, atol=3e-7, err_msg=name)


@pytest.mark.parametrize("binding", ["particles", "lattice"])
def test_state_stays_on_its_device(binding, monkeypatch):
    """A GPU's positions and F are checked and read there; the host gets only the shapes."""
    scene = Scene.named("press").replaced({"accuracy": {"cells": 6}, "binding": binding})
    run = Simulation(prepare(ball(300), scene))
    state, read, size = run.solver.state, wp.array.numpy, []
    monkeypatch.setattr(
        wp.array, "numpy", lambda array: size.append((array.ptr, array.capacity)) or read(array)
    )
    frame = run.deformer(state.x, state.deformation, index=0, time=0.0)
    assert not {state.x.ptr, state.deformation.ptr} & {ptr for ptr, _ in size}
    assert sum(count for _, count in size) == 300 * 4 * (3 + 4 + 3) + 2 * 4
    assert len(frame.gaussians) == 300
