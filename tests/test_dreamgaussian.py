"""DreamGaussian: the original's arithmetic, exact gradients, and an optimiser that works."""

import json
import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import formula
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from phy124.errors import Cancelled, InputError
from phy124.generators import splatting
from phy124.generators.dreamgaussian import (
    WITH_IMAGEDREAM,
    Density,
    DreamGaussian,
    Pose,
    Rates,
    Settings,
    Splats,
    fit,
    sds,
    start,
)
from phy124.generators.dreamgaussian import density as density_module
from phy124.generators.dreamgaussian.density import Pull, densify, prune, reset_opacity
from phy124.generators.dreamgaussian.generator import framed
from phy124.generators.dreamgaussian.guidance import alphas_cumprod, noised, timestep, zero123
from phy124.generators.dreamgaussian.guidance.multiview import MultiView
from phy124.generators.dreamgaussian.splats import ball
from phy124.generators.imagedream import load_unet
from phy124.generators.orbit import orbit, to_opencv
from phy124.generators.ply_file import PlyFile
from phy124.generators.splatting import View, orbit_view, project, rasterize, rotation_matrices
from phy124.ply import read_ply

CLOSE = {"rtol": 1e-4, "atol": 2e-5}
NAMES = {
    "xyz": "xyz",
    "f_dc": "features_dc",
    "opacity": "opacity",
    "scaling": "scaling",
    "rotation": "rotation",
}
"""Our parameter -> its name in the golden file."""


@pytest.fixture(scope="module")
def folder(golden):
    return golden / "generators"


@pytest.fixture(scope="module")
def expected(folder) -> dict[str, torch.Tensor]:
    arrays = np.load(folder / "dreamgaussian.npz")
    return {key: torch.from_numpy(arrays[key]) for key in arrays.files}


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


def assert_parameters(splats: Splats, expected: dict, prefix: str) -> None:
    for ours, theirs in NAMES.items():
        value = splats.parameters[ours].detach()
        np.testing.assert_allclose(value, expected[prefix + theirs], **CLOSE, err_msg=ours)


# --- against the original program ---------------------------------------------------------------


def test_start_and_rates_equal_the_original(expected):
    splats = Splats.from_points(expected["pts"], expected["cols"])
    assert_parameters(splats, expected, "init_")
    rates = [splats.rates.position(int(step)) for step in expected["lr_steps"]]
    np.testing.assert_allclose(rates, expected["lr_xyz"], rtol=1e-9)
    xyz, f_dc, f_rest, opacity, scaling, rotation = expected["group_lrs"].tolist()
    ours = Rates()
    assert (ours.xyz, ours.f_dc, ours.opacity) == pytest.approx((xyz, f_dc, opacity))
    assert (ours.scaling, ours.rotation) == pytest.approx((scaling, rotation))
    assert f_rest == pytest.approx(f_dc / 20)  # no harmonics above degree 0 here


def test_adam_step_equals_the_original(expected):
    """Adam's first step has the length of the rate whatever the gradient: its sign is taken."""
    splats = Splats.from_points(expected["pts"], expected["cols"])
    splats.set_step(1)
    for ours, theirs in NAMES.items():
        moved = expected["step1_" + theirs] - expected["init_" + theirs]
        splats.parameters[ours].grad = -0.3 * moved.sign()
    splats.step()
    assert_parameters(splats, expected, "step1_")
    assert all(p.grad is None for p in splats.parameters.values())


def test_clone_split_prune_and_reset_equal_the_original(expected):
    pre = {k: expected["pre_" + k.removeprefix("f_")] for k in NAMES}
    splats, pull = Splats(pre), Pull(40)
    pull.add(expected["vs_grad"], expected["vis"])
    np.testing.assert_allclose(pull.total, expected["accum"][:, 0], **CLOSE)
    np.testing.assert_allclose(pull.seen, expected["denom"][:, 0])

    def draw(std):
        np.testing.assert_allclose(std, expected["split_std"], **CLOSE)
        return expected["split_sample"]

    densify(splats, pull.mean, Density(), draw)
    assert_parameters(splats, expected, "post_")
    prune(splats, opacity_min=0.01, extent=Settings().final_extent)
    assert_parameters(splats, expected, "final_")
    reset_opacity(splats)
    np.testing.assert_allclose(
        splats.parameters["opacity"].detach(), expected["reset_opacity"], **CLOSE
    )


