"""Cleaning, size, interior, volume and mass, against shapes whose volume is known."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from phy124.errors import InputError
from phy124.gaussians import Gaussians, join, quaternions
from phy124.generators.shapes import make_shape
from phy124.particles import (
    clean,
    compute_bounds,
    fill,
    find_solid,
    is_in_box,
    make_particles,
    scale_to_size,
    solid,
)
from phy124.particles.seeding import MAX_PARTICLES
from phy124.particles.solid import find_interior
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.repeated import REPEATED

BALL = math.pi / 6
SIDES = np.array([1, 0.7, 0.43])


def discs(centres, normals, radius):
    """Flat Gaussians that face along `normals`."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    u = np.cross(normals, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    axes = np.stack([u, np.cross(normals, u), normals], axis=-1)
    n = len(centres)
    scales = np.tile([radius, radius, 0.05 * radius], (n, 1))
    return Gaussians.from_rgb(
        centres, quaternions(axes), scales, np.full(n, 0.9), np.full((n, 3), 0.5)
    )


def dots(centres, sigma):
    n = len(centres)
    quats = np.tile([1, 0, 0, 0], (n, 1))
    scales = np.full((n, 3), sigma)
    return Gaussians.from_rgb(centres, quats, scales, np.full(n, 0.5), np.full((n, 3), 0.5))


def directions(n, rng):
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def ball(n, rng):
    """The surface of a ball of diameter 1 off the origin."""
    d = directions(n, rng)
    return discs(0.5 * d + [0.31, -0.17, 0.4], d, 0.5 * math.sqrt(4 * math.pi / n))


def box(n, rng):
    """The surface of a box of sides SIDES off the origin."""
    areas = SIDES[[1, 0, 0]] * SIDES[[2, 2, 1]]
    axis, sign = rng.choice(3, n, p=areas / areas.sum()), rng.choice([-1, 1], n)
    x, normals = (rng.random((n, 3)) - 0.5) * SIDES, np.zeros((n, 3))
    x[range(n), axis] = sign * SIDES[axis] / 2
    normals[range(n), axis] = sign
    return discs(x + 0.123, normals, math.sqrt(2 * areas.sum() / n))


def cloud(n, rng):
    """A filled ball of diameter 1."""
    centres = 0.5 * directions(n, rng) * rng.random((n, 1)) ** (1 / 3)
    return dots(centres, 0.35 * (4.19 / n) ** (1 / 3))


def nearest(points, others):
    return KDTree(others).query(points)[0]


SHAPES = {"ball": (ball, BALL), "box": (box, SIDES.prod()), "cloud": (cloud, BALL)}


@pytest.mark.parametrize(
    "make",
    [pytest.param(ball, id="ball"), pytest.param(box, id="box", marks=pytest.mark.slow)],
)
def test_the_object_is_the_same_on_every_grid(make, rng):
    gaussians = make(20_000, rng)
    result = [make_particles(gaussians, density=1, spacing=1 / n) for n in (24, 33, 48, 80)]
    masses = [p.mass.sum() for p in result]
    np.testing.assert_allclose(masses, masses[0], rtol=1e-6)
    middles = [p.mass @ p.x / p.mass.sum() for p in result]
    assert np.abs(np.array(middles) - middles[-1]).max() < 1e-3


@pytest.mark.parametrize("cells", [6, 16, 23.7, 64])
@pytest.mark.parametrize("name", SHAPES)
def test_volume_is_right_to_three_percent_at_every_resolution(name, cells, rng):
    make, volume = SHAPES[name]
    assert find_solid(make(20_000, rng), 1 / cells).volume == pytest.approx(volume, rel=0.03)


@pytest.mark.parametrize("size", [1e-6, 1e3])
@pytest.mark.parametrize("name", ["ball", "box"])
def test_a_micrometre_and_a_kilometre_weigh_what_they_should(name, size, rng):
    make, volume = SHAPES[name]
    gaussians = make(3000, rng).transform(size, np.zeros(3))
    for binding in ("particles", "lattice"):
        particles = make_particles(gaussians, density=700, spacing=size / 20, binding=binding)
        assert particles.mass.sum() == pytest.approx(700 * volume * size**3, rel=0.03)
        assert (particles.volume > 0).all()


