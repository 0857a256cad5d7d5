"""U2-Net against the original network and rembg."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file
from skimage import data

from phy124.errors import InputError
from phy124.imaging import u2net
from phy124.imaging.cutout import foreground
from phy124.imaging.matting import fit_edge
from phy124.imaging.u2net.network import WIDTHS, ConvBnRelu, U2Net
from phy124.imaging.u2net.network import load as build
from phy124.weights.store import KNOWN, compute_sha256, require
from reference import formula

SHIPPED = require("u2netp")
CLOSE = {"rtol": 1e-4, "atol": 2e-5}
SIZE = (201, 150)
"""Width and height of the golden picture."""


@pytest.fixture(scope="module")
def folder(golden):
    return golden / "generators"


@pytest.fixture(scope="module")
def ops(folder):
    return np.load(folder / "image_ops.npz")


@pytest.fixture(scope="module")
def small() -> U2Net:
    with torch.device("meta"):
        network = U2Net(WIDTHS["u2netp"])
    return build(formula.state_dict(network))


@pytest.fixture
def no_weights(tmp_path, monkeypatch):
    """Nothing is found but in `tmp_path / "weights"`."""
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setenv("PHY124_WEIGHTS", str(tmp_path / "weights"))
    (tmp_path / "weights").mkdir()
    return tmp_path / "weights"


def test_all_seven_outputs_equal_the_original(folder, small):
    arrays = np.load(folder / "u2netp.npz")
    with torch.inference_mode():
        outputs = small(torch.from_numpy(arrays["x64"]))
        odd = small(torch.from_numpy(arrays["x70"]))[0]
    for i, output in enumerate(outputs):
        np.testing.assert_allclose(output, arrays[f"d{i}"], **CLOSE)
    np.testing.assert_allclose(odd, arrays["d0_70x90"], **CLOSE)


def test_formula_weights_are_those_of_the_golden_file(folder, small):
    for key, value in load_file(folder / "u2netp.weights.fp16.safetensors").items():
        np.testing.assert_array_equal(small.state_dict()[key], value.float(), err_msg=key)


@pytest.mark.parametrize("name", WIDTHS)
def test_keys_and_shapes_are_those_of_the_public_files(folder, name):
    table = json.loads((folder / f"tables/{name}.json").read_text())["shapes"]
    with torch.device("meta"):
        network = U2Net(WIDTHS[name])
    assert {k: list(v.shape) for k, v in network.state_dict().items()} == table


def test_rembg_arithmetic_equals_rembg(ops):
    x = u2net.prepare_rembg(ops["rgb"])
    np.testing.assert_allclose(x[:, :, ::4, ::4], ops["rembg_input_rgb"], **CLOSE)
    np.testing.assert_allclose(x.sum(axis=(0, 2, 3)), ops["rembg_input_rgb_sum"], rtol=1e-5)
    mask = u2net.finish_rembg(ops["u2_pred"], SIZE)
    np.testing.assert_array_equal(mask, ops["rembg_mask"])
    np.testing.assert_array_equal(mask, ops["rembg_only_mask"])
    np.testing.assert_array_equal(u2net.multiply_mask(ops["rgb"], mask), ops["rembg_remove_rgb"])
    np.testing.assert_array_equal(u2net.multiply_mask(ops["rgb"], mask), ops["lgm_pre_carved"])
    np.testing.assert_array_equal(u2net.multiply_mask(ops["rgba"], mask), ops["rembg_remove_rgba"])
    straight = np.dstack([ops["rgb"], mask])
    np.testing.assert_array_equal(straight, ops["rembg_putalpha"])


def test_constant_answer_finds_nothing():
    mask = u2net.finish_rembg(np.full((1, 1, 320, 320), 0.7, np.float32), (10, 8))
    assert mask.shape == (8, 10) and not mask.any()


def test_end_to_end_through_pth_equals_rembg(folder, ops, small, tmp_path):
    torch.save(small.state_dict(), tmp_path / "u2netp.pth")
    check_end_to_end(u2net.load(tmp_path / "u2netp.pth"), folder, ops)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # torch's older ONNX exporter
def test_end_to_end_through_onnx_equals_rembg(folder, ops, small, tmp_path):
    path = tmp_path / "u2netp.onnx"
    torch.onnx.export(small, (torch.zeros(1, 3, 320, 320),), path, dynamo=False)
    check_end_to_end(u2net.load(path), folder, ops)


def check_end_to_end(network, folder, ops):
    """The mask is truncated to 8 bits, where the last float digit can turn one grey level."""
    expected = np.load(folder / "rembg_u2netp_e2e.npz")
    d0 = network(u2net.prepare_rembg(ops["rgb"]))
    np.testing.assert_allclose(d0[:, :, ::4, ::4], expected["d0"], **CLOSE)
    np.testing.assert_allclose(
        [d0.min(), d0.max()], [expected["d0_min"], expected["d0_max"]], **CLOSE
    )
    mask = u2net.foreground(ops["rgb"], network)
    for ours, theirs in ((mask, "mask"), (u2net.multiply_mask(ops["rgb"], mask), "rgba")):
        difference = np.abs(ours.astype(int) - expected[theirs])
        assert difference.max() <= 1 and (difference > 0).mean() < 1e-3


def test_best_file_of_the_full_network_is_chosen(no_weights):
    assert u2net.weights_file() is None and not u2net.is_available()
    (no_weights / "u2net.pth").write_bytes(b"")
    assert u2net.weights_file() == no_weights / "u2net.pth" and u2net.is_available()
    (no_weights / "u2net.onnx").write_bytes(b"")
    assert u2net.weights_file() == no_weights / "u2net.onnx" and u2net.is_available()


@pytest.mark.usefixtures("in_this_process")
def test_auto_takes_alpha_then_full_then_small_network(no_weights, small):
    rgb = np.full((60, 80, 3), 255, np.uint8)
    rgb[15:45, 20:60] = 40, 90, 160
    plain, cut = Image.fromarray(rgb), Image.fromarray(rgb).convert("RGBA")
    cut.putalpha(Image.fromarray(np.where(rgb[..., 0] < 255, 255, 0).astype(np.uint8)))
    cutout = foreground(plain)
    assert (cutout.method, cutout.title) == ("u2netp", "the small U2-Net")
    solid = np.asarray(cutout.picture)[..., 3] > 127
    assert ((rgb[..., 0] < 255) == solid).mean() > 0.98
    # Any network will do for the full one.
    torch.save(small.state_dict(), no_weights / "u2net.pth")
    cutout = foreground(plain)
    assert (cutout.method, cutout.title) == ("u2net", "U2-Net")
    answer = u2net.saliency(rgb, u2net.load(no_weights / "u2net.pth"))
    np.testing.assert_array_equal(np.asarray(cutout.picture)[..., 3], fit_edge(rgb, answer))
    assert foreground(cut).method == "alpha"


def test_the_small_network_cuts_photographs_out(no_weights):
    """Pictures in which GrabCut selects half of the cat, and all of the sky around the rocket."""
    path = SHIPPED["u2netp.onnx"]
    assert compute_sha256(path) == KNOWN["u2netp"][0].sha256
    for photo, shown, hidden in (
        (data.chelsea(), [(100, 100), (150, 250), (200, 250), (40, 160)], [(40, 420), (150, 440)]),
        (data.rocket(), [(160, 322), (250, 322), (350, 322)], [(100, 200), (60, 60), (250, 400)]),
    ):
        alpha = u2net._find_alpha(photo, path)
        assert [int(alpha[place]) for place in shown] == [255] * len(shown)
        assert [int(alpha[place]) for place in hidden] == [0] * len(hidden)


def test_a_blank_picture_shows_the_network_nothing():
    assert not u2net._find_alpha(
        np.full((400, 300, 3), (200, 30, 40), np.uint8), Path("none.onnx")
    ).any()


def test_missing_corrupt_and_foreign_files_are_refused(no_weights, tmp_path):
    with pytest.raises(InputError, match=r"u2net\.onnx .* was not found .*weights fetch u2net"):
        u2net.find_alpha(Image.new("RGB", (8, 8)))
    (tmp_path / "bad.onnx").write_bytes(b"no network")
    with pytest.raises(InputError, match="not a readable ONNX network"):
        u2net.load(tmp_path / "bad.onnx")
    save_file(ConvBnRelu(3, 4).state_dict(), tmp_path / "foreign.safetensors")
    with pytest.raises(InputError, match="differ from the 798 tensors of U2-Net"):
        u2net.load(tmp_path / "foreign.safetensors")


@pytest.mark.slow
def test_full_network_runs_at_full_size():
    """44 million weights by formula; the small network is the one compared with the original."""
    with torch.device("meta"):
        network = U2Net(WIDTHS["u2net"])
    network = build(formula.state_dict(network))
    with torch.inference_mode():
        outputs = network(formula.inputs("u2net/x64", (1, 3, 320, 320), -2, 2))
    assert [tuple(d.shape) for d in outputs] == [(1, 1, 320, 320)] * 7
    assert float(outputs[0].std()) > 0.01 and float(outputs[0].min()) > 0


def test_small_object_is_segmented_again_in_its_surroundings():
    """Gaps of two pixels in an image of 1280 close at the network's 320 pixels."""
    seen, shape = [], np.zeros((1280, 1280), bool)
    shape[400:700, 500:800] = True
    shape[420:680, 520:780:12] = shape[420:680, 521:780:12] = False
    rgb = np.where(shape[..., None], 250, 5).astype(np.uint8).repeat(3, axis=2)

    def network(x):
        seen.append(x.shape)
        return (x.mean(axis=1, keepdims=True) > 0).astype(np.float32)

    def overlap(probability):
        mask = cv2.resize(probability, (1280, 1280)) > 0.5
        return (mask & shape).sum() / (mask | shape).sum()

    coarse = u2net.saliency(rgb, network)
    assert overlap(u2net.look_closer(rgb, coarse, network)) > overlap(coarse) + 0.05
    large = rgb[380:720, 480:820]
    first = u2net.saliency(large, network)
    assert u2net.look_closer(large, first, network) is first
    assert len(seen) == 3


def blind_at_its_border(width):
    """A network that sees nothing within `width` of the 320 pixels from its border."""

    def network(x):
        mask = np.zeros((1, 1, 320, 320), np.float32)
        inner = np.s_[..., width:-width, width:-width]
        mask[inner] = (x.mean(axis=1, keepdims=True) > 0)[inner]
        return mask

    return network


def measure_overlap(mask, shape):
    solid = cv2.resize(mask, shape.shape[::-1]) > 0.5
    return (solid & shape).sum() / (solid | shape).sum()


@pytest.mark.parametrize(("side", "width"), [(300, 60), (60, 25)])
def test_parts_at_the_border_of_the_picture_are_kept(side, width):
    """The border cuts a large and a small object; the small one is also segmented closely."""
    shape = np.zeros((400, 400), bool)
    shape[:side, 200 - side // 2 : 200 + side // 2] = True
    rgb = np.where(shape[..., None], 250, 5).astype(np.uint8).repeat(3, axis=2)
    network = blind_at_its_border(width)
    first = u2net.saliency(rgb, network)
    second = u2net.look_beyond(rgb, first, network)
    assert measure_overlap(first, shape) < 0.85
    assert measure_overlap(u2net.look_closer(rgb, second, network), shape) > 0.95
