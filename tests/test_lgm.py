"""LGM against the original program's outputs, and its way into this project's world."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from phy124.errors import Cancelled, InputError
from phy124.gaussians import Gaussians, rotation_matrices
from phy124.generators.neural.lgm import generator as generator_module
from phy124.generators.neural.lgm import model as lgm_model
from phy124.generators.neural.lgm.generator import (
    Lgm,
    find_front,
    four_views,
    frame_cutout,
    network_input,
    over_white,
    to_gaussians,
)
from phy124.generators.neural.lgm.model import (
    NOT_ROTATED,
    OPTIONS,
    LgmModel,
    Option,
    activate,
    draw_rows,
    four_rays,
    judge,
    load,
    pluecker,
    remove_rotations,
)
from phy124.generators.neural.lgm.unet import UNet
from phy124.generators.neural.orbit import orbit, to_opencv
from phy124.generators.neural.splatting import View, project
from phy124.io.ply import read_ply
from reference import formula
from reference.formula import TINY

CLOSE = {"rtol": 1e-4, "atol": 2e-5}


@pytest.fixture(scope="module")
def golden_lgm(golden):
    return golden / "generators"


@pytest.fixture(scope="module")
def tiny() -> LgmModel:
    with torch.device("meta"):
        model = LgmModel(TINY)
    return load(formula.state_dict(model), TINY)


def test_formula_weights_equal_the_golden_recipe(golden_lgm):
    recipe = np.load(golden_lgm / "hash_recipe.npz")
    key = "unet.conv_in.weight"
    np.testing.assert_allclose((formula.uniform(key, 16) + 1) / 2, recipe["u01"], rtol=1e-12)
    np.testing.assert_array_equal(formula.weight(key, (64, 9, 3, 3))[:2], recipe["conv_w"])
    for name, key in (
        ("norm_w", "unet.norm_out.weight"),
        ("bias", "unet.conv_in.bias"),
        ("running_var", "stage1.rebnconvin.bn_s1.running_var"),
    ):
        np.testing.assert_array_equal(formula.weight(key, recipe[name].shape), recipe[name])
    x = formula.inputs("lgm_hash/x", (4, 9, 64, 64), -1, 1)
    np.testing.assert_array_equal(x[0, :, ::16, ::16], recipe["x"])
    for key, value in load_file(golden_lgm / "lgm_full.weights.fp16.safetensors").items():
        np.testing.assert_array_equal(formula.weight(key, tuple(value.shape)), value.float())


@pytest.mark.parametrize("name", ["sym", "noattn"])
def test_unet_equals_the_original_block_by_block(golden_lgm, name):
    config = json.loads((golden_lgm / f"lgm_unet_{name}.json").read_text())["config"]
    unet = UNet(**config)
    weights = load_file(golden_lgm / f"lgm_unet_{name}.weights.fp16.safetensors")
    unet.load_state_dict({k: v.float() for k, v in weights.items()})
    expected = np.load(golden_lgm / f"lgm_unet_{name}.npz")
    taps = {}
    for key in expected.files:
        if key.startswith("tap."):
            block = unet.get_submodule(key.removeprefix("tap."))
            block.register_forward_hook(lambda _m, _i, out, key=key: taps.update({key: out}))
    with torch.inference_mode():
        y = unet(torch.from_numpy(expected["x"]))
    np.testing.assert_allclose(y, expected["y"], **CLOSE)
    assert len(taps) >= 6
    for key, out in taps.items():
        out = out[0] if isinstance(out, tuple) else out
        np.testing.assert_allclose(out[:, ::8, ::4, ::4], expected[key], **CLOSE)


def test_whole_network_equals_the_original(golden_lgm, tiny):
    expected = np.load(golden_lgm / "lgm_full.npz")
    images = torch.from_numpy(expected["img"][0])
    with torch.inference_mode():
        x = network_input(images)[None]
        np.testing.assert_allclose(x, expected["input"], **CLOSE)
        raw = tiny.conv(tiny.unet(torch.from_numpy(expected["input"][0])))
        np.testing.assert_allclose(raw, expected["raw14"], **CLOSE)
        np.testing.assert_allclose(tiny(x), expected["gaussians"], **CLOSE)
        old = activate(raw[None], "all")
    np.testing.assert_allclose(old, expected["gaussians_oldrot"], **CLOSE)


def test_file_and_state_dict_load_alike(golden_lgm, tiny):
    from_file = load(golden_lgm / "lgm_full.weights.fp16.safetensors", TINY)
    for key, value in tiny.state_dict().items():
        torch.testing.assert_close(from_file.state_dict()[key], value, rtol=0, atol=0)


def test_activation_equals_the_original(golden_lgm):
    expected = np.load(golden_lgm / "lgm_post.npz")
    rows = activate(torch.from_numpy(expected["raw"]))
    np.testing.assert_allclose(rows, expected["gaussians"], **CLOSE)


def test_opacity_filter_keeps_what_the_original_saves(golden_lgm):
    expected = np.load(golden_lgm / "lgm_post.npz")
    kept, rows = to_gaussians(expected["ply_input"][0]), expected["ply_loaded_activated"]
    np.testing.assert_allclose(kept.means, rows[:, [2, 0, 1]], **CLOSE)
    np.testing.assert_allclose(kept.opacities, rows[:, 3], **CLOSE)
    np.testing.assert_allclose(kept.scales, rows[:, [6, 4, 5]], **CLOSE)
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * kept.sh[:, 0], rows[:, 11:], **CLOSE)


def test_views_without_visible_gaussians_are_refused():
    with pytest.raises(InputError, match="opacity of all Gaussians is below"):
        to_gaussians(np.full((5, 14), 0.001, np.float32))


def test_ply_of_the_original_reads_as_our_gaussians(golden_lgm):
    rows = np.load(golden_lgm / "lgm_post.npz")["ply_input"][0]
    ours = to_gaussians(rows)
    read = read_ply(golden_lgm / "lgm_gaussians.ply", dialect="lgm").gaussians
    np.testing.assert_allclose(read.means, ours.means, **CLOSE)
    np.testing.assert_allclose(read.covariances(), ours.covariances(), **CLOSE)
    np.testing.assert_allclose(read.opacities, ours.opacities, **CLOSE)
    np.testing.assert_allclose(read.rgb, ours.rgb, **CLOSE)


def test_raw_ply_of_the_original_holds_our_activated_rows(golden_lgm):
    """The original can also save without logarithms: the same rows, the same filter."""
    rows = np.load(golden_lgm / "lgm_post.npz")["ply_input"][0]
    content = (golden_lgm / "lgm_gaussians_raw.ply").read_bytes().partition(b"end_header\n")[2]
    x = np.frombuffer(content, "<f4").reshape(-1, 14)
    ours = to_gaussians(rows)
    np.testing.assert_allclose(x[:, [2, 0, 1]], ours.means, **CLOSE)
    np.testing.assert_allclose(x[:, 6], ours.opacities, **CLOSE)
    np.testing.assert_allclose(x[:, [9, 7, 8]], ours.scales, **CLOSE)


def test_rays_equal_the_original(golden_lgm):
    expected = np.load(golden_lgm / "lgm_cameras.npz")
    for size in (32, 64):
        np.testing.assert_allclose(four_rays(size), expected[f"rays_{size}"], **CLOSE)
    below = four_rays(32, elevation=-20)
    np.testing.assert_allclose(below, expected["rays_32_elev_minus20"], **CLOSE)
    large = four_rays(256).astype(np.float64)
    np.testing.assert_allclose(large[..., ::16, ::16], expected["rays_256_stride16"], **CLOSE)
    sums, sizes = large.sum(axis=(2, 3)), np.abs(large).sum(axis=(2, 3))
    np.testing.assert_allclose(sums, expected["rays_256_sum64"], rtol=1e-4, atol=0.05)
    np.testing.assert_allclose(sizes, expected["rays_256_abs64"], rtol=1e-4)
    default = [orbit(0, azimuth, 1.5) for azimuth in (0, 90, 180, 270)]
    np.testing.assert_allclose(default, expected["default_poses_c2w"], **CLOSE)


def test_orbit_equals_the_original(golden_lgm):
    expected = np.load(golden_lgm / "lgm_cameras.npz")
    for arguments, pose in zip(expected["orbit_args"], expected["orbit_c2w"], strict=True):
        np.testing.assert_allclose(orbit(*arguments), pose, **CLOSE)


def test_video_cameras_equal_the_original(golden_lgm, rng):
    expected = np.load(golden_lgm / "lgm_cameras.npz")
    points = rng.normal(size=(20, 3)) * 0.3
    focal = 256 * expected["video_proj_rowvec"][0, 0]
    for i, azimuth in enumerate(expected["video_azimuth"]):
        pose = orbit(0, float(azimuth), 1.5)
        np.testing.assert_allclose(to_opencv(pose).T, expected["video_cam_view_rowvec"][i], **CLOSE)
        np.testing.assert_allclose(-pose[:3, 3], expected["video_cam_pos"][i], **CLOSE)
        clip = np.c_[points, np.ones(20)] @ expected["video_cam_view_proj_rowvec"][i]
        view = View(torch.from_numpy(to_opencv(pose)), float(focal), 512, 512)
        ones = torch.ones(20, 4, dtype=torch.float64)
        centres, _, _ = project(torch.from_numpy(points), ones, ones[:, :3], view)
        np.testing.assert_allclose(
            centres, (clip[:, :2] / clip[:, 3:] + 1) * 256, rtol=1e-4, atol=1e-3
        )


def test_rays_are_pluecker_coordinates():
    rays = pluecker(orbit(15, 40, 1.5), 8).reshape(6, -1)
    np.testing.assert_allclose(np.linalg.norm(rays[3:], axis=0), 1, rtol=1e-6)
    np.testing.assert_allclose((rays[:3] * rays[3:]).sum(axis=0), 0, atol=1e-6)


@pytest.mark.parametrize("option", OPTIONS)
def test_keys_and_shapes_are_those_of_the_public_files(golden_lgm, option):
    table = json.loads((golden_lgm / f"tables/lgm_{option}.json").read_text())["shapes"]
    with torch.device("meta"):
        model = LgmModel(OPTIONS[option])
    assert {k: list(v.shape) for k, v in model.state_dict().items()} == table


def test_wrong_option_or_tensors_are_refused(tiny):
    with pytest.raises(InputError, match=r"lrm, small, big, tiny"):
        load({}, "huge")
    with pytest.raises(
        InputError, match=r"differ from the 376 tensors of LGM, option big: 2\d\d m"
    ):
        load(tiny.state_dict(), "big")


def test_foreign_and_truncated_files_are_refused(tmp_path):
    for name in ("cut.safetensors", "cut.pth"):
        (tmp_path / name).write_bytes(b"\x10\0\0\0\0\0\0\0no weights")
        with pytest.raises(InputError, match="cut short or of another kind"):
            load(tmp_path / name)
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "absent.safetensors")


def test_pth_loads_without_running_code(tmp_path, tiny):
    torch.save(tiny.state_dict(), tmp_path / "good.pth")
    assert load(tmp_path / "good.pth", TINY).conv.weight.equal(tiny.conv.weight)
    torch.save({"weight": Option}, tmp_path / "bad.pth")
    with pytest.raises(InputError, match="cannot be read as tensors"):
        load(tmp_path / "bad.pth", TINY)


def test_old_generation_is_known_by_checksum_and_not_rotated(tmp_path, tiny, monkeypatch):
    path = tmp_path / "old.safetensors"
    save_file(tiny.state_dict(), path)
    monkeypatch.setitem(lgm_model.GENERATIONS, lgm_model.compute_sha256(path), "all")
    model = load(path, TINY)
    assert model.rotations == "all"
    rows = model(torch.rand(1, 4, 9, 32, 32))
    torch.testing.assert_close((rows[0, :, 7:11] ** 2).sum(0), torch.ones(4))
    with pytest.warns(UserWarning, match=r"first published version.*phy124 weights fetch lgm"):
        made = Lgm(model=model, device="cpu").from_views(torch.rand(4, 3, 32, 32))
    np.testing.assert_array_equal(made.quats, np.tile(NOT_ROTATED, (len(made), 1)))


def test_unknown_generation_is_judged_by_what_it_draws(rng):
    n = 300
    rows = torch.zeros(n, 14)
    rows[:, :3] = torch.from_numpy(rng.normal(size=(n, 3)) * 0.25)
    rows[:, 3], rows[:, 4:7] = 0.9, torch.tensor([0.1, 0.02, 0.02])
    rows[:, 7:11] = torch.from_numpy(rng.normal(size=(n, 4)))
    rows[:, 11:] = torch.from_numpy(rng.random((n, 3)))
    for truth, meaning in ((rows, "each"), (remove_rotations(rows), "all")):
        views = torch.stack([draw_rows(truth, azimuth, 128) for azimuth in (0, 90, 180, 270)])
        assert judge(rows, views) == meaning
    assert remove_rotations(rows)[0, 7:11].tolist() == list(NOT_ROTATED)


def test_front_is_found_where_the_picture_was_taken(rng):
    rows = torch.zeros(60, 14)
    rows[:, :3] = torch.from_numpy(rng.normal(size=(60, 3)) * 0.3)
    rows[:, 3:7], rows[:, 7] = torch.tensor([0.9, 0.06, 0.06, 0.06]), 1
    rows[:, 11:] = torch.from_numpy(rng.random((60, 3)))
    assert find_front(rows, draw_rows(rows, 130, 64), step=10, side=32) == 130
    views = four_views(rows, 130, 32)
    torch.testing.assert_close(views[1], draw_rows(rows, 220, 32))


def test_front_view_arrives_as_our_front(rng):
    """LGM's camera 0 and phy124's camera on +x see the same picture: right stays right, up stays
    up."""
    rows = np.zeros((1, 14), np.float32)
    rows[0, :4] = 0.3, 0.2, 0.1, 1  # right, up, towards the camera
    rows[0, 4:8] = 0.1, 0.2, 0.3, 1
    made = to_gaussians(rows)
    np.testing.assert_allclose(made.means, [[0.1, 0.3, 0.2]], atol=1e-6)
    np.testing.assert_allclose(np.diag(made.covariances()[0]), [0.09, 0.01, 0.04], atol=1e-6)
    assert np.linalg.det(rotation_matrices(made.quats)[0]) > 0


def test_generator_uses_the_views_in_lgm_order(tiny, rng):
    made = {}

    def multiview(image, *, seed, progress):
        del progress
        made["image"], made["seed"] = image, seed
        return torch.linspace(0, 1, 5)[:, None, None, None].expand(5, 3, 32, 32)

    seen = []
    generator = Lgm(model=tiny, multiview=multiview, device="cpu")
    tiny.rotations = "each"
    hook = tiny.register_forward_pre_hook(lambda _m, x: seen.append(x[0]))
    cut = (rng.random((40, 40, 4)) * 255).astype(np.uint8)
    gaussians = generator(cut, seed=7)
    hook.remove()
    assert isinstance(gaussians, Gaussians) and len(gaussians) == 1024
    assert np.ptp(gaussians.means, axis=0).max() == pytest.approx(1, abs=0.05)
    assert made["seed"] == 7 and made["image"].shape == (3, 40, 40)
    red = seen[0][0, :, 0, 0, 0] * 0.229 + 0.485
    torch.testing.assert_close(red, torch.tensor([0.25, 0.5, 0.75, 0.0]), rtol=1e-5, atol=1e-6)


def test_alignment_reconstructs_twice(tiny):
    steps = []
    tiny.rotations = "each"
    generator = Lgm(model=tiny, device="cpu", align=True, align_step=90)
    views = torch.rand(4, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    first = Lgm(model=tiny, device="cpu").from_views(views)
    second = generator.from_views(
        views, image=views[1], progress=lambda stage, done, total: steps.append(stage)
    )
    assert steps.count("align") == 5
    assert steps.count("lgm") in (2, 4) and len(second) == len(first)


def test_half_precision_gives_the_same_object(golden_lgm, tiny):
    half = load(tiny.state_dict(), TINY, dtype=torch.float16)
    x = torch.from_numpy(np.load(golden_lgm / "lgm_full.npz")["input"])
    with torch.inference_mode():
        a, b = tiny(x), half(x)
    assert b.dtype == torch.float32
    torch.testing.assert_close(a[..., :7], b[..., :7], rtol=0.02, atol=0.02)


def test_cut_out_is_laid_over_white():
    image = np.zeros((4, 4, 4), np.uint8)
    image[:2] = 10, 20, 30, 255
    white = over_white(image)
    torch.testing.assert_close(white[:, 0, 0] * 255, torch.tensor([10.0, 20.0, 30.0]))
    assert white[:, 3, 3].tolist() == [1, 1, 1]
    with pytest.raises(InputError, match="four channels"):
        frame_cutout(image[..., :3])
    with pytest.raises(InputError, match="no object"):
        frame_cutout(np.zeros((4, 4, 4), np.uint8))


def test_preparation_of_the_picture_equals_the_original(golden_lgm):
    ops = np.load(golden_lgm / "image_ops.npz")
    ours = over_white(ops["recenter_uint8"]).permute(1, 2, 0)
    np.testing.assert_allclose(ours, ops["lgm_white_bg"], **CLOSE)
    square = frame_cutout(ops["rembg_putalpha"])
    np.testing.assert_array_equal(square, ops["lgm_pre_recentered"])
    np.testing.assert_allclose(over_white(square).permute(1, 2, 0), ops["lgm_pre_final"], **CLOSE)


def test_cancelling_stops_between_stages(tiny):
    def progress(stage, done, total):
        raise Cancelled

    with pytest.raises(Cancelled):
        Lgm(model=tiny, device="cpu").from_views(torch.rand(4, 3, 32, 32), progress=progress)


def test_missing_weights_name_the_command(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    with pytest.raises(InputError, match=r"phy124 weights fetch imagedream.*relief"):
        Lgm(weights=tmp_path)(np.full((8, 8, 4), 255, np.uint8))
    with pytest.raises(InputError, match=r"phy124 weights fetch lgm.*relief"):
        Lgm(weights=tmp_path).from_views(torch.zeros(4, 3, 8, 8))


def test_from_weight_files_to_gaussians(golden_lgm, tiny, tmp_path, monkeypatch):
    """The files a user has, in small: found, read and run from a picture to Gaussians."""
    from phy124.generators.neural.imagedream import encoders, pipeline
    from phy124.weights import store as weights

    monkeypatch.setattr(encoders, "VAE", encoders.VAE | SMALL["vae"])
    monkeypatch.setattr(encoders, "TEXT", encoders.TEXT | SMALL["text"])
    monkeypatch.setattr(encoders, "VISION", encoders.VISION | SMALL["vision"])
    config = json.loads((golden_lgm / "imagedream_unet_tiny.json").read_text())["config"]
    monkeypatch.setattr(pipeline, "load_unet", partial(pipeline.load_unet, **config))
    for name in ("lgm-fp32", "imagedream"):
        free = tuple(replace(f, size=None, sha256=None) for f in weights.KNOWN[name])
        monkeypatch.setitem(weights.KNOWN, name, free)
    copy = partial(put_tensors, tmp_path / "imagedream-ipmv-diffusers")
    unet = load_file(golden_lgm / "imagedream_unet_tiny.weights.fp16.safetensors")
    copy("unet/diffusion_pytorch_model.safetensors", unet)
    vae = load_file(golden_lgm / "vae_tiny.weights.fp16.safetensors")
    copy("vae/diffusion_pytorch_model.safetensors", vae)
    copy("text_encoder/model.safetensors", encoders.text_encoder().state_dict(), "text_model.")
    copy("image_encoder/model.safetensors", encoders.image_encoder().state_dict(), "vision_model.")
    put_tensors(tmp_path, weights.KNOWN["lgm-fp32"][0].path, tiny.state_dict())
    picture = np.zeros((40, 40, 4), np.uint8)
    picture[8:32, 12:28] = 200, 90, 30, 255
    monkeypatch.setattr(generator_module, "judge", lambda rows, views: "each")
    messages = []
    generator = Lgm(weights=tmp_path, option=TINY, device="cpu", steps=1)
    made = generator(picture, seed=5, progress=lambda *step: messages.append(step))
    assert messages == [("imagedream", 0, 1), ("imagedream", 1, 1), ("lgm", 0, 1), ("lgm", 1, 1)]
    assert len(made) == 1024 and np.isfinite(made.means).all()


SMALL = {
    "vae": {"block_out_channels": [32, 32, 32, 32], "layers_per_block": 1},
    "text": {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1}
    | {"num_attention_heads": 2},
    "vision": {"hidden_size": 1280, "intermediate_size": 64, "num_hidden_layers": 2},
}
"""Sizes that make ImageDream's surroundings small but still fit the golden U-Net."""


def put_tensors(folder, path, tensors, prefix=""):
    """Write a safetensors file as the public repositories have it, names with their prefix."""
    named = {prefix + k.removeprefix(prefix): v.contiguous() for k, v in tensors.items()}
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    save_file(named, folder / path, {"format": "pt"})


@pytest.mark.slow
def test_full_size_network_equals_the_original(golden_lgm):
    """The option `small` with weights by formula, 413 million of them."""
    expected = np.load(golden_lgm / "lgm_hash_small.npz")["y"]
    with torch.device("meta"):
        model = LgmModel(OPTIONS["small"])
    model = load(formula.state_dict(model), "small")
    with torch.inference_mode():
        y = model.conv(model.unet(formula.inputs("lgm_hash/x", (4, 9, 64, 64), -1, 1)))
    np.testing.assert_allclose(y, expected, **CLOSE)
