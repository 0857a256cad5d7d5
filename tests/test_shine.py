"""Shine: what is fluid or metal has highlights and reflections, and nothing else has."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.budget.effects import Effects
from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.io.formats import read_gaussians
from phy124.kernels.splat.screen import MIN_ALPHA
from phy124.rendering.film import film
from phy124.rendering.frames import render_frames
from phy124.rendering.framing import cameras
from phy124.rendering.liquid import NOWHERE, Liquid, Planes
from phy124.rendering.render import render
from phy124.rendering.shine import GLOSSES, LAMP, Shine, add_gloss, make_shine, reflect, runs_of
from phy124.runtime.context import RunContext
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball
from support.solids import coarse

pytestmark = pytest.mark.usefixtures("coarse_solids")

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
    with coarse():
        return clip_of("fluid")


@pytest.mark.parametrize("shine", [True, False])
def test_exports_show_the_look_that_videos_show(water, tmp_path, capsys, shine):
    """`view.shine` of the clip decides, with one frame and with all frames."""
    view = {**water.scene["view"], "shine": shine}
    replace(water, scene={**water.scene, "view": view}).save(tmp_path / "clip.safetensors")
    clip = Clip.load(tmp_path / "clip.safetensors")
    command = ["export", str(tmp_path / "clip.safetensors"), "--to"]
    wanted = Shine(clip).shape(clip.frame(1)) if shine else clip.frame(1)
    assert main([*command, "ply", "--frame", "1", "--out", str(tmp_path / "a.ply")]) == 0
    opacities = read_gaussians(tmp_path / "a.ply").gaussians.opacities
    np.testing.assert_allclose(opacities, wanted.gaussians.opacities, atol=1e-4)
    assert main([*command, "p4d"]) == 0
    assert ("The formats usd and 4dgs keep it" in capsys.readouterr().out) is shine
    pxr = pytest.importorskip("pxr.UsdVol", reason="usd-core is not installed")
    assert main([*command, "usd"]) == 0
    stage = pytest.importorskip("pxr.Usd").Stage.Open(str(tmp_path / "clip.usdc"))
    splats = pxr.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    np.testing.assert_allclose(splats.GetOpacitiesAttr().Get(1), wanted.gaussians.opacities)
    np.testing.assert_allclose(splats.GetPositionsAttr().Get(1), wanted.gaussians.means)


def still(x):
    """Return grey balls at points [N,3]."""
    n = len(x)
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    return Gaussians(x, quats, np.full((n, 3), CELL / 4), np.full(n, 0.9), np.zeros((n, 1, 3)))


def test_a_liquid_is_drawn_as_discs_on_its_surface(solid):
    drawn = Liquid(solid, 2 * CELL, None).shape(still(solid))
    radius = np.linalg.norm(drawn.means, axis=1)
    on = drawn.normals.any(axis=1)
    assert 0.3 < on.mean() < 0.8 and not drawn.opacities[~on].any()
    np.testing.assert_allclose(radius[on], 0.51, atol=0.06)
    assert np.average(radius[on], weights=drawn.opacities[on]) == pytest.approx(0.51, abs=0.01)
    assert ((drawn.normals[on] * drawn.means[on]).sum(axis=1) / radius[on]).min() > 0.95
    lying = Gaussians(*drawn[:4], np.zeros((len(solid), 1, 3)))
    across = np.einsum("ni,nij,nj->n", drawn.normals, lying.covariances(), drawn.normals)[on]
    np.testing.assert_allclose(np.sqrt(across), drawn.scales[on].min(axis=1), rtol=2e-3)


def test_dense_gaussians_on_its_surface_make_no_liquid_hollow(solid):
    shell = np.random.default_rng(0).normal(size=(4 * len(solid), 3))
    shell *= 0.5 / np.linalg.norm(shell, axis=1)[:, None]
    inner = solid[np.linalg.norm(solid, axis=1) < 0.45]
    x, left = np.concatenate([shell, inner]), (len(solid) - len(inner)) / len(shell)
    volumes = CELL**3 * np.repeat([left, 1.0], [len(shell), len(inner)])
    drawn = Liquid(x, 2 * CELL, None, volumes=volumes).shape(still(x))
    on = drawn.normals.any(axis=1)
    np.testing.assert_allclose(np.linalg.norm(drawn.means[on], axis=1), 0.5, atol=0.06)


def test_a_thin_leaf_of_a_liquid_is_drawn_in_full(solid):
    step = np.linspace(0, 0.5, 60)
    leaf = np.stack(np.meshgrid(0.5 + step, step - 0.25, [0.0]), axis=-1).reshape(-1, 3)
    x = np.concatenate([solid, leaf])
    volumes = np.repeat([CELL**3, CELL / 40 / len(leaf)], [len(solid), len(leaf)])
    drawn = Liquid(x, 2 * CELL, 0.1, volumes=volumes).shape(still(x))
    tip = np.flatnonzero(x[:, 0] > 0.8)
    depths = -np.log1p(-drawn.opacities[tip]) * 2 * np.pi * drawn.scales[tip, 0] ** 2
    assert depths.sum() > 1.4 * 0.2 * 0.5, "optical depth times the area of the tip"


def test_gaussians_of_a_liquid_have_the_volume_of_its_particles(water):
    setup = prepare(ball(600), Scene.model_validate(water.scene), RunContext(threads=1))
    (liquid,) = water.report["liquids"]
    counts = np.diff(liquid["runs"])[:, 0]
    assert (counts.sum(), len(counts)) == (len(water.opacities), 2)
    np.testing.assert_allclose(counts @ liquid["volumes"], setup.particles.volume.sum())


def test_objects_of_the_same_liquid_have_one_surface():
    other = {"name": "pool", "shape": "sphere", "place": (2, 0), "colour": "navy"}
    counts = {}
    for viscosity in (0.0, 1.0):
        pool = {**other, "material": {"law": "fluid", "viscosity": viscosity}}
        changes = {"material.law": "fluid", "material.tint": "red", "objects": (pool,)}
        scene = Scene.named("drop").replaced({**SMALL, **changes})
        setup = prepare(ball(600), scene, RunContext(threads=1))
        liquids = setup.appearance.liquids(setup.materials)
        counts[viscosity] = [int(np.diff(liquid["runs"]).sum()) for liquid in liquids]
        volume = sum((np.diff(each["runs"])[:, 0] @ each["volumes"]) for each in liquids)
        np.testing.assert_allclose(volume, setup.particles.volume.sum(), rtol=1e-5)
    assert len(counts[0.0]) == 1, "only the colours differ, so the liquids mix"
    assert len(counts[1.0]) == 2 and sum(counts[1.0]) == sum(counts[0.0])


def test_thick_liquid_lets_less_light_through(solid):
    flat = solid * [1, 1, 0.2]
    thick, thin = (Liquid(x, 2 * CELL, 0.5).shape(still(x)) for x in (solid, flat))

    def dims(drawn):
        """Optical depth of all surfaces, per area of the view from above [m^2]."""
        up = np.abs(drawn.normals[:, 2]) > 0.9
        area = 2 * np.pi * drawn.scales[up, 0] ** 2
        shown = (drawn.opacities[up] - MIN_ALPHA).clip(0)
        return -(np.log1p(-shown) * area).sum() / np.ptp(drawn.means[up, :2])

    assert dims(thick) > 1.5 * dims(thin)
    assert thin.rgb.mean() > thick.rgb.mean(), "a thin layer is pale"
    opaque = Liquid(solid, 2 * CELL, None).shape(still(solid))
    assert dims(opaque) > 3 * dims(thick)
    assert opaque.opacities.max() <= 1


def test_a_liquid_with_more_gaussians_is_not_paler():
    camera = Camera.orbit(0, 89, 20, 64, (0.5, 0.5, 0), fov_y=1.5)
    shown = []
    for spacing in (CELL, CELL / 4):
        step = np.arange(spacing / 2, 1, spacing)
        x = np.stack(np.meshgrid(step, step, step[step < 6 * CELL]), axis=-1).reshape(-1, 3)
        drawn = Liquid(x, 2 * CELL, 0.5).shape(still(x))
        picture = render(Gaussians(*drawn[:4], still(x).sh), camera, alpha=True, device="cpu")
        shown.append(np.asarray(picture)[..., 3].mean())
    assert shown[1] == pytest.approx(shown[0], rel=0.05)


def test_a_pool_is_drawn_as_flat_up_to_its_walls():
    step = np.arange(CELL / 2, 1, CELL)
    x = np.stack(np.meshgrid(step, step, step[:10], indexing="ij"), axis=-1).reshape(-1, 3)
    normals = np.concatenate([np.eye(3), -np.eye(3)[:2]])
    tank = Planes(normals, np.array([0, 0, 0, -1, -1.0]))
    spoilt = {}
    for planes in (tank, NOWHERE):
        drawn = Liquid(x, 2 * CELL, None, planes).shape(still(x), planes)
        up, seen = drawn.normals[:, 2] > 0.9, drawn.opacities > 0.05
        rim = up & seen & (drawn.means[:, 0] < 2 * CELL)
        spoilt[len(planes.offsets)] = np.ptp(drawn.means[rim, 2]) if rim.any() else 1.0
        if planes is tank:
            side = seen & (drawn.normals[:, 0] < -0.9)
            assert side.sum() > 100
            np.testing.assert_allclose(drawn.means[side, 0], 0, atol=1e-6)
            assert (np.abs(drawn.means[up & seen, 2] - 0.5) < 0.6 * CELL).all()
            film = x[x[:, 2] < CELL]
            thin = Liquid(film, 2 * CELL, None, tank).shape(still(film), tank)
            drawn_up = thin.normals[thin.opacities > 0, 2] > 0.5
            assert drawn_up.mean() > 0.8, "a film is drawn from above only"
    assert spoilt[5] < 0.3 * CELL < spoilt[0]


def test_a_film_of_particles_in_rows_has_no_stripes():
    along, across = np.arange(0.01, 1, 0.3 * CELL), np.arange(CELL, 1, 2.6 * CELL)
    points = np.meshgrid(along, across, [CELL / 2, 1.5 * CELL], indexing="ij")
    x = np.stack(points, axis=-1).reshape(-1, 3)
    floor = Planes(np.array([[0, 0, 1.0]]), np.zeros(1))
    drawn = Liquid(x, 2 * CELL, 0.5, floor).shape(still(x), floor)
    depth = depths(drawn, np.column_stack([np.full(61, 0.5), np.linspace(0.35, 0.65, 61)]))
    assert depth.std() < 0.12 * depth.mean()


@pytest.mark.parametrize("pieces", [1, pytest.param(30, marks=pytest.mark.slow)])
def test_a_film_of_scattered_particles_has_no_blotches(pieces):
    """Every fourth particle consists of several Gaussians, like those on the object's surface."""
    step, rng = np.arange(CELL / 2, 1.5, CELL), np.random.default_rng(1)
    x = np.stack(np.meshgrid(step, step, step[:3], indexing="ij"), axis=-1).reshape(-1, 3)
    x[:, :2] += rng.uniform(-1, 1, (len(x), 2)) * CELL
    counts = np.where(rng.random(len(x)) < 0.25, pieces, 1)
    x, volumes = np.repeat(x, counts, axis=0), np.repeat(CELL**3 / counts, counts)
    floor = Planes(np.array([[0, 0, 1.0]]), np.zeros(1))
    drawn = Liquid(x, 2 * CELL, 0.5, floor, volumes).shape(still(x), floor)
    drawn = drawn._replace(opacities=drawn.opacities - MIN_ALPHA)
    along = np.linspace(0.4, 1.1, 30)
    depth = depths(drawn, np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2))
    assert depth.std() < 0.09 * depth.mean()


