"""The differentiable rasterizer: its formula, exact gradients, and how gsplat is called."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from phy124.generators.neural import splatting
from phy124.generators.neural.orbit import orbit, to_opencv
from phy124.generators.neural.splatting import (
    View,
    orbit_view,
    project,
    rasterize,
    rotation_matrices,
)


def random_splats(count: int, dtype=torch.float64, seed: int = 0) -> list[torch.Tensor]:
    """Arguments of `rasterize` before the view."""
    draw = torch.Generator().manual_seed(seed)
    return [
        torch.randn(count, 3, generator=draw, dtype=dtype) * 0.2,
        torch.randn(count, 4, generator=draw, dtype=dtype),
        torch.rand(count, 3, generator=draw, dtype=dtype) * 0.1 + 0.03,
        torch.rand(count, generator=draw, dtype=dtype) * 0.6 + 0.2,
        torch.rand(count, 3, generator=draw, dtype=dtype),
    ]


def test_rasterizer_equals_the_formula_pixel_by_pixel():
    """C = sum c_i a_i prod (1 - a_j), summed over all Gaussians without tiles or bounds."""
    splats = random_splats(9)
    view, background = orbit_view(-15, 40, 2, 20), torch.tensor([0.1, 0.5, 0.9]).double()
    drawn = rasterize(*splats, view, background)
    means, quats, scales, opacities, colors = splats
    centres, depths, covariances = project(means, quats, scales, view)
    order = depths.argsort().tolist()
    for y, x in ((3, 4), (9, 10), (10, 9), (17, 12)):
        light, color = 1.0, torch.zeros(3, dtype=torch.float64)
        for i in order:
            d = torch.tensor([x + 0.5, y + 0.5]).double() - centres[i]
            alpha = float(opacities[i] * torch.exp(-0.5 * d @ covariances[i].inverse() @ d))
            if alpha < 1 / 255:
                continue
            color += light * alpha * colors[i]
            light *= 1 - alpha
        torch.testing.assert_close(drawn.rgb[y, x], color + light * background)
        assert float(drawn.alpha[y, x]) == pytest.approx(1 - light)


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors"])
def test_gradients_equal_finite_differences(name):
    splats = random_splats(10)
    which = ["means", "quats", "scales", "opacities", "colors"].index(name)
    view, target = orbit_view(-10, 30, 2, 20), torch.rand(20, 20, 3).double()

    def loss(value):
        parts = [value if i == which else part for i, part in enumerate(splats)]
        drawn = rasterize(*parts, view, torch.tensor([0.2, 0.4, 0.6]).double())
        return (drawn.rgb - target).square().sum() + drawn.alpha.square().sum()

    value = splats[which].clone().requires_grad_()
    loss(value).backward()
    with torch.no_grad():
        for i in range(0, value.numel(), 3):
            step = torch.zeros(value.numel(), dtype=torch.float64)
            step[i] = 1e-6
            step = step.reshape(value.shape)
            difference = (loss(value + step) - loss(value - step)) / 2e-6
            gradient = value.grad.flatten()[i]
            assert float(gradient) == pytest.approx(float(difference), rel=1e-4, abs=1e-5)


def test_screen_gradient_is_per_half_image_side():
    """Far away, moving a Gaussian across the view only moves its centre: focal / depth pixels."""
    splats = random_splats(1)
    splats[0] = torch.tensor([[0.1, 0.05, 0.0]]).double().requires_grad_()
    view = View(torch.from_numpy(to_opencv(orbit(0, 0, 400))), 400 * 16.0, 32, 32)
    drawn = rasterize(*splats, view, torch.zeros(3).double())
    (drawn.rgb * torch.linspace(0, 1, 32).double()[None, :, None]).sum().backward()
    per_half_side = drawn.screen_gradients()[0]
    assert float(per_half_side[0]) > 0
    assert float(splats[0].grad[0, 0]) == pytest.approx(float(per_half_side[0]), rel=0.01)


def test_gsplat_is_called_as_its_interface_asks(monkeypatch):
    """A stand-in with gsplat 1.5's signature and shapes; the CUDA kernels need a GPU."""

    def rasterization(
        means, quats, scales, opacities, colors, viewmats, Ks, width, height, *,
        near_plane, backgrounds, packed,
    ):  # fmt: skip
        del near_plane
        assert viewmats.shape == (1, 4, 4) and backgrounds.shape == (1, 3) and not packed
        torch.testing.assert_close(quats.norm(dim=1), torch.ones(len(quats)).double())
        torch.testing.assert_close(Ks[0, :2, 2], torch.tensor([width, height]).double() / 2)
        seen = View(viewmats[0], float(Ks[0, 0, 0]), width, height)
        drawn = rasterize(means, quats, scales, opacities, colors, seen, backgrounds[0])
        radii = drawn.radii[None, :, None].expand(1, -1, 2)
        info = {"means2d": drawn.centres[None], "radii": radii.int()}
        return drawn.rgb[None], drawn.alpha[None, ..., None], info

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    splats = [part.requires_grad_() for part in random_splats(6)]
    view, background = orbit_view(-10, 30, 2, 20), torch.tensor([0.2, 0.4, 0.6]).double()
    ours = rasterize(*splats, view, background)
    theirs = splatting._with_gsplat(*splats, view, background)
    for name in ("rgb", "alpha", "radii"):
        torch.testing.assert_close(getattr(theirs, name), getattr(ours, name), check_dtype=False)
    ours.rgb.square().sum().backward()
    assert ours.screen_gradients().shape == (6, 2)
    theirs.rgb.square().sum().backward()
    assert theirs.screen_gradients().shape == (6, 2)


def test_invisible_gaussians_are_marked():
    splats = random_splats(4)
    splats[0] = torch.tensor([[0.0, 0, 0], [0, 0, 5], [0, 0, 1.0], [3, 0, 0]]).double()
    drawn = rasterize(*splats, orbit_view(0, 0, 2, 16), torch.zeros(3).double())
    assert (drawn.radii > 0).tolist() == [True, False, True, False]
    assert drawn.screen_gradients().abs().sum() == 0


def test_rotations_match_the_library(three_gaussians):
    from phy124.gaussians import rotation_matrices as ours

    quats = torch.from_numpy(three_gaussians.quats) * 3
    np.testing.assert_allclose(rotation_matrices(quats), ours(three_gaussians.quats), atol=1e-6)