def test_camera_equals_the_original(expected, rng):
    points = torch.from_numpy(rng.normal(size=(10, 3)) * 0.3)
    ones = torch.ones(10, 4, dtype=torch.float64)
    assert float(expected["minicam_near_far"][0]) == splatting.NEAR
    for i, (elevation, azimuth, radius) in enumerate(expected["minicam_args"].tolist()):
        pose = orbit(elevation, azimuth, radius)
        np.testing.assert_allclose(to_opencv(pose).T, expected["minicam_world_view"][i], **CLOSE)
        np.testing.assert_allclose(-pose[:3, 3], expected["minicam_center"][i], **CLOSE)
        homogeneous = np.c_[points, np.ones(10)] @ expected["minicam_full_proj"][i].numpy()
        ndc = homogeneous[:, :2] / homogeneous[:, 3:]
        view = View(torch.from_numpy(to_opencv(pose)), 100 * 2.18923, 200, 200)
        centres, depths, _ = project(points, ones, ones[:, :3], view)
        np.testing.assert_allclose(centres, 100 * (1 + ndc), rtol=1e-3, atol=0.01)
        np.testing.assert_allclose(depths, homogeneous[:, 3], rtol=1e-4)


def test_noise_levels_and_pose_embedding_equal_the_original(expected):
    levels = [timestep(float(ratio)) for ratio in expected["sds_ratio"]]
    assert levels == expected["sds_t"].tolist()
    poses = [Pose(10, 30, 0), Pose(-25, -140, 0)]
    for stable in (False, True):
        ours = zero123.pose_embedding(poses, stable=stable, elevation=-5)
        np.testing.assert_allclose(ours, expected[f"sds_T_stable{int(stable)}"], **CLOSE)


def test_picture_preparation_equals_the_original(folder):
    ops = np.load(folder / "image_ops.npz")
    np.testing.assert_array_equal(framed(ops["rembg_putalpha"]), ops["dg_process_256"])


def test_ply_of_the_original_enters_at_our_size(folder, expected):
    path = folder / "dreamgaussian_model.ply"
    read = read_ply(path, dialect="dreamgaussian").gaussians
    ours = Splats({k: expected["final_" + v] for k, v in NAMES.items()}).gaussians()
    np.testing.assert_allclose(read.means, ours.means, **CLOSE)
    np.testing.assert_allclose(read.covariances(), ours.covariances(), **CLOSE)
    np.testing.assert_allclose(read.sh, ours.sh, **CLOSE)
    made = PlyFile(str(path), dialect="dreamgaussian")()
    assert np.ptp(made.means, axis=0).max() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(
    ("build", "table"),
    [(zero123.unet, "zero123_unet"), (zero123.vision, "zero123_clip_vit_l14")],
)
def test_zero123_has_the_public_shapes(folder, build, table):
    with torch.device("meta"):
        shapes = {k: list(v.shape) for k, v in build().state_dict().items()}
    assert shapes == json.loads((folder / f"tables/{table}.json").read_text())["shapes"]


# --- the rasterizer -----------------------------------------------------------------------------


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


def test_unseen_gaussians_are_told():
    splats = random_splats(4)
    splats[0] = torch.tensor([[0.0, 0, 0], [0, 0, 5], [0, 0, 1.0], [3, 0, 0]]).double()
    drawn = rasterize(*splats, orbit_view(0, 0, 2, 16), torch.zeros(3).double())
    assert (drawn.radii > 0).tolist() == [True, False, True, False]
    assert drawn.screen_gradients().abs().sum() == 0


