"""Open vessels stay hollow, and open shells of solid objects are filled."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from phy124.generators.shapes import choose_triangles, cover_surface
from phy124.particles.solid import ACROSS, find_interior
from phy124.scene import Scene
from phy124.simulation.setup import prepare

COUNT = 20_000


def cover(mesh, count=COUNT):
    chosen, weights = choose_triangles(np.asarray(mesh.triangles), count, 0)
    points = np.einsum("nc,nci->ni", weights, mesh.triangles[chosen])
    return cover_surface(points, mesh.face_normals[chosen], np.ones(3))


def shifted(gaussians, noise, rng):
    means = gaussians.means + rng.normal(0, noise / ACROSS, gaussians.means.shape)
    return replace(gaussians, means=means.astype(np.float32))


def vessel(radius, height, wall):
    """Return a round vessel whose longest side is 1, with walls and a bottom of equal thickness."""
    outer, inner = [(0, 0), (radius, 0), (radius, height)], radius - wall
    profile = np.array([*outer, (inner, height), (inner, wall), (0, wall)])
    return trimesh.creation.revolve(profile, sections=48)


SHAPES = [(0.4, 1.0), (0.5, 0.5), (0.5, 0.12)]
TELLING = [(0.3, 0), (1, 1), (3.5, 2)]
"""Walls [voxels] and shapes that are tested by default."""


@pytest.mark.parametrize(
    ("voxels", "shape"),
    [
        pytest.param(
            voxels,
            shape,
            id=f"{voxels}-shape{index}",
            marks=[pytest.mark.slow] * ((voxels, index) not in TELLING),
        )
        for voxels in (0.3, 1, 2, 3.5)
        for index, shape in enumerate(SHAPES)
    ],
)
def test_vessels_stay_hollow(shape, voxels):
    mesh = vessel(*shape, voxels / ACROSS)
    assert find_interior(cover(mesh)).volume == pytest.approx(mesh.volume, rel=0.12)


@pytest.mark.parametrize(
    "voxels", [1, *(pytest.param(voxels, marks=pytest.mark.slow) for voxels in (2, 3))]
)
def test_noisy_vessel_stays_hollow(rng, voxels):
    mesh = vessel(0.4, 1.0, voxels / ACROSS)
    solid = find_interior(shifted(cover(mesh), 0.1, rng))
    assert solid.volume == pytest.approx(mesh.volume, rel=0.25)


def test_vessel_of_thick_gaussians_stays_hollow(rng):
    mesh = vessel(0.4, 1.0, 3 / ACROSS)
    flat = cover(mesh)
    scales = flat.scales * [1, 1, 3] * np.exp(rng.normal(0, 0.4, flat.scales.shape))
    solid = find_interior(replace(flat, scales=scales.astype(np.float32)))
    assert solid.volume == pytest.approx(mesh.volume, rel=0.25)


def test_narrow_parts_of_an_open_shell_are_filled():
    ring = cover(trimesh.creation.torus(0.43, 0.07))
    x, y, z = ring.means.T
    open_ring = ring.select((x < 0) | (np.abs(y) > 0.04) | (z > 0))
    volume = 2 * np.pi**2 * 0.43 * 0.07**2
    assert find_interior(open_ring).volume == pytest.approx(volume, rel=0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_ball_of_few_gaussians_is_filled(seed):
    normals = np.random.default_rng(seed).normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ball = cover_surface(normals / 2, normals, np.ones(3))
    ball = replace(ball, scales=np.tile(np.float32([0.06, 0.06, 0.015]), (300, 1)))
    assert find_interior(ball).volume == pytest.approx(np.pi / 6, rel=0.1)


def test_box_of_few_gaussians_without_a_front_is_filled():
    box = cover(trimesh.creation.box((1, 1, 1)), 2000)
    box = replace(box, scales=np.float32(0.7) * box.scales)
    assert find_interior(box.select(box.means[:, 0] < 0.48)).volume == pytest.approx(1, rel=0.05)


def hollow_ball(wall):
    radii = (0.5, 0.5 - wall)
    shells = [trimesh.creation.icosphere(4, radius) for radius in radii]
    volume = 4 / 3 * np.pi * (radii[0] ** 3 - radii[1] ** 3)
    return cover(trimesh.util.concatenate(shells)), volume


@pytest.mark.parametrize("wall", [0.03, pytest.param(0.1, marks=pytest.mark.slow)])
def test_closed_wall_with_two_sides_is_hollow(wall):
    ball, volume = hollow_ball(wall)
    assert find_interior(ball).volume == pytest.approx(volume, rel=0.05)


def test_user_chooses_whether_an_object_is_solid():
    ball, volume = hollow_ball(0.05)
    assert find_interior(ball, "solid").volume == pytest.approx(np.pi / 6, rel=0.02)
    assert find_interior(ball, "shell").volume == pytest.approx(volume, rel=0.05)
    cup = cover(vessel(0.4, 1.0, 2 / ACROSS))
    assert find_interior(cup, "solid").volume == pytest.approx(np.pi * 0.4**2, rel=0.05)


def test_filled_open_shell_causes_a_note():
    box = cover(trimesh.creation.box((1, 1, 1)), 2000)
    box = box.select(box.means[:, 2] < 0.48)
    scenes = [Scene.model_validate({"object": {"inside": inside}}) for inside in ("auto", "shell")]
    filled, shell = (prepare(box, scene) for scene in scenes)
    (note,) = filled.notes
    assert re.search(r"has openings. Its inside, 9\d%.* --set object.inside=shell", note)
    assert not shell.notes and shell.particles.mass.sum() < 0.1 * filled.particles.mass.sum()


def test_a_cage_is_empty():
    bars = []
    for axis, side in np.ndindex(3, 2):
        for place in np.linspace(-0.5, 0.5, 10):
            sides = np.roll([0.01, 0.01, 1], axis)
            centre = np.roll([side - 0.5, place, 0], axis)
            bars.append(trimesh.creation.box(sides).apply_translation(centre))
    mesh = trimesh.util.concatenate(bars)
    assert find_interior(cover(mesh)).volume < 0.03


@pytest.mark.parametrize("noise", [pytest.param(0, marks=pytest.mark.slow), 0.3])
@pytest.mark.parametrize(
    "name",
    ["ball", *(pytest.param(name, marks=pytest.mark.slow) for name in ("capsule", "box"))],
)
def test_shells_without_a_bottom_are_filled(rng, name, noise):
    mesh = {
        "ball": trimesh.creation.icosphere(4, 0.5),
        "capsule": trimesh.creation.capsule(0.6, 0.2),
        "box": trimesh.creation.box((1, 0.6, 0.5)),
    }[name]
    whole = cover(mesh)
    low = mesh.bounds[0, 2] + 0.15 * mesh.extents[2]
    shell = whole.select(whole.means[:, 2] > low)
    volume = trimesh.PointCloud(shell.means).convex_hull.volume
    assert find_interior(shifted(shell, noise, rng)).volume == pytest.approx(volume, rel=0.1)


@pytest.mark.parametrize("radius", [0.06, pytest.param(0.12, marks=pytest.mark.slow)])
def test_shell_with_a_sealed_knob_is_filled(radius):
    box = trimesh.creation.box((1, 1, 1))
    box.update_faces(box.face_normals[:, 2] > -0.5)
    knob = trimesh.creation.icosphere(3, radius).apply_translation((0, 0, 0.5 + radius))
    volume = 1 + 4 / 3 * np.pi * radius**3
    shell = cover(trimesh.util.concatenate([box, knob]))
    assert find_interior(shell).volume == pytest.approx(volume, rel=0.05)


def test_air_between_separate_walls_is_empty():
    walls = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            sides, centre = np.full(3, 0.3), np.zeros(3)
            sides[axis], centre[axis] = 0.02, side
            walls.append(trimesh.creation.box(sides).apply_translation(centre))
    mesh = trimesh.util.concatenate(walls)
    assert find_interior(cover(mesh)).volume == pytest.approx(mesh.volume, rel=0.2)


def test_both_sides_of_a_thin_plate_are_covered():
    plate = cover(trimesh.creation.box((1, 0.6, 0.002)))
    up = plate.means[:, 2] > 0
    assert up.mean() == pytest.approx(0.5, abs=0.02)
    apart = np.sqrt(1.2 / len(plate.means))
    assert np.median(plate.scales[:, 0]) == pytest.approx(0.75 * apart, rel=0.3)
