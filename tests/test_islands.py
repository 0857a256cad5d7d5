"""Separate pieces of an object move independently (phy124/particles/islands.py)."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import trimesh

from phy124.accuracy.promises import promise
from phy124.gaussians import Gaussians, join
from phy124.generators.shapes import choose_triangles, cover_surface
from phy124.io.clip import Clip
from phy124.particles.lattice import lattice_of
from phy124.particles.solid import find_interior
from phy124.particles.thickness import Proportions
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball


def balls(gap: float, radius: float = 0.25) -> Gaussians:
    """Return a ball of radius 0.25 m and another ball at a distance along y [m]."""
    shells = [ball(4000, 0.25), ball(4000, radius)]
    shift = np.array([0, 0.25 + gap + radius, 0], np.float32)
    return join([shells[0], replace(shells[1], means=shells[1].means + shift)])


def simulate(gaussians: Gaussians, scene: Scene) -> tuple[list[np.ndarray], dict]:
    """Return the positions of the first and the second half of the Gaussians [T,N/2,3], as in a
    saved clip, and the report.
    """
    clip = Simulation(prepare(gaussians, scene, RunContext(threads=1))).run()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "clip.safetensors"
        clip.save(path)
        means = np.array(Clip.load(path).means)
    return np.split(means, 2, axis=1), clip.report


@pytest.mark.parametrize(("solver", "gap", "error"), [("lattice", 0.02, 1e-3), ("mpm", 0.04, 0.06)])
def test_balls_close_together_fly_apart(solver, gap, error):
    changes = {"accuracy": {"cells": 16, "solver": solver}, "time.frames": 12}
    scene = Scene.named("spin").replaced(changes)
    halves, report = simulate(balls(gap), scene)
    first, second = (half.mean(axis=1) for half in halves)
    assert max(np.ptp(half[-1], axis=0).max() for half in halves) < 0.53, "no Gaussian stays behind"
    distance = np.linalg.norm(first - second, axis=1)
    turned = scene.object.spin[2] * 11 / scene.time.fps
    assert distance[-1] == pytest.approx(distance[0] * np.hypot(1, turned), rel=error)
    assert any("2 separate pieces" in note for note in report["notes"])
    assert not report["balance"].get("tearing", {}).get("likely")
    assert promise(scene, None, report).error is None


def links(gap: float) -> Gaussians:
    """Return two linked rings, one above the other, at a distance [m]."""
    rings = []
    for axes, height in (([0, 2, 1], 0.8), ([2, 0, 1], 0.4 + gap)):
        mesh = trimesh.creation.torus(0.25, 0.05)
        chosen, weights = choose_triangles(np.asarray(mesh.triangles), 6000, 0)
        points = np.einsum("nc,nci->ni", weights, mesh.triangles[chosen])[:, axes]
        normals = mesh.face_normals[chosen][:, axes]
        rings.append(cover_surface(points + [0, 0, height], normals, np.ones(3)))
    return join(rings)


def test_linked_rings_hang_in_each_other():
    held = {"kind": "held", "lower": [-1, -1, 0.9], "upper": [1, 1, 2]}
    changes = {"accuracy": {"cells": 16}, "time.frames": 10, "boundaries": [held]}
    scene = Scene.named("drop").replaced({**changes, "object.lift": 0.0})
    (upper, lower), _ = simulate(links(0.03), scene)
    overlap = lower[:, :, 2].max(axis=1) - upper[:, :, 2].min(axis=1)
    assert overlap.max() - overlap[-1] > 0.035, "the lower ring falls onto the upper ring"
    # Each ring is 0.105 m thick.
    assert overlap.min() > 0.75 * 0.21, "it does not pass through the upper ring"


@pytest.mark.parametrize(
    ("gap", "radius", "count"),
    [(0.02, 0.25, 2), (0.0, 0.25, 1), (-0.45, 0.2, 1), (0.04, 0.04, 1)],
    ids=["apart", "touching", "one in the other", "a speck"],
)
def test_touching_parts_and_specks_are_no_separate_pieces(gap, radius, count):
    solid = find_interior(balls(gap, radius)).resample(1 / 32, per_cell=2)
    points = lattice_of(solid, density=1000, dx=1 / 16)
    assert len(solid.split(1 / 16)) == count
    assert (points.piece is None) == (points.copies is None) == (count == 1)


def test_no_error_is_stated_for_separate_pieces():
    scene = Scene.named("spin")
    assert promise(scene, Proportions(0.5, 0.3)).error is not None
    assert promise(scene, Proportions(0.5, 0.3, pieces=2)).error is None


def test_static_piece_has_no_surface():
    both = balls(0.1)
    count = len(both) // 2
    parts = [{"gaussians": [count, 2 * count], "static": True}]
    scene = Scene.named("drop").replaced({"accuracy.cells": 16, "parts": parts})
    surface = prepare(both, scene).particles.surface
    assert surface is not None
    assert np.ptp(surface[:, :3], axis=0).max() < 0.6 < np.ptp(both.means[:, 1])
