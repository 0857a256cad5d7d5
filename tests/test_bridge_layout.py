"""Field profiles: every value of the clip in its place, to the last bit."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bridge.layout import FULL, cloud, draco_cloud, evenly, packed_rgb, points, small_points
from phy124.gaussians import Gaussians
from phy124.io.ply import write_ply
from support.clips import random_clip


def bits(values):
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


@pytest.mark.parametrize(("profile", "size"), [("viz", 16), ("full", 60), ("ply", 68)])
def test_point_sizes(profile, size):
    frame = random_clip().frame(0)
    message = cloud(frame, profile, {})
    assert message["point_step"] == size
    assert message["row_step"] == len(message["data"]) == size * 50
    assert [field["offset"] for field in message["fields"]] == list(range(0, size, 4))
    assert {field["datatype"] for field in message["fields"]} == {7}


def documented_reader():
    """The snippet of docs/guide/ros2-messages.md."""
    text = (Path(__file__).parents[1] / "docs/guide/ros2-messages.md").read_text()
    (snippet,) = re.findall(r"```python\n(.*?)```", text, re.S)
    names = {}
    exec(snippet, names)
    return names["read_small"]


@pytest.mark.parametrize("extent", [1e-3, 1.0, 1e4])
def test_small_profile_is_read_within_its_bounds(extent):
    frame = random_clip(count=3000).frame(0)
    gaussians = replace(frame.gaussians, means=frame.gaussians.means * np.float32(extent))
    message = cloud(replace(frame, gaussians=gaussians), "small", {})
    assert (message["point_step"], message["row_step"]) == (10, 10 * 3000 + 16)
    assert [field["datatype"] for field in message["fields"]] == [3] * 3 + [2] * 4
    places, colours = documented_reader()(SimpleNamespace(**message))
    longest = np.ptp(gaussians.means, axis=0).max()
    bound = 0.5 * longest / 65_534
    rounding = 1e-6 * np.abs(gaussians.means).max()
    assert np.abs(places - gaussians.means).max() <= bound * 1.001 + rounding
    assert np.abs(colours[:, :3] - gaussians.rgb).max() <= 1 / 510 + 1e-6
    assert np.abs(colours[:, 3] - gaussians.opacities).max() <= 1 / 510 + 1e-6


def test_small_profile_of_one_no_and_non_finite_points():
    body = random_clip(count=1).frame(0)
    places, _ = documented_reader()(SimpleNamespace(**cloud(body, "small", {})))
    np.testing.assert_allclose(places, body.gaussians.means, rtol=1e-6)
    assert cloud(random_clip(count=0).frame(0), "small", {})["row_step"] == 16
    broken = random_clip().frame(0)
    broken.gaussians.means[3, 1] = np.nan
    table, _ = small_points(broken)
    assert (table["x"] == -32768).nonzero()[0].tolist() == [3]
    assert cloud(broken, "small", {})["is_dense"] is False


def test_full_profile_is_the_clip_to_the_last_bit():
    clip = random_clip()
    table = points(clip.frame(2), "full")
    assert table.dtype.names == FULL
    groups = {
        "x y z": clip.means[2],
        "alpha": clip.opacities[:, None],
        "sx sy sz": clip.scales[2],
        "qw qx qy qz": clip.quats[2],
        "vx vy vz": clip.velocities[2],
    }
    for names, values in groups.items():
        for name, column in zip(names.split(), values.T, strict=True):
            np.testing.assert_array_equal(bits(table[name]), bits(column))


def test_full_profile_names_the_object_of_each_gaussian():
    frame = random_clip(count=5).frame(1)
    ids = np.array([0, 2, 1, 1, 3], np.int32)
    several = replace(frame, gaussians=replace(frame.gaussians, object_id=ids))
    table, alone = points(several, "full"), points(frame, "full")
    assert table["object_id"].tolist() == ids.tolist()
    for name in FULL:
        np.testing.assert_array_equal(bits(table[name]), bits(alone[name]))
    message = cloud(several, "full", {})
    last = {"name": "object_id", "offset": 60, "datatype": 6, "count": 1}
    assert (message["point_step"], message["fields"][-1]) == (64, last)
    assert cloud(several, "viz", {})["point_step"] == 16


def test_rgb_is_packed_as_rviz_reads_it():
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0.5, 0.25, 0]])
    ones = np.ones((5, 4), np.float32)
    gaussians = Gaussians.from_rgb(ones[:, :3], ones, ones[:, :3], ones[:, 0], colours)
    expected = [0xFF0000, 0x00FF00, 0x0000FF, 0xFFFFFF, 0x804000]
    assert packed_rgb(gaussians).tolist() == expected


def test_packed_colours_survive_the_table():
    frame = random_clip(count=5000).frame(0)
    table = points(frame, "viz")
    red_green_blue = np.ascontiguousarray(table["rgb"]).view(np.uint8).reshape(-1, 4)[:, 2::-1]
    np.testing.assert_array_equal(red_green_blue, np.rint(frame.gaussians.rgb * 255))


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_ply_profile_is_the_ply_file_with_ros_axes(degree, tmp_path):
    frame = random_clip(degree=degree).frame(1)
    table = points(frame, "ply")
    write_ply(tmp_path / "one.ply", frame.gaussians)
    header = (tmp_path / "one.ply").read_bytes().split(b"end_header")[0].decode()
    names = [line.split()[-1] for line in header.splitlines() if line.startswith("property")]
    assert list(table.dtype.names) == names
    gaussians = frame.gaussians
    for i, axis in enumerate("xyz"):
        np.testing.assert_array_equal(table[axis], gaussians.means[:, i])
    sigmoid = 1 / (1 + np.exp(-table["opacity"].astype(np.float64)))
    np.testing.assert_allclose(sigmoid, gaussians.opacities, atol=1e-6)
    np.testing.assert_allclose(np.exp(table["scale_1"]), gaussians.scales[:, 1], rtol=1e-6)
    np.testing.assert_array_equal(table["rot_0"], gaussians.quats[:, 0])
    count = gaussians.sh.shape[1] - 1
    for i in range(3 * count):
        channel, coefficient = divmod(i, count)
        np.testing.assert_array_equal(
            table[f"f_rest_{i}"], gaussians.sh[:, 1 + coefficient, channel]
        )


def test_missing_velocities_are_nan_and_noted():
    frame = random_clip(velocities=False).frame(0)
    message = cloud(frame, "full", {})
    assert message["is_dense"] is False
    assert np.isnan(points(frame, "full")["vy"]).all()
    assert cloud(frame, "viz", {})["is_dense"] is True


def test_velocities_that_are_not_finite_are_not_dense():
    frame = random_clip().frame(0)
    assert cloud(frame, "full", {})["is_dense"] is True
    frame.velocities[2, 1] = np.nan
    assert cloud(frame, "full", {})["is_dense"] is False


def test_empty_cloud():
    frame = random_clip(count=0).frame(0)
    for profile in ("viz", "full"):
        message = cloud(frame, profile, {})
        assert message["width"] == message["row_step"] == len(message["data"]) == 0


def test_thinning_is_even_and_the_same_each_time():
    kept = evenly(100, 40)
    assert kept is not None
    np.testing.assert_array_equal(kept, evenly(100, 40))
    assert len(np.unique(kept)) == 40
    assert set(np.diff(kept)) <= {2, 3}
    assert evenly(40, 40) is None
    assert evenly(100, None) is None


def test_draco_decodes_to_the_cloud_of_viz():
    """Decoded as by draco_point_cloud_transport: attribute i goes to the offset of field i."""
    draco = pytest.importorskip("DracoPy")
    frame = random_clip(count=300).frame(1)
    frame.gaussians.means[7] = np.nan
    compressed = draco_cloud(frame, 14, {})
    assert len(compressed["compressed_data"]) < 300 * 12
    decoded = np.zeros((compressed["width"], compressed["point_step"]), np.uint8)
    attributes = draco.decode(compressed["compressed_data"]).attributes
    assert [attribute["unique_id"] for attribute in attributes] == [0, 1]
    for attribute, field in zip(attributes, compressed["fields"], strict=False):
        data = np.ascontiguousarray(attribute["data"]).view(np.uint8)
        first = field["offset"]
        decoded[:, first : first + data.shape[1]] = data
    table = np.delete(points(frame, "viz"), 7)
    again = decoded.view(table.dtype)[:, 0]
    assert (again["rgb"].view("<u4") == table["rgb"].view("<u4")).all()
    means = np.delete(frame.gaussians.means, 7, axis=0)
    error = np.stack([again[axis] for axis in "xyz"], 1) - means
    assert np.abs(error).max() <= np.ptp(means, axis=0).max() / 2**14


def test_empty_draco_cloud():
    pytest.importorskip("DracoPy")
    frame = random_clip(count=3).frame(0)
    frame.gaussians.means[:] = np.nan
    assert draco_cloud(frame, 14, {})["width"] == 0