def test_a_stretched_film_has_no_stripes():
    step = np.arange(CELL / 2, 1, CELL)
    x = np.stack(np.meshgrid(step, step, step[:8], indexing="ij"), axis=-1).reshape(-1, 3)
    floor = Planes(np.array([[0, 0, 1.0]]), np.zeros(1))
    drawn = Liquid(x, 2 * CELL, 0.5, floor).shape(still(x * [5, 1, 1 / 5]), floor)
    depth = depths(drawn, np.column_stack([np.linspace(2, 3, 81), np.full(81, 0.5)]))
    assert depth.std() < 0.12 * depth.mean()


def test_a_film_that_has_sunk_into_its_floor_is_hardly_paler():
    step, floor = np.arange(CELL / 4, 1, CELL / 2), Planes(np.array([[0, 0, 1.0]]), np.zeros(1))
    x = np.stack(np.meshgrid(step, step, [0.4 * CELL], indexing="ij"), axis=-1).reshape(-1, 3)
    volumes = np.full(len(x), 0.4 * CELL * (CELL / 2) ** 2)
    liquid = Liquid(x, 2 * CELL, 0.05, floor, volumes)
    drawn = liquid.shape(still(x * np.where(x[:, :1] > 0.5, [1, 1, -1], 1)), floor)
    depth = depths(drawn, np.column_stack([[0.3, 0.7], [0.5, 0.5]]))
    assert depth[1] == pytest.approx(depth[0], rel=0.25)


