"""BiRefNet and IS-Net: the published inputs and outputs, the original processing, the refusals."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from phy124.errors import InputError
from phy124.imaging import salient
from phy124.imaging.cutout import METHODS, foreground
from phy124.imaging.salient import NETWORKS, find_mask, prepare, resize_sharply
from phy124.weights import store
from phy124.weights.onnx import OnnxNetwork

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
from reference.onnx_files import save_network

SIZE = 64


@pytest.fixture
def picture():
    """A red ellipse on noise."""
    y, x = np.mgrid[:90, :120]
    rgb = np.random.RandomState(1).randint(60, 120, (90, 120, 3)).astype(np.uint8)
    solid = ((x - 70) / 30) ** 2 + ((y - 40) / 20) ** 2 < 1
    rgb[solid] = (250, 40, 30)
    return Image.fromarray(rgb), solid


def save_red_detector(path, output="output_image"):
    """A network whose logits are large where red exceeds green by much."""
    weight = np.array([40.0, -40.0, 0.0], np.float32).reshape(1, 3, 1, 1)
    shapes = {"input_image": [1, 3, None, None]}, {output: [1, 1, None, None]}
    nodes = [
        ("Conv", ["input_image", "weight"], ["mixed"], {}),
        ("Sub", ["mixed", "level"], [output], {}),
    ]
    return save_network(path, *shapes, nodes, {"weight": weight, "level": np.float32(60.0)})


def put_weights(folder, monkeypatch, name):
    """Put a small network where the weights of a method are searched."""
    monkeypatch.setenv("PHY124_WEIGHTS", str(folder))
    (file,) = store.list_files(NETWORKS[name].weights)
    monkeypatch.setitem(store.KNOWN, NETWORKS[name].weights, (replace(file, size=None),))
    monkeypatch.setitem(NETWORKS, name, replace(NETWORKS[name], size=SIZE))
    return save_red_detector(folder / file.repo.rpartition("/")[2] / file.path)


def test_auto_prefers_the_finest_network(tmp_path, monkeypatch, picture):
    image, solid = picture
    order = ["alpha", "birefnet", "birefnet-512", "isnet", "u2net", "u2netp", "grabcut"]
    assert list(METHODS) == order
    for name in ("isnet", "birefnet"):
        put_weights(tmp_path, monkeypatch, name)
        monkeypatch.setattr(salient.isolated, "run", lambda f, *a, deadline: f(*a))
        cutout = foreground(image)
        assert (cutout.method, cutout.title) == (name, NETWORKS[name].title)
        cut = np.asarray(cutout.picture)[..., 3] > 127
        assert (cut == solid).mean() > 0.98


def test_too_little_memory_leaves_auto_without_it(tmp_path, monkeypatch):
    put_weights(tmp_path, monkeypatch, "isnet")
    assert salient.is_available("isnet")
    monkeypatch.setattr(salient, "free_memory", lambda: 1e8)
    assert not salient.is_available("isnet")


def test_missing_weights_name_the_command(tmp_path, monkeypatch, picture):
    monkeypatch.setenv("PHY124_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    assert not salient.is_available("birefnet")
    with pytest.raises(InputError, match="weights fetch birefnet-lite"):
        foreground(picture[0], "birefnet")


def test_other_files_are_refused(tmp_path):
    path = save_red_detector(tmp_path / "net.onnx", output="depth")
    with pytest.raises(InputError, match="should map input_image to mask"):
        OnnxNetwork(path, ["input_image"], ["mask"])
    with pytest.raises(InputError, match="does not accept these inputs"):
        OnnxNetwork(path)(np.zeros((1, 4, 8, 8), np.float32))
    path.write_bytes(b"no network")
    with pytest.raises(InputError, match="not a readable ONNX network"):
        OnnxNetwork(path)


def test_isnet_input_is_the_original_one(picture):
    """Bilinear without a wider filter, rounded down to 8 bits, minus one half."""
    rgb = np.asarray(picture[0])
    pixels = torch.tensor(rgb, dtype=torch.float32).permute(2, 0, 1)[None]
    small = torch.nn.functional.interpolate(pixels, [SIZE, SIZE], mode="bilinear")
    expected = (small.type(torch.uint8) / 255 - 0.5).numpy()
    made = prepare(rgb, replace(NETWORKS["isnet"], size=SIZE))
    assert (np.abs(made - expected) > 1e-6).mean() < 0.002  # values just below an integer
    assert np.abs(made - expected).max() < 1.01 / 255
    assert resize_sharply(rgb, SIZE).dtype == np.uint8


def test_birefnet_mask_is_the_sigmoid(tmp_path, picture):
    rgb = np.asarray(picture[0])
    network = replace(NETWORKS["birefnet"], size=SIZE)
    run = OnnxNetwork(save_red_detector(tmp_path / "net.onnx"))
    logits = run(prepare(rgb, network))[0][0, 0]
    mask = find_mask(np.asarray(picture[0].resize((SIZE, SIZE))), network, lambda x: [logits])
    np.testing.assert_allclose(mask / 255, 1 / (1 + np.exp(-logits.astype(float))), atol=0.003)