def test_gaps_are_sealed_and_half_shells_are_closed(rng):
    whole = ball(20_000, rng)
    up = whole.means - [0.31, -0.17, 0.4]
    holed = whole.select(np.linalg.norm(up[:, :2], axis=1) > 0.045)
    sparse = whole.select(rng.random(20_000) < 0.2)
    half = whole.select(up[:, 2] > 0)
    assert find_solid(holed, 1 / 32).volume == pytest.approx(BALL, rel=0.03)
    assert find_solid(sparse, 1 / 32).volume == pytest.approx(BALL, rel=0.03)
    assert find_solid(half, 1 / 32).volume == pytest.approx(BALL / 2, rel=0.05)


def test_a_hollow_with_thick_walls_stays_open(rng):
    """A cup: outer cylinder, inner cylinder 0.1 further in, floor 0.1, open above."""

    def wall(radius, bottom):
        turn, z = rng.random(8000) * 2 * np.pi, bottom + rng.random(8000) * (1 - bottom)
        normal = np.stack([np.cos(turn), np.sin(turn), 0 * z], axis=1)
        return normal * radius + z[:, None] * [0, 0, 1], normal

    def plate(inner, outer, height):
        turn, r = rng.random(8000) * 2 * np.pi, np.sqrt(rng.uniform(inner**2, outer**2, 8000))
        centres = np.stack([r * np.cos(turn), r * np.sin(turn), 0 * r + height], axis=1)
        return centres, np.tile([0, 0, 1.0], (8000, 1))

    parts = [wall(0.5, 0), wall(0.4, 0.1), plate(0, 0.5, 0), plate(0, 0.4, 0.1)]
    parts.append(plate(0.4, 0.5, 1))
    cup = discs(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]), 0.02)
    volume = math.pi * (0.25 - 0.16 * 0.9)
    assert find_solid(cup, 1 / 40).volume == pytest.approx(volume, rel=0.05)
    assert not is_in_box(fill(cup, 1 / 40), [-0.25, -0.25, 0.2], [0.25, 0.25, 1]).any()


def test_fillers_are_the_regular_lattice_inside(rng):
    spacing = 1 / 20
    points = fill(ball(5000, rng), spacing)
    cells = points / spacing - 0.5
    assert np.abs(cells - cells.round()).max() < 1e-9
    assert len(np.unique(cells.round(), axis=0)) == len(points)
    radius = np.linalg.norm(points - [0.31, -0.17, 0.4], axis=1)
    assert radius.max() < 0.5 + 0.3 * spacing
    assert len(points) == pytest.approx(BALL / spacing**3, rel=0.03)


def test_particles_are_gaussians_and_spaced_fillers(rng):
    gaussians = ball(4000, rng)
    particles = make_particles(gaussians, density=1000, spacing=0.05, binding="particles")
    selected = particles.gaussian >= 0
    assert np.array_equal(np.sort(particles.gaussian[selected]), np.arange(4000))
    assert np.array_equal(particles.x[selected], gaussians.means[particles.gaussian[selected]])
    fillers = particles.x[~selected]
    gaps = nearest(fillers, gaussians.means)
    assert len(fillers) > 2000
    assert gaps.min() >= 0.5 * 0.05 - 1e-6
    deep = np.linalg.norm(particles.x - [0.31, -0.17, 0.4], axis=1) < 0.4
    assert np.allclose(particles.volume[deep], 0.05**3, rtol=1e-5)


def test_neighbours_in_memory_are_neighbours_in_space(rng):
    particles = make_particles(ball(4000, rng), density=1000, spacing=0.05)
    steps = np.linalg.norm(np.diff(particles.x, axis=0), axis=1)
    shuffled = np.linalg.norm(np.diff(rng.permutation(particles.x), axis=0), axis=1)
    assert np.median(steps) < 0.2 * np.median(shuffled)