def test_a_stretched_liquid_has_no_stripes(solid):
    liquid = Liquid(solid, 2 * CELL, 0.5)
    for stretch in (2.8, 3.2):
        drawn = liquid.shape(still(solid * [stretch, 1, 1 / stretch]))
        depth = depths(drawn, np.column_stack([np.linspace(-0.2, 0.2, 81), np.zeros(81)]))
        assert depth.std() < 0.12 * depth.mean()


def test_the_gloss_of_a_viscous_liquid_shows_no_rows():
    """Rows of particles make normals wavy; viscosity flattens such waves."""
    floor = Planes(np.array([[0, 0, 1.0]]), np.zeros(1))
    along, up = np.arange(CELL / 2, 1, CELL), np.arange(CELL / 2, 0.3, CELL)
    rows = np.arange(CELL / 2, 2, 2.6 * CELL)
    x = np.stack(np.meshgrid(along, rows, up, indexing="ij"), axis=-1).reshape(-1, 3)
    tilt = []
    for calm in (False, True):
        volumes = np.full(len(x), 2.6 * CELL**3)
        drawn = Liquid(x, 2 * CELL, None, floor, volumes, calm).shape(still(x), floor)
        inner = (abs(x[:, 0] - 0.5) < 0.2) & (abs(x[:, 1] - 1) < 0.4) & (drawn.normals[:, 2] > 0.5)
        tilt.append(np.abs(drawn.normals[inner, 1]).max())
    assert inner.sum() > 30
    assert tilt[1] < tilt[0] / 3


