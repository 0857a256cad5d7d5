"""Glass: the translucent look of boundaries, alone, before Gaussians and among them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.kernels.splat.glass import FACE, LINE, RIM, TINT, WIDTH
from phy124.rendering.render import Renderer
from phy124.rendering.stage.frame import Backdrop, Solid, StageFrame, bounds
from support.device_functions import arranged
from support.shapes import ball

TILTED = np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1.0]])
SOLIDS = {
    "box": Solid(np.array([0.1, 0.2, 0.1]), TILTED, np.array([0.3, 0.2, 0.25])),
    "ball": Solid(np.array([0.1, -0.2, 0.1]), np.eye(3), np.zeros(3), 0.3),
    "capsule": Solid(np.array([0.0, 0.1, 0.2]), TILTED, np.array([0.3, 0, 0]), 0.15),
}


def veil(solid: Solid, eye: np.ndarray, rays: np.ndarray, limits, pixel: float) -> np.ndarray:
    """Opacity of a solid in front of `limits` along rays [N,3], by marching its distance."""
    steps = np.linspace(1, 3, 8001)
    out = np.zeros(len(rays))
    for n, (ray, limit) in enumerate(zip(rays, np.broadcast_to(limits, len(rays)), strict=True)):
        points = (eye + steps[:, None] * ray - solid.centre) @ solid.axes.T
        if solid.radius:
            points[:, 0] -= np.clip(points[:, 0], -solid.half[0], solid.half[0])
            inside = (points**2).sum(1) < solid.radius**2
        else:
            inside = (np.abs(points) < solid.half).all(1)
        if not inside.any():
            continue
        first, last = np.flatnonzero(inside)[[0, -1]]
        clear = 1.0
        for k in (first, last):
            if 0 < steps[k] < limit:
                clear *= 1 - face(solid, points[k], ray, steps[k] * pixel)
        if steps[first] < limit:
            chord = (steps[last] - steps[first]) * np.linalg.norm(ray)
            out[n] = (1 - clear) * min(chord / (WIDTH * pixel * steps[last]), 1)
    return out


def face(solid: Solid, point: np.ndarray, ray: np.ndarray, pixel: float) -> float:
    if solid.radius:
        cosine = abs(point @ (solid.axes @ ray)) / np.linalg.norm(point) / np.linalg.norm(ray)
        return 0.6 * FACE + (RIM - 0.6 * FACE) * (1 - cosine) ** 3
    second = np.sort(np.abs(solid.half - np.abs(point)))[1]
    return FACE + (LINE - FACE) * min(max(1 - second / (WIDTH * pixel), 0), 1)


@pytest.mark.parametrize("name", SOLIDS)
def test_glass_is_drawn_where_its_shape_is(name):
    """Against marching along each ray; nothing but the solid before black."""
    camera = Camera.orbit(30, 25, 2.0, (24, 20), (0.1, 0.1, 0.1))
    nothing = ball(10).select(np.zeros(0, int))
    stage = StageFrame(Backdrop((0, 0, 0), (0, 0, 0)), None, (SOLIDS[name],))
    image = Renderer(device="cpu")(nothing, camera, stage=stage)
    y, x = (v.ravel() + 0.5 for v in np.mgrid[:20, :24])
    seen = np.stack([(x - 12) / camera.focal, (y - 10) / camera.focal, np.ones_like(x)], axis=1)
    rays = seen @ camera.view[:3, :3]
    alpha = veil(SOLIDS[name], np.array(camera.eye), rays, math.inf, 1 / camera.focal)
    assert (alpha > 0.05).sum() > 15
    wanted = alpha.reshape(20, 24, 1) * np.array(list(TINT))
    assert np.abs(image - wanted).max() < 0.02 and np.abs(image - wanted).mean() < 1e-3


def dots(places) -> Gaussians:
    n = len(places)
    return Gaussians.from_rgb(
        np.array(places, float),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.full((n, 3), 0.02),
        np.full(n, 0.99),
        np.tile([1.0, 0.5, 0.0], (n, 1)),
    )


def test_glass_tints_only_gaussians_behind_it():
    camera, renderer = Camera.orbit(0, 0, 2.0, 65), Renderer(device="cpu")
    pane = Solid(np.array([0.5, 0, 0]), np.eye(3), np.array([0.05, 0.4, 0.4]))
    stage = StageFrame(Backdrop((0, 0, 0), (0, 0, 0)), None, (pane,))
    for place, seen in (((0.8, 0, 0), 1.0), ((0.0, 0, 0), (1 - FACE) ** 2)):
        plain = renderer(dots([place]), camera, (0, 0, 0))[32, 32]
        image = renderer(dots([place]), camera, stage=stage)[32, 32]
        assert plain[0] > 0.95
        assert image == pytest.approx(seen * plain + (1 - seen) * np.array(list(TINT)), abs=0.01)


@pytest.mark.parametrize("blend", ["simd", "pixel"])
def test_glass_in_front_matches_glass_between_gaussians(blend):
    """One out of sight, before the pane, has each Gaussian behind it tinted on its own."""
    camera, renderer = Camera.orbit(0, 0, 2.0, 65), Renderer(device="cpu", blend=blend)
    pane = Solid(np.array([0.5, 0, 0]), np.eye(3), np.array([0.05, 0.4, 0.4]))
    stage = StageFrame(Backdrop((0.1, 0.1, 0.1), (0.9, 0.9, 0.9)), None, (pane,))
    seen = [(0.0, y, z) for y in (-0.2, 0.0, 0.1) for z in (-0.1, 0.2)]
    assert arranged([pane], camera, bounds(dots(seen).means)).counts == [1, 0, 0]
    assert arranged([pane], camera, bounds(dots([*seen, (1.5, 2.0, 0)]).means)).counts == [0, 1, 0]
    laid = renderer(dots(seen), camera, stage=stage)
    tinted = renderer(dots([*seen, (1.5, 2.0, 0)]), camera, stage=stage)
    assert np.abs(laid - renderer(dots(seen), camera, stage=replace(stage, solids=()))).max() > 0.1
    np.testing.assert_allclose(laid, tinted, atol=1e-3)