def test_the_order_of_the_gaussians_does_not_matter(rng):
    gaussians = box(3000, rng)
    order = rng.permutation(3000)
    single, two = (
        make_particles(some, density=1000, spacing=0.04, binding="particles")
        for some in (gaussians, gaussians.select(order))
    )
    volume = np.empty(3000), np.empty(3000)
    volume[0][single.gaussian[single.gaussian >= 0]] = single.volume[single.gaussian >= 0]
    volume[1][order[two.gaussian[two.gaussian >= 0]]] = two.volume[two.gaussian >= 0]
    assert np.allclose(*volume, rtol=1e-4, atol=0)


def test_thin_pieces_get_denser_carriers_not_fillers(rng):
    flat = (rng.random((3000, 3)) - 0.5) * [1, 1, 0]
    sheet = discs(flat, np.tile([0, 0, 1.0], (3000, 1)), 0.03)
    stem = dots(np.linspace([0, 0, -1], [0, 0, 0], 200), 0.01)
    both = Gaussians(
        *(
            np.concatenate([getattr(g, f) for g in (sheet, stem)])
            for f in ("means", "quats", "scales", "opacities", "sh")
        )
    )
    particles = make_particles(both, density=1000, spacing=0.05, binding="lattice")
    assert (particles.gaussian == -1).all()
    assert nearest(both.means, particles.x).max() <= math.sqrt(3) * 0.025
    assert 1200 < len(particles) < 1700
    assert len(fill(sheet, 0.05)) == 0


def test_part_three_cells_wide_has_only_lattice_particles():
    """Denser particles there made a pressed duck err by up to two fifths more."""
    box = make_shape("box", (1, 1, 0.3), (0.5, 0.5, 0.5))
    spacing = 0.05
    particles = make_particles(box, density=1000, spacing=spacing, binding="lattice")
    assert len(particles) < 1.05 * len(fill(box, spacing))


def test_field_has_one_particle_per_lattice_cell(rng):
    gaussians = ball(5000, rng)
    particles = make_particles(gaussians, density=1000, spacing=0.05, binding="lattice")
    assert nearest(gaussians.means, particles.x).max() <= 0.05 + 1e-6
    assert len(np.unique(np.floor(particles.x / 0.05), axis=0)) == len(particles)
    assert np.ptp(particles.volume) < 2.5 * 0.05**3


@settings(REPEATED, max_examples=4)
@given(
    n=st.integers(1, 12),
    rank=st.integers(0, 3),
    sigma=st.floats(-9, 1),
    spacing=st.floats(-1.5, 1),
    seed=st.integers(0, 99),
)
def test_any_points_make_finite_positive_particles(n, rank, sigma, spacing, seed):
    rng = np.random.default_rng(seed)
    centres = rng.random((n, 3)) * (np.arange(3) < rank)
    gaussians = dots(centres, 10.0**sigma)
    assume(10.0 ** (sigma - spacing) < 4)
    volume = find_solid(gaussians, 10.0**spacing).volume
    for binding in ("particles", "lattice"):
        p = make_particles(gaussians, density=1, spacing=10.0**spacing, binding=binding)
        assert len(p) >= 1 and (p.volume > 0).all() and np.isfinite(p.mass).all()
        assert p.volume.sum() == pytest.approx(volume)


def clump(middle, rng, *, count=30, opacity=0.12) -> Gaussians:
    """Faint small Gaussians in one place."""
    near = middle + 0.02 * rng.normal(size=(count, 3))
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    faint = np.full(count, opacity)
    return Gaussians.from_rgb(near, quats, np.full((count, 3), 0.008), faint, np.ones((count, 3)))


def test_faint_floaters_are_no_part_of_the_object(rng):
    """Each clump has more than a thousandth of all Gaussians and shows much less."""
    good = ball(20_000, rng)
    places = [0.31, -0.17, 0.4] + directions(25, rng) * rng.uniform(0.8, 1.4, (25, 1))
    kept, cleaning = clean(join([good, *(clump(place, rng) for place in places)]))
    assert (cleaning.stray, len(kept)) == (750, 20_000)
    assert 25 <= cleaning.pieces < 30
    assert f"{cleaning.pieces} separate pieces" in cleaning.notes[0]
    opaque = [clump(place, rng, count=90, opacity=0.95) for place in places]
    assert clean(join([good, *opaque]))[1].stray == 0, "what shows is a part of it"