def depths(drawn, line):
    """Return the optical depth of discs, seen from above, along a line [M,2]."""
    seen = drawn.opacities > 0
    means, scale = drawn.means[seen, None, :2], drawn.scales[seen, :1]
    away = ((line - means) ** 2).sum(axis=-1)
    return (-np.log1p(-drawn.opacities[seen])[:, None] * np.exp(-away / (2 * scale**2))).sum(axis=0)


@pytest.mark.parametrize(("law", "colours"), [("fluid", 1), ("neo_hookean", 600)])
def test_a_tinted_liquid_has_a_single_colour(law, colours):
    shaded = ball(600)
    shaded.sh[:] = np.linspace(-0.5, 0.5, 600)[:, None, None]
    changes = {"material.law": law, "material.tint": "#1f6fb8"}
    scene = Scene.named("drop").replaced({**SMALL, **changes})
    clip = Simulation(prepare(shaded, scene, RunContext(threads=1))).run()
    rgb = clip.frame(0).gaussians.rgb[:600]
    assert len(np.unique(rgb.round(5), axis=0)) == colours


@pytest.mark.parametrize(
    ("law", "patterned"), [("fluid", False), ("sand", False), ("snow", False), ("hencky", True)]
)
def test_a_box_that_flows_apart_has_no_pattern(law, patterned):
    box = {"name": "box", "shape": "box", "on": "object", "material": {"law": law}}
    scene = Scene.from_data({**Scene.named("drop").data(), "objects": [box], "grains": False})
    setup = prepare(ball(600), scene.replaced(SMALL), RunContext(threads=1))
    rgb = setup.appearance.gaussians.of_object(1).rgb
    assert len(rgb) and (np.ptp(rgb, axis=0) > 0.02).all() == patterned


def test_torn_liquid_is_drawn_as_round_drops(solid):
    liquid = Liquid(solid, 2 * CELL, 0.1)
    flown = solid.copy()
    flown[:40] = np.random.default_rng(0).uniform(2, 6, (40, 3))
    drawn = liquid.shape(still(flown))
    drops = drawn.scales[:40]
    assert (drops == drops[:, :1]).all() and (drawn.opacities[:40] > 0.8).all()
    assert not drawn.normals[:40].any() and np.ptp(drops) > 0.2 * drops.mean()
    jet = solid * [0.1, 0.1, 3]
    torn = liquid.shape(still(jet))
    assert (torn.opacities == 0).mean() > 0.3, "a jet is spray"
    calm = Liquid(jet, 2 * CELL, 0.1).shape(still(jet))
    assert (calm.opacities > 0).mean() > 0.6, "an object that is thin at rest is none"


