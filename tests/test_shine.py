"""Shine: what is fluid or metal has highlights and reflections, and nothing else has."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.budget.effects import Effects
from phy124.gaussians import Gaussians
from phy124.rendering.film import film
from phy124.rendering.framing import cameras
from phy124.rendering.shine import (
    GLOSSES,
    LAMP,
    Shine,
    add_gloss,
    discs,
    make_shine,
    reflect,
    runs_of,
    surface,
)
from phy124.runtime.context import RunContext
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

SMALL = {"accuracy": {"cells": 8}, "time.frames": 2, "object.lift": 0.1}
CELL = 0.05


@pytest.fixture(scope="module")
def solid():
    """Points of a lattice in a ball of radius 0.5 around the origin [N,3]."""
    axis = np.arange(-0.5, 0.51, CELL)
    x = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    return x[np.linalg.norm(x, axis=1) <= 0.5]


def clip_of(law):
    scene = Scene.named("drop").replaced({**SMALL, "material.law": law})
    return Simulation(prepare(ball(600), scene, RunContext(threads=1))).run()


@pytest.fixture(scope="module")
def water():
    return clip_of("fluid")


def test_normals_of_a_fluid_are_those_of_its_surface(solid):
    normals, spacing = surface(solid, CELL, 2.0)
    radius = np.linalg.norm(solid, axis=1)
    outside, inside = radius > 0.47, radius < 0.2
    length = np.linalg.norm(normals, axis=1)
    assert length[outside].min() > 0.9 and length[inside].max() < 0.3
    outwards = (normals[outside] * solid[outside]).sum(axis=1) / length[outside]
    assert (outwards / radius[outside]).min() > 0.97
    assert np.median(spacing[inside]) == pytest.approx(CELL, rel=0.02)
    far = np.concatenate([solid, [[1e4, 0, 0]]])
    assert np.isfinite(surface(far, CELL, 2.0)[0]).all()


def test_a_surface_shines_where_it_mirrors_the_lamp():
    towards, normals = np.array([[1.0, 0, 0]] * 2), np.array([[1.0, 0, 0]] * 2)
    half = LAMP + towards[0]
    normals[1] = half / np.linalg.norm(half)
    rgb = np.full((2, 3), 0.2)
    dull, bright = reflect(rgb, normals, towards, GLOSSES["fluid"])
    assert bright.min() > 0.8 and dull.max() < 0.4
    assert np.allclose(reflect(rgb, 0 * normals, towards, GLOSSES["fluid"]), 0.2)
    gold = np.array([[1.0, 0.7, 0.2]])
    up, down = (
        reflect(gold, np.array([[0.7, 0, z]]), towards[:1], GLOSSES["metal"])[0]
        for z in (0.7, -0.7)
    )
    assert (up > 2 * down).all(), "it mirrors the sky above and the dark floor"
    assert down[0] > 3 * down[2], "in its own colour"


def test_discs_lie_along_the_surface_and_overlap():
    part = ball(50)
    normals = part.means / np.linalg.norm(part.means, axis=1, keepdims=True)
    quats, scales = discs(part, normals, np.full(50, 0.1))
    lying = Gaussians(part.means, quats, scales, part.opacities, part.sh)
    across = np.einsum("ni,nij,nj->n", normals, lying.covariances(), normals)
    np.testing.assert_allclose(np.sqrt(across), scales.min(axis=1), rtol=1e-4)
    balls = discs(part, 0.1 * normals, np.full(50, 0.1))[1]
    assert (balls == balls[:, :1]).all()


def test_only_what_is_fluid_or_metal_shines(water, tmp_path):
    assert make_shine(water, Scene().view) is not None
    off = Scene().view.model_copy(update={"shine": False})
    assert make_shine(water, off) is None
    old = replace(water, report={})
    assert make_shine(old, Scene().view) is None
    assert clip_of("neo_hookean").report["shine"] == {}
    fluid = Scene.named("water")
    assert "shine of fluid" in Effects.of(fluid).ran
    assert not any("shine" in name for name in Effects.of(Scene.named("drop")).ran)


def test_each_view_of_a_film_is_lit_and_its_time_is_told(water, tmp_path):
    shine, watch = Shine(water), Stopwatch()
    view = Scene().view.model_copy(update={"views": ("front",), "size": (32, 32)})
    film(water, view, tmp_path, watch=watch)
    assert watch.seconds["shine"] > 0
    frame = water.frame(1)
    lit = shine.illuminate(frame, cameras(water, view, "front")[1]).gaussians
    assert np.array_equal(lit.means, frame.gaussians.means)
    assert not np.array_equal(lit.sh, frame.gaussians.sh) and np.isfinite(lit.sh).all()
    assert lit.rgb.max() > frame.gaussians.rgb.max() - 1e-6


def test_the_player_gets_discs_whose_normals_point_outwards(water):
    shown, gloss = add_gloss(water, Scene().view)
    (law,) = gloss["laws"]
    assert law["runs"] == water.report["shine"]["fluid"] and law["outwards"]
    assert law["gloss"] == list(GLOSSES["fluid"])
    for index in range(len(water)):
        w, x, y, z = shown.quats[index].T
        axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
        flat = shown.scales[index, :, 2] < 0.5 * shown.scales[index, :, 0]
        away = shown.means[index] - shown.means[index].mean(axis=0)
        outwards = (axis * away).sum(axis=1) / np.linalg.norm(away, axis=1)
        assert flat.mean() > 0.3 and np.median(outwards[flat]) > 0.8
    assert ((shown.quats[1:] * shown.quats[:-1]).sum(axis=2) >= 0).all()
    rubber = clip_of("neo_hookean")
    assert add_gloss(rubber, Scene().view) == (rubber, None)
    assert runs_of(np.array([2, 3, 4, 9])) == [[2, 5], [9, 10]]


def test_broken_places_leave_the_others_as_they_are(water):
    means = water.means[0].copy()
    means[3] = np.nan
    frame = water.frame(0)
    broken = replace(frame, gaussians=replace(frame.gaussians, means=means))
    camera = cameras(water, Scene().view, "front")[0]
    lit = Shine(water).illuminate(broken, camera).gaussians
    assert np.isfinite(np.delete(lit.sh, 3, axis=0)).all()