def test_report_notes_pieces_that_were_left_out(rng):
    far = clump([1.4, 0, 0], rng, count=2, opacity=0.9)
    scene = Scene.named("drop").replaced({"accuracy": {"cells": 8}, "time.frames": 1})
    run = Simulation(prepare(join([ball(4000, rng), far]), scene))
    (note,) = [note for note in run.run().report["notes"] if "left out" in note]
    assert "1 separate piece was left out (2 of 4002 Gaussians)" in note


def test_object_of_many_separate_pieces_is_complete(rng):
    places = np.argwhere(np.ones((11, 11, 11)))
    pieces = [clump(place, rng, count=10, opacity=0.95) for place in places]
    assert clean(join(pieces))[1].dropped == 0


def test_a_wide_sky_does_not_make_strays_of_the_object(rng):
    """Its Gaussians are as large as the object, and ten thousand times as visible."""
    ways = rng.normal(size=(4000, 3))
    ways *= 30 / np.linalg.norm(ways, axis=1, keepdims=True)
    quats = np.tile([1.0, 0, 0, 0], (4000, 1))
    around = Gaussians.from_rgb(
        ways, quats, np.ones((4000, 3)), np.full(4000, 0.95), np.ones((4000, 3))
    )
    kept, cleaning = clean(join([ball(12_000, rng), around]))
    assert (cleaning.stray, len(kept)) == (0, 16_000)


def test_clean_counts_what_it_drops_and_repairs(rng):
    good = ball(3000, rng)
    means, quats, scales = good.means.copy(), good.quats.copy(), good.scales.copy()
    opacities, sh = good.opacities.copy(), good.sh.copy()
    means[0, 1], quats[1, 0], scales[2, 2], opacities[3], sh[4, 0, 0] = (
        np.nan,
        np.inf,
        *[np.nan] * 3,
    )
    opacities[5:7] = 0, 0.003
    scales[7] = 0
    scales[8] = 5
    means[9:11] = [[40, 0, 0], [1e30, 0, 0]]
    quats[11] = 0
    scales[12, 0] *= -1
    scales[13, 2] = 0
    opacities[14] = 3
    quats[15] *= 7
    kept, cleaning = clean(Gaussians(means, quats, scales, opacities, sh))
    assert (cleaning.not_finite, cleaning.invisible, cleaning.gigantic) == (5, 3, 1)
    assert (cleaning.beyond, cleaning.stray) == (1, 1)
    assert (cleaning.dropped, cleaning.kept) == (11, 2989)
    repaired = cleaning.repaired_scales, cleaning.repaired_quats, cleaning.repaired_opacities
    assert repaired == (2, 1, 1)
    assert len(kept) == 2989
    assert np.array_equal(kept.means[-2900:], good.means[-2900:])
    assert np.abs(np.linalg.norm(kept.quats, axis=1) - 1).max() < 1e-6
    assert (kept.scales > 0).all() and kept.opacities.max() <= 1
    assert "5 of 3000 Gaussians had NaN or infinite values and were dropped." in cleaning.sentences
    assert len(cleaning.sentences) == 8


def test_clean_leaves_good_objects_alone(rng, three_gaussians):
    for gaussians in (
        three_gaussians,
        ball(1500, rng),
        box(20_000, rng),
        dots(np.zeros((9, 3)), 1),
    ):
        kept, cleaning = clean(gaussians)
        assert cleaning.sentences == [] and len(kept) == len(gaussians)
        assert np.array_equal(kept.quats, gaussians.quats)


def test_clean_refuses_an_object_of_nothing(three_gaussians):
    nothing = dots(np.full((4, 3), np.nan), 1)
    vast = dots(np.arange(12.0).reshape(4, 3), 1e30)
    for gaussians in (nothing, vast, three_gaussians.select(np.zeros(3, bool))):
        with pytest.raises(InputError, match=r"finite, visible and within 1e\+18 m"):
            clean(gaussians)