def test_fast_liquid_in_the_air_is_foam_where_it_thins(solid):
    floor = Planes(np.array([[0, 0, 1.0]]), np.array([-0.6]))
    liquid = Liquid(solid, 2 * CELL, 0.1, floor)
    fast, slow = np.full(len(solid), 3.0), np.full(len(solid), 0.3)

    def whiteness(x, speeds):
        """Mean brightness of the darkest channel of what is drawn."""
        drawn = liquid.shape(still(x), floor, speeds)
        return np.average(drawn.rgb.min(axis=1), weights=drawn.opacities)

    sheet = solid * [1.5, 1.5, 0.1]
    clear = whiteness(sheet, slow)
    assert clear == whiteness(sheet, None) and whiteness(sheet, fast) > clear + 0.1
    for calm in (solid, sheet - [0, 0, 0.58]):  # at rest, and as a film on the floor
        assert whiteness(calm, fast) == pytest.approx(whiteness(calm, slow), abs=0.02)
    drawn = liquid.shape(still(sheet), floor, fast)
    flecks = (drawn.scales[:, 2] == drawn.scales[:, 0]) & (drawn.opacities > 0.8)
    assert 0.05 < flecks.mean() < 0.3 and not drawn.normals[flecks].any()
    assert np.median(drawn.rgb[flecks].min(axis=1)) > 0.8


@pytest.mark.parametrize(("viscosity", "foams"), [(0.0, True), (10.0, False)])
def test_a_viscous_liquid_has_no_foam(viscosity, foams):
    scene = Scene.named("drop").replaced({**SMALL, "material.law": "fluid"})
    scene = scene.replaced({"material.viscosity": viscosity})
    clip = Simulation(prepare(ball(600), scene, RunContext(threads=1))).run()
    shine = Shine(clip)
    assert shine.needs_velocities == foams
    moving = clip.frame(1, velocities=True)
    shapes = [shine.shape(frame).gaussians.rgb for frame in (moving, clip.frame(1))]
    np.testing.assert_array_equal(*shapes, "velocities are computed if a frame lacks them")
    fast = replace(moving, velocities=moving.velocities + 5)
    assert (Shine(clip).shape(fast).gaussians.rgb != shapes[0]).any() == foams


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


def test_each_view_of_a_film_is_lit_and_timed(water, tmp_path):
    shine, watch = Shine(water), Stopwatch()
    view = Scene().view.model_copy(update={"views": ("front",), "size": (32, 32)})
    film(water, view, tmp_path, watch=watch)
    assert watch.seconds["shine"] > 0
    frame = water.frame(1)
    lit = shine.illuminate(frame, cameras(water, view, "front")[1]).gaussians
    assert np.array_equal(lit.opacities, shine.shape(frame).gaussians.opacities)
    assert not np.array_equal(lit.sh, frame.gaussians.sh) and np.isfinite(lit.sh).all()
    assert lit.rgb.max() > frame.gaussians.rgb.max() - 1e-6


@pytest.mark.parametrize("threads", [1, 3])
def test_surfaces_are_computed_once_for_all_sides(water, tmp_path, monkeypatch, threads):
    shape, shaped = Liquid.shape, []
    monkeypatch.setattr(
        Liquid, "shape", lambda self, *args: shaped.append(self) or shape(self, *args)
    )
    sides = ("front", "left", "back", "right")
    view = Scene().view.model_copy(update={"views": sides, "size": (16, 16), "formats": ("png",)})
    film(water, view, tmp_path / "films", threads=threads)
    assert len(shaped) == len(water)
    camera = cameras(water, view, "left")[1]
    lit = Shine(water).illuminate(water.frame(1), camera)
    (image,) = render_frames([lit], camera, background=view.background)
    saved = np.asarray(Image.open(tmp_path / "films/left-png/left_0002.png"))
    assert np.array_equal(saved, image)


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


def test_exported_files_hold_liquids_as_they_are_drawn(water, tmp_path):
    from phy124.io.ply import read_ply

    view = Scene().view.model_copy(update={"formats": ("ply",)})
    film(water, view, tmp_path)
    read = read_ply(tmp_path / "clip-ply/frame_0002.ply").gaussians
    drawn = Shine(water).shape(water.frame(1)).gaussians
    np.testing.assert_allclose(read.opacities, drawn.opacities, atol=1e-3)
    np.testing.assert_allclose(read.scales, drawn.scales, rtol=1e-3)
    merged = replace(water, report={**water.report, "shine": {}})
    assert make_shine(merged, view) is None


def test_broken_places_leave_the_others_as_they_are(water):
    means = water.means[0].copy()
    means[3] = np.nan
    frame = water.frame(0)
    broken = replace(frame, gaussians=replace(frame.gaussians, means=means))
    camera = cameras(water, Scene().view, "front")[0]
    lit = Shine(water).illuminate(broken, camera).gaussians
    assert np.isfinite(np.delete(lit.sh, 3, axis=0)).all()
