"""DreamGaussian: the original's arithmetic, and an optimiser that works."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from phy124.errors import Cancelled, InputError
from phy124.generators.neural import splatting
from phy124.generators.neural.dreamgaussian import splats as density_module
from phy124.generators.neural.dreamgaussian import zero123
from phy124.generators.neural.dreamgaussian.generator import (
    DreamGaussian,
    Settings,
    fit,
    frame_cutout,
    start,
)
from phy124.generators.neural.dreamgaussian.guidance import Pose, timestep
from phy124.generators.neural.dreamgaussian.splats import (
    Density,
    Pull,
    Rates,
    Splats,
    ball,
    densify,
    prune,
    reset_opacity,
)
from phy124.generators.neural.orbit import orbit, to_opencv
from phy124.generators.neural.splatting import View, orbit_view, project
from phy124.generators.ply_file import PlyFile, Reading
from phy124.io.ply import read_ply

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
    np.testing.assert_allclose(zero123.pose_embedding(poses), expected["sds_T_stable0"], **CLOSE)


def test_picture_preparation_equals_the_original(folder):
    ops = np.load(folder / "image_ops.npz")
    np.testing.assert_array_equal(frame_cutout(ops["rembg_putalpha"]), ops["dg_process_256"])


def test_ply_of_the_original_enters_at_our_size(folder, expected):
    path = folder / "dreamgaussian_model.ply"
    read = read_ply(path, dialect="dreamgaussian").gaussians
    ours = Splats({k: expected["final_" + v] for k, v in NAMES.items()}).gaussians()
    np.testing.assert_allclose(read.means, ours.means, **CLOSE)
    np.testing.assert_allclose(read.covariances(), ours.covariances(), **CLOSE)
    np.testing.assert_allclose(read.sh, ours.sh, **CLOSE)
    made = PlyFile(str(path), Reading(dialect="dreamgaussian"))()
    assert np.ptp(made.means, axis=0).max() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(
    ("build", "table"), [(zero123.unet, "zero123_unet"), (zero123.vision, "zero123_clip_vit_l14")]
)
def test_zero123_has_the_public_shapes(folder, build, table):
    with torch.device("meta"):
        shapes = {k: list(v.shape) for k, v in build().state_dict().items()}
    assert shapes == json.loads((folder / f"tables/{table}.json").read_text())["shapes"]


# --- the optimiser ------------------------------------------------------------------------------


class Target:
    """A guidance that knows the truth: mean squared error in the picture from the same pose."""

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


@pytest.mark.slow
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
    fit(splats, guidance, settings, draw, known, progress=lambda *step: steps.append(step))
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
    with pytest.raises(InputError, match="no Gaussian remained"):
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