def test_rotations_match_the_library(three_gaussians):
    from phy124.gaussians import rotation_matrices as ours

    quats = torch.from_numpy(three_gaussians.quats) * 3
    np.testing.assert_allclose(rotation_matrices(quats), ours(three_gaussians.quats), atol=1e-6)


# --- the optimiser ------------------------------------------------------------------------------


class Target:
    """A guidance that knows the truth: mean squared error in the picture from the same pose."""

    views = 1

    def __init__(self, truth: Splats, radius: float):
        self.truth, self.radius = truth, radius

    def __call__(self, images, poses, ratio, draw):
        del ratio, draw
        (pose,) = poses
        # The corner is background: white or black.
        background = images[0, :, 0, 0].detach().round()
        return (10_000 * (images[0] - self.picture(pose, images.shape[-1], background)) ** 2).mean()

    @torch.no_grad()
    def picture(self, pose, size, background):
        view = orbit_view(pose.elevation, pose.azimuth, self.radius, size)
        return self.truth.render(view, background).rgb.permute(2, 0, 1)


def simple_object() -> Splats:
    """Two touching balls, red above blue, and a green one in front."""
    points = torch.tensor([[0, 0.3, 0], [0, -0.2, 0], [0.1, 0, 0.35]])
    colors = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.2, 0.9], [0.1, 0.8, 0.2]])
    splats = Splats.from_points(points, colors)
    splats.overwrite("scaling", torch.tensor([0.16, 0.2, 0.1]).log()[:, None].repeat(1, 3))
    splats.overwrite("opacity", torch.full((3, 1), 4.0))
    return splats


def test_known_views_of_a_simple_object_are_reconstructed():
    """A toy guidance in image space: from 32 pixel views, held-out views reach 25 dB."""
    truth = simple_object()
    settings = Settings(
        steps=120,
        points=150,
        known_size=32,
        sizes=(32,),
        rates=Rates(steps=120),
        density=Density(start=20, every=40, gradient=0.5),
    )
    guidance, draw = Target(truth, settings.radius), torch.Generator().manual_seed(0)
    white = torch.ones(3)
    with torch.no_grad():
        front = truth.render(orbit_view(0, 0, settings.radius, 32), white)
    known = (front.rgb.permute(2, 0, 1), front.alpha)
    splats, steps = start(settings, draw), []
    before = held_out(splats, guidance)
    fit(splats, guidance, settings, draw, known=known, progress=lambda *told: steps.append(told))
    after = held_out(splats, guidance)
    assert after > 25 > before + 5, (before, after, len(splats))
    assert len(splats) != settings.points
    assert steps[0] == ("dreamgaussian", 0, 120) and steps[-1] == ("dreamgaussian", 120, 120)


@torch.no_grad()
def held_out(splats: Splats, guidance: Target) -> float:
    """Mean PSNR [dB] over views that no step is sure to have shown."""
    white, ratios = torch.ones(3), []
    for azimuth in (45, 135, 225, 315):
        wanted = guidance.picture(Pose(-10, azimuth, 0), 48, white)
        drawn = splats.render(orbit_view(-10, azimuth, guidance.radius, 48), white).rgb
        error = (drawn.permute(2, 0, 1) - wanted).square().mean()
        ratios.append(-10 * math.log10(float(error)))
    return sum(ratios) / len(ratios)


