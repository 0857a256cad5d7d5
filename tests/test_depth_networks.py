"""MoGe-2 and Depth Anything: published inputs and outputs, detail from normals, relief's front."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
from PIL import Image

from phy124.errors import InputError
from phy124.generators.extras import DepthMap
from phy124.generators.relief import relief
from phy124.imaging import depth as module
from phy124.imaging.depth import DepthNetwork, add_detail, prepare_patches
from phy124.weights import store

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
from reference.onnx_files import save_network


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of weights without a size that is checked; networks run in this process."""
    monkeypatch.setenv("PHY124_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    for name in module.NETWORKS:
        files = tuple(replace(file, size=None) for file in store.KNOWN[name])
        monkeypatch.setitem(store.KNOWN, name, files)
    monkeypatch.setattr(module.isolated, "run", lambda function, *rest: function(*rest))
    return tmp_path


def place(folder, name):
    (file,) = store.KNOWN[name]
    return folder / file.repo.rpartition("/")[2] / file.path


def save_depth_anything(folder):
    """A network whose depth is the red channel."""
    save_network(
        place(folder, "depth-anything"),
        {"pixel_values": [1, 3, None, None]},
        {"predicted_depth": [1, None, None]},
        [("Gather", ["pixel_values", "first"], ["predicted_depth"], {"axis": 1})],
        {"first": np.array(0)},
    )


def save_moge2(folder):
    """A network whose points are the colours, and whose normals face the camera."""
    save_network(
        place(folder, "moge2"),
        {"image": [1, 3, None, None], "num_tokens": []},
        {
            "points": [1, None, None, 3],
            "normal": [1, None, None, 3],
            "mask": [1, None, None],
            "metric_scale": [1],
        },
        [
            ("Transpose", ["image"], ["points"], {"perm": [0, 2, 3, 1]}),
            ("Mul", ["points", "zero"], ["nothing"], {}),
            ("Add", ["nothing", "front"], ["normal"], {}),
            ("Gather", ["image", "first"], ["mask"], {"axis": 1}),
            ("Identity", ["one"], ["metric_scale"], {}),
        ],
        {
            "zero": np.float32(0),
            "front": np.array([0, 0, -1], np.float32),
            "first": np.array(0),
            "one": np.ones(1, np.float32),
        },
    )


def draw_disc():
    """A disc whose red channel rises to the right, blue falls, before a black background."""
    y, x = np.mgrid[:80, :100]
    rgba = np.zeros((80, 100, 4), np.uint8)
    inside = (x - 50) ** 2 + (y - 40) ** 2 < 30**2
    rgba[inside] = np.stack([2 * x, 0 * x, 255 - 2 * x, 0 * x + 255], axis=-1)[inside]
    return rgba


@pytest.mark.parametrize("name", ["depth-anything", "moge2"])
def test_depth_comes_from_the_published_outputs(folder, name):
    {"depth-anything": save_depth_anything, "moge2": save_moge2}[name](folder)
    rgba = draw_disc()
    depth = DepthNetwork(name)(rgba)
    assert depth.shape == (80, 100)
    row = depth[40, 30:70]
    assert np.all(np.diff(row) > 0 if name == "depth-anything" else np.diff(row) > -1e-6)
    assert row[-1] > row[0]


def test_input_has_whole_patches():
    for size, shape in (((40, 40), (518, 518)), ((60, 40), (518, 784)), ((400, 40), (98, 1036))):
        picture = np.asarray(Image.new("RGB", size, (124, 116, 104)))
        made = prepare_patches(picture)
        assert made.shape == (1, 3, *shape)
        assert np.abs(made).max() < 0.01  # ImageNet's mean colour


def test_normals_restore_blurred_detail():
    """A wavy plane: its points are blurred, its normals are exact."""
    y, x = np.mgrid[:120, :160] / 100.0
    z = 3 + 0.05 * np.sin(20 * x) * np.cos(16 * y)
    dx = np.cos(20 * x) * np.cos(16 * y)
    dy = -0.8 * np.sin(20 * x) * np.sin(16 * y)
    normals = np.stack([dx, dy, -np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    blurred = scipy.ndimage.gaussian_filter(z, 12)
    points = np.stack([x, y, blurred], axis=-1)
    made = add_detail(points.astype(np.float32), normals.astype(np.float32), np.ones(z.shape, bool))
    error = (made + z)[10:-10, 10:-10].std()
    assert error < 0.3 * (blurred - z)[10:-10, 10:-10].std()


def test_auto_uses_what_is_present(folder):
    generator = DepthMap().bind(relief, "relief")
    assert generator is relief
    save_depth_anything(folder)
    assert DepthMap().bind(relief, "relief").keywords["depth"].name == "depth-anything"
    save_moge2(folder)
    assert DepthMap().bind(relief, "relief").keywords["depth"].name == "moge2"
    assert DepthMap(depth="off").bind(relief, "relief") is relief
    assert DepthMap(depth=Path("map.png")).path == Path("map.png")

    def flat(image, *, seed, progress):
        return None

    assert DepthMap().bind(flat, "lgm") is flat
    with pytest.raises(InputError, match="does not use a depth map"):
        DepthMap(depth="moge2").bind(flat, "lgm")


def test_missing_weights_name_the_command(folder):
    with pytest.raises(InputError, match="weights fetch moge2`, or remove the option"):
        DepthMap(depth="moge2").bind(relief, "relief")


def test_relief_takes_its_front_from_the_network(folder):
    save_depth_anything(folder)
    picture = Image.fromarray(draw_disc())
    plain = relief(picture, count=1000)
    shaped = DepthMap().bind(relief, "relief")(picture, count=1000)

    def tilt(gaussians):
        front = gaussians.means[gaussians.means[:, 0] > 0.1]
        return np.corrcoef(front[:, 0], front[:, 1])[0, 1]

    assert abs(tilt(plain)) < 0.15 and abs(tilt(shaped)) > 0.25
    side = DepthMap().bind(relief, "relief")(picture, count=1000, side=picture)
    assert abs(tilt(side)) < 0.15  # the picture from the side replaces the network
    with pytest.raises(InputError, match="determines the object's depth"):
        DepthMap(depth="depth-anything").bind(relief, "relief")(picture, side=picture)