@pytest.mark.parametrize("faint", [0.0, 0.5, 0.999])
def test_bounds_leave_out_a_thousandth_of_the_opacity(rng, faint):
    """However many of the outermost are faint: the few lowest may not weigh enough."""
    gaussians = box(5000, rng)
    gaussians.opacities[gaussians.means[:, 0] < 2 * faint - 1] = 1e-6
    result = np.array(compute_bounds(gaussians))
    reach = np.sqrt(np.einsum("nii->ni", gaussians.covariances()))
    for axis in range(3):
        for sign, edge in ((1, result[0, axis]), (-1, result[1, axis])):
            ends = sign * gaussians.means[:, axis].astype(float) - reach[:, axis]
            order = np.argsort(ends)
            below = np.cumsum(gaussians.opacities[order].astype(float))
            first = np.flatnonzero(below > 1e-3 * below[-1])[0]
            assert edge == pytest.approx(sign * ends[order[first]], rel=1e-9)


def test_to_size_sets_the_longest_side_and_the_ground(rng):
    gaussians = box(40_000, rng).transform(37.0, np.array([5.0, 6, 7]))
    sized = scale_to_size(gaussians, 2.0)
    low, high = compute_bounds(sized)
    assert high - low == pytest.approx(2 * SIDES, rel=0.03)
    assert (high - low).max() == pytest.approx(2)
    assert (low + high)[:2] == pytest.approx([0, 0], abs=1e-6)
    assert low[2] == pytest.approx(0, abs=0.02)
    reach = np.sqrt(sized.covariances()[:, 2, 2])
    assert (sized.means[:, 2] - reach).min() == pytest.approx(0, abs=1e-5)
    growth = sized.scales / gaussians.scales
    assert np.ptp(growth) < 1e-6 * growth[0, 0]
    low, high = compute_bounds(scale_to_size(gaussians, 2.0, ground=False))
    assert low == pytest.approx(-high, abs=1e-6)
    first = scale_to_size(dots(np.ones((1, 3)), 4), 1.0)
    assert first.scales[0] == pytest.approx([0.5] * 3)
    assert first.means[0] == pytest.approx([0, 0, 0.5], abs=1e-6)


def test_refusals_say_what_to_do(rng):
    gaussians = ball(500, rng)
    with pytest.raises(InputError, match=r"density = 0: it must be a positive number"):
        make_particles(gaussians, density=0, spacing=0.1)
    with pytest.raises(InputError, match=r"spacing = nan: it must be"):
        make_particles(gaussians, density=1, spacing=math.nan)
    with pytest.raises(InputError, match=r"binding = glue: .* lattice and particles"):
        make_particles(gaussians, density=1, spacing=0.1, binding="glue")
    with pytest.raises(InputError, match=rf"limit is {MAX_PARTICLES:,}.* coarser grid"):
        make_particles(gaussians, density=1, spacing=1e-3)
    with pytest.raises(InputError, match=r"size = -1: the length of the longest side"):
        scale_to_size(gaussians, -1)


def test_more_gaussians_than_samples_have_an_interior(monkeypatch):
    monkeypatch.setattr(solid, "MAX_SAMPLES", 20_000)
    shell = dots(0.5 * directions(30_000, np.random.default_rng(0)), 1e-4)
    assert find_solid(shell, 1 / 32).volume == pytest.approx(BALL, rel=0.1)
    assert len(solid._voxelise(shell).means) == 10_000, "each has a sample, and as many are left"


def test_the_same_gaussians_outline_the_same_solid_only_once(rng, monkeypatch):
    same, other = (dots(rng.random((60, 3)), 0.05) for _ in range(2))
    first = find_interior(same)
    monkeypatch.setattr(solid, "_voxelise", lambda some: pytest.fail("it is known"))
    assert find_interior(dots(same.means.copy(), 0.05)) is first
    monkeypatch.undo()
    monkeypatch.setattr(solid, "MEMORY", 2)
    assert find_interior(other) is not first
    for count in range(solid.MEMORY + 1):
        find_interior(dots(rng.random((60 + count, 3)), 0.05))
    assert len(solid._kept) == solid.MEMORY and first not in solid._kept.values()
    with pytest.raises(ValueError, match="read-only"):
        first.fraction[:] = 0
