"""Depth maps are read as they were written, or refused with a remedy."""

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.generators.extras import DepthMap, read_depth
from phy124.pipeline import make_gaussians

RAMP = np.arange(12 * 20).reshape(12, 20)


def test_values_survive_every_format(tmp_path):
    """16 bits are not reduced to 8, and floating-point numbers not to integers."""
    Image.fromarray((RAMP * 250).astype(np.uint16)).save(tmp_path / "deep.png")
    Image.fromarray(RAMP.astype(np.uint8)).save(tmp_path / "plain.png")
    np.save(tmp_path / "float.npy", RAMP[None] / 1000)
    for name, scale in (("deep.png", 250), ("plain.png", 1), ("float.npy", 1e-3)):
        np.testing.assert_allclose(read_depth(tmp_path / name), RAMP * scale, rtol=1e-6)


@pytest.mark.parametrize("scale", [1e-300, 1e35, 1e300])
def test_values_beyond_float32_are_scaled(tmp_path, scale):
    np.save(tmp_path / "map.npy", RAMP * scale)
    with np.errstate(all="raise"):
        values = read_depth(tmp_path / "map.npy")
        assert np.isfinite(values).all() and values.mean() > 0
    np.testing.assert_allclose(values, RAMP / RAMP.max(), rtol=1e-6)


def spoiled(folder):
    """Files that are no depth maps, and what is said of each."""
    np.save(folder / "colours.npy", np.zeros((4, 4, 3)))
    np.save(folder / "hole.npy", np.where(RAMP == 5, np.nan, RAMP))
    (folder / "text.npy").write_text("1 2 3")
    (folder / "text.png").write_text("1 2 3")
    return {
        "colours.npy": "shape",
        "hole.npy": "not finite",
        "text.npy": "not an array",
        "text.png": "not a PNG",
        "absent.npy": "no such file",
        "absent.png": "no such file",
    }


def test_other_files_are_refused(tmp_path):
    for name, why in spoiled(tmp_path).items():
        with pytest.raises(InputError, match=why):
            read_depth(tmp_path / name)


def test_only_for_generators_that_use_one(tmp_path):
    np.save(tmp_path / "map.npy", RAMP)
    chosen = DepthMap(depth=tmp_path / "map.npy", near="black")

    def flat(image, *, seed, progress):
        return None

    def deep(image, *, seed, progress, depth=None):
        return depth

    with pytest.raises(InputError, match=r"lgm does not use a depth map.*relief"):
        chosen.bind(flat, "lgm")
    assert DepthMap().bind(flat, "lgm") is flat
    np.testing.assert_array_equal(chosen.bind(deep, "relief")(0, seed=0, progress=0), -RAMP)
    with pytest.raises(InputError, match=r"near = black.*from a file"):
        DepthMap(near="black").bind(deep, "relief")


def test_errors_about_a_depth_map_name_its_file(tmp_path):
    picture = np.zeros((40, 60, 4), np.uint8)
    picture[10:30, 10:40] = 255
    Image.fromarray(picture).save(tmp_path / "object.png")
    np.save(tmp_path / "wide.npy", np.ones((40, 90)))
    np.save(tmp_path / "flat.npy", np.ones((40, 60)))
    for name, why in (("wide", "It has 90 x 40 pixels"), ("flat", "All values")):
        with pytest.raises(InputError, match=rf"depth = .*{name}\.npy: {why}"):
            make_gaussians(tmp_path / "object.png", depth={"depth": tmp_path / f"{name}.npy"})