def test_generator_returns_gaussians_of_our_size():
    settings = Settings(steps=3, points=60, known_size=24, sizes=(16, 24), density=Density(start=9))
    guidance = Target(simple_object(), settings.radius)
    picture = np.zeros((30, 30, 4), np.uint8)
    picture[5:25, 8:22] = 200, 40, 40, 255
    generator = DreamGaussian(guidance=lambda image: guidance, settings=settings, device="cpu")
    made, again = generator(picture, seed=1), generator(picture, seed=1)
    np.testing.assert_array_equal(made.means, again.means)
    assert np.ptp(made.means, axis=0).max() == pytest.approx(1, abs=0.05)

    def progress(stage, done, total):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        generator(picture, progress=progress)
    bare = replace(settings, final_extent=1e-3)
    with pytest.raises(InputError, match="no Gaussian was left"):
        DreamGaussian(guidance=lambda image: guidance, settings=bare, device="cpu")(picture)
    for bad in (picture[..., :3], np.zeros((9, 9, 4), np.uint8)):
        with pytest.raises(InputError):
            generator(bad)


def test_missing_weights_name_the_command(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    with pytest.raises(InputError, match=r"phy124 weights fetch zero123"):
        DreamGaussian(weights=tmp_path)(np.full((8, 8, 4), 255, np.uint8))


def test_momenta_follow_their_gaussians():
    splats = Splats.from_points(ball(8, 1.0, torch.Generator().manual_seed(0)), torch.rand(8, 3))
    (splats.parameters["xyz"] * torch.arange(8.0)[:, None]).sum().backward()
    for name in ("f_dc", "opacity", "scaling", "rotation"):
        splats.parameters[name].grad = torch.ones_like(splats.parameters[name])
    splats.step()
    splats.keep(torch.arange(8) % 2 == 1)
    splats.append({k: v[:1].detach() for k, v in splats.parameters.items()})
    state = splats.optimizer.state[splats.parameters["xyz"]]
    torch.testing.assert_close(state["exp_avg"][:, 0], torch.tensor([0.1, 0.3, 0.5, 0.7, 0.0]))
    assert density_module.SHRINK == 1.6


def test_points_fill_a_ball_evenly():
    r = ball(20000, 0.5, torch.Generator().manual_seed(0)).norm(dim=1)
    assert float(r.max()) <= 0.5
    assert float((r < 0.25).float().mean()) == pytest.approx(1 / 8, abs=0.01)


# --- guidance -----------------------------------------------------------------------------------


def test_sds_has_the_stated_gradient_and_value():
    latents = torch.randn(2, 4, 3, 3, requires_grad=True)
    predicted, noise = torch.randn(2, 2, 4, 3, 3)
    loss = sds(latents, predicted, noise, 0.7)
    loss.backward()
    torch.testing.assert_close(latents.grad, 0.7 * (predicted - noise))
    torch.testing.assert_close(loss, 0.5 * (0.7 * (predicted - noise)).square().sum())


def test_noise_schedule_is_that_of_the_sampler(folder):
    golden = np.load(folder / "imagedream_pipeline.npz")["alphas_cumprod"]
    np.testing.assert_allclose(alphas_cumprod(), golden, rtol=1e-4)
    x, n = torch.ones(2), torch.full((2,), 2.0)
    alpha = float(golden[500])
    torch.testing.assert_close(noised(x, n, 500), x * alpha**0.5 + n * (1 - alpha) ** 0.5)


SMALL = {
    "unet": {"block_out_channels": (32, 32), "layers_per_block": 1, "cross_attention_dim": 768}
    | {"down_block_types": ("CrossAttnDownBlock2D", "DownBlock2D")}
    | {"up_block_types": ("UpBlock2D", "CrossAttnUpBlock2D"), "attention_head_dim": 8},
    "vision": {"hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2}
    | {"num_attention_heads": 2},
}


@pytest.fixture(scope="module")
def small_zero123(folder):
    from phy124.generators.imagedream import encoders

    torch.manual_seed(0)
    small_vae = {"block_out_channels": [32, 32, 32, 32], "layers_per_block": 1}
    return {
        "unet": zero123.unet(**SMALL["unet"]),
        "vae": encoders.vae(folder / "vae_tiny.weights.fp16.safetensors", **small_vae).float(),
        "vision": zero123.vision(**SMALL["vision"]),
        "projection": zero123.CameraProjection().requires_grad_(False),
    }


def test_zero123_gradient_is_guided_noise_difference(small_zero123, monkeypatch):
    calls = []
    unet = small_zero123["unet"]

    def recording(x, t, encoder_hidden_states):
        calls.append((x, t, encoder_hidden_states))
        return unet(x, t, encoder_hidden_states=encoder_hidden_states)

    guidance = zero123.Zero123(torch.rand(3, 40, 40), {**small_zero123, "unet": recording})
    image = torch.rand(1, 3, 32, 32, requires_grad=True)
    guidance(image, [Pose(10, 30, 0)], 0.37, torch.Generator().manual_seed(1)).backward()
    ((x, t, context),) = calls
    assert t.tolist() == [630, 630] and x.shape == (2, 8, 32, 32) and context.shape == (2, 1, 768)
    torch.testing.assert_close(x[0, :4], x[1, :4])
    # The conditioned half comes first; the other sees neither picture nor pose.
    assert x[0, 4:].abs().sum() > 0 and x[1, 4:].abs().sum() == 0 and context[1].abs().sum() == 0
    assert float(image.grad.abs().sum()) > 0
    with_it, without = unet(x, t, encoder_hidden_states=context).sample.chunk(2)
    torch.testing.assert_close(
        guidance._noise(x[:1, :4], 630, [Pose(10, 30, 0)]), without + 5 * (with_it - without)
    )


def test_zero123_networks_load_from_files(small_zero123, tmp_path, monkeypatch):
    from phy124 import weights

    folder = tmp_path / "zero123-xl-diffusers"
    for name, part in (("unet", "unet"), ("image_encoder", "vision"), ("vae", "vae")):
        file = "model" if name == "image_encoder" else "diffusion_pytorch_model"
        (folder / name).mkdir(parents=True)
        tensors = {k: v.contiguous() for k, v in small_zero123[part].state_dict().items()}
        save_file(tensors, folder / name / f"{file}.fp16.safetensors")
    (folder / "clip_camera_projection").mkdir()
    path = folder / "clip_camera_projection/diffusion_pytorch_model.fp16.safetensors"
    save_file(small_zero123["projection"].state_dict(), path)
    assert weights.have("zero123", tmp_path)
    # Full-size networks refuse the small files by name.
    with pytest.raises(InputError, match="not those of Zero123's U-Net, which has 686"):
        zero123.trained(tmp_path, "cpu", torch.float32)


class SeenParts:
    """ImageDream's golden networks with made-up encoders."""

    def __init__(self, unet, vae):
        self.unet, self.vae = unet, vae

    def text(self):
        return formula.inputs("text", (1, 77, 16), -1, 1)

    def picture(self, image):
        return formula.inputs("tokens", (1, 257, 1280), -1, 1)


def test_imagedream_guidance_pulls_four_views(folder, small_zero123):
    config = json.loads((folder / "imagedream_unet_tiny.json").read_text())["config"]
    unet = load_unet(folder / "imagedream_unet_tiny.weights.fp16.safetensors", **config)
    guidance = MultiView.looking_at(torch.rand(3, 20, 20), SeenParts(unet, small_zero123["vae"]))
    images = torch.rand(4, 3, 32, 32, requires_grad=True)
    poses = [Pose(-5, azimuth, 0) for azimuth in (10, 100, 190, 280)]
    loss = guidance(images, poses, 0.5, torch.Generator().manual_seed(0))
    loss.backward()
    per_view = images.grad.abs().sum(dim=(1, 2, 3))
    assert guidance.views == 4 and float(per_view.min()) > 0 and bool(loss.isfinite())
    settings = replace(WITH_IMAGEDREAM, steps=1, points=40, sizes=(16,), final_extent=10)
    draw = torch.Generator().manual_seed(0)
    splats = start(settings, draw)
    before = splats.parameters["xyz"].detach().clone()
    fit(splats, guidance, settings, draw)
    assert float((splats.parameters["xyz"] - before).detach().abs().max()) > 1e-3
