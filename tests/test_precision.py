"""Places far from the origin: double precision loses nothing, and coarse float32 is noted."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from phy124.accuracy.promises import promise
from phy124.errors import InputError
from phy124.generators.ply_file import PlyFile, Reading
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.content import COARSE, centre_means, describe_coarseness, move_back, step_of
from phy124.io.formats import read_as_is, read_gaussians, write_gaussians
from phy124.io.ply import raw_table, read_ply
from phy124.particles.thickness import Proportions
from phy124.pipeline.capture import capture
from phy124.scene import Scene
from support.captures import captured
from support.model_files import edited, ply_of
from support.shapes import ball

EARTH = np.array([500_000, 0, 4.6e6])
COUNT = 1500


def far_ply(path, place, kind="f8", *, ascii=False, extra=()):
    table = raw_table(ball(COUNT))
    columns = {name: table[name].astype(float) for name in table.dtype.names}
    for axis, offset in zip("xyz", place, strict=True):
        columns[axis] = columns[axis] + offset
    for row in extra:
        columns = {name: np.append(values, values[0]) for name, values in columns.items()}
        for axis, value in zip("xyz", row, strict=True):
            columns[axis][-1] = value
    return ply_of(path / "a.ply", columns, kinds=dict.fromkeys(columns, kind), ascii=ascii)


def near() -> np.ndarray:
    table = raw_table(ball(COUNT))
    return np.stack([table[axis] for axis in "xyz"], axis=1)


@pytest.mark.parametrize("ascii", [False, True])
def test_a_ply_of_doubles_far_away_keeps_every_place(tmp_path, ascii):
    result = read_as_is(far_ply(tmp_path, EARTH, ascii=ascii))
    there = result.gaussians.means.astype(float) + result.origin
    np.testing.assert_allclose(there - EARTH, near(), atol=2e-7)
    assert result.remarks() == []
    np.testing.assert_allclose(
        read_ply(tmp_path / "a.ply", up="z", front="x").gaussians.means,
        near() + EARTH - result.origin,
        atol=2e-7,
    )


@pytest.mark.parametrize(
    "row", [(0, 0, 0), (1e308, -1e308, 0), (np.nan, 0, 0), (-np.inf, np.inf, 0), (1e38, 0, 0)]
)
def test_one_outlier_does_not_hide_that_all_others_are_far(tmp_path, row):
    result = read_as_is(far_ply(tmp_path, EARTH, extra=[row]))
    there = result.gaussians.means[:COUNT].astype(float) + result.origin
    np.testing.assert_allclose(there - EARTH, near(), atol=2e-7)


def test_a_float32_file_far_away_is_called_coarse(tmp_path):
    result = read_as_is(far_ply(tmp_path, EARTH, "f4"))
    (note,) = result.remarks()
    assert "increments of 0.5. With only about 2 increments across" in note
    assert read_as_is(far_ply(tmp_path, EARTH / 1e4, "f4")).remarks() == []


def test_doubles_that_hold_float32_values_are_as_coarse(tmp_path):
    path = far_ply(tmp_path, EARTH, "f4")
    rows = np.fromfile(path, "<f4", offset=path.read_bytes().index(b"end_header") + 11)
    names = raw_table(ball(3)).dtype.names
    columns = dict(zip(names, rows.reshape(-1, len(names)).T, strict=True))
    double = ply_of(tmp_path / "b.ply", columns, kinds=dict.fromkeys(columns, "f8"))
    assert "about 2 increments across" in read_as_is(double).remarks()[0]


def test_a_float32_file_is_read_in_its_place_bit_for_bit(tmp_path):
    path = far_ply(tmp_path, EARTH, "f4")
    result = read_gaussians(path, up="z", front="x")
    np.testing.assert_array_equal(
        result.gaussians.means, (near().astype(float) + EARTH).astype("f4")
    )
    assert result.origin == (0, 0, 0)


def test_near_files_stay_where_they_are(tmp_path):
    for kind in ("f4", "f8"):
        result = read_as_is(far_ply(tmp_path, (1, 2, -1), kind))
        assert result.origin == (0, 0, 0)


def test_a_crop_of_a_far_file_is_in_its_own_places(tmp_path):
    path = str(far_ply(tmp_path, EARTH))
    low, high = EARTH + [-1, -1, 0], EARTH + [1, 1, 1]
    box = ",".join(map(str, [*low, *high]))
    opened = PlyFile(path, Reading(crop=box)).open()
    assert len(opened.gaussians) == np.count_nonzero(near()[:, 2] >= 0)
    with pytest.raises(
        InputError, match=r"reach from 499999\.\d+,-0\.\d+,4599999\.\d+ to 500000\.\d"
    ):
        PlyFile(path, Reading(crop="0,0,0,1,1,1")).open()


def test_a_region_of_a_far_file_is_in_its_own_places(tmp_path):
    region = {
        "lower": (EARTH - [0.6, 0.6, 0]).tolist(),
        "upper": (EARTH + 0.6).tolist(),
        "units": "file",
    }
    scene = Scene().replaced({"parts": [{"static": True, "region": region}]})
    read = capture(PlyFile(str(far_ply(tmp_path, EARTH)), Reading(up="z", front="x")), scene)
    means = read.gaussians.means * scene.object.size
    means[:, 2] += scene.object.size / 2
    inside = read.scene.parts[0].region.contains(means)
    assert np.count_nonzero(inside) == pytest.approx(np.count_nonzero(near()[:, 2] >= 0), abs=3)


def test_places_beyond_float32_alone_are_no_object(tmp_path):
    columns = dict.fromkeys(raw_table(ball(3)).dtype.names, 0.5)
    columns |= {"x": [1e308, -1e308, 1e300]}
    path = ply_of(tmp_path / "a.ply", columns, kinds=dict.fromkeys(columns, "f8"))
    with pytest.raises(InputError, match="None of its Gaussians has finite values"):
        read_as_is(path)


def test_a_node_that_moves_what_is_no_number_is_read(tmp_path):
    write_gaussians(tmp_path / "a.glb", ball(100))
    data = (tmp_path / "a.glb").read_bytes()
    at = 28 + int.from_bytes(data[12:16], "little")  # of the first centre
    data = data[:at] + np.array([np.nan, np.inf], "<f4").tobytes() + data[at + 8 :]
    node = {"translation": EARTH.tolist(), "rotation": [0.6, 0, 0, 0.8]}
    (tmp_path / "a.glb").write_bytes(edited(data, lambda tree: tree["nodes"][0].update(node)))
    result = read_as_is(tmp_path / "a.glb")
    assert (len(result.gaussians), result.dropped) == (99, 1)


@pytest.mark.parametrize("turn", [[0, 0, 0, 1], [0.5, 0.5, 0.5, 0.5]])
def test_a_glb_whose_node_lies_far_away_keeps_every_place(tmp_path, turn):
    whole = ball(COUNT)
    write_gaussians(tmp_path / "a.glb", whole)
    usual = read_as_is(tmp_path / "a.glb").gaussians.means

    def change(tree):
        tree["nodes"][0] |= {"translation": EARTH.tolist(), "rotation": turn}

    (tmp_path / "a.glb").write_bytes(edited((tmp_path / "a.glb").read_bytes(), change))
    result = read_as_is(tmp_path / "a.glb")
    rotate_gaussians = usual if turn[0] == 0 else usual[:, [2, 0, 1]]
    there = result.gaussians.means.astype(float) + result.origin
    np.testing.assert_allclose(there - EARTH, rotate_gaussians, atol=3e-7)
    assert result.remarks() == []
    assert read_gaussians(tmp_path / "a.glb").origin != (0, 0, 0)


def test_a_glb_of_far_places_in_float32_is_called_coarse(tmp_path):
    far = replace(ball(COUNT), means=(ball(COUNT).means + EARTH).astype(np.float32))
    write_gaussians(tmp_path / "a.glb", far)

    def change(tree):
        tree["nodes"][0] |= {"translation": np.roll(-EARTH, -1).tolist(), "rotation": [0, 1, 0, 0]}

    (tmp_path / "a.glb").write_bytes(edited((tmp_path / "a.glb").read_bytes(), change))
    assert "about 2 increments across" in read_as_is(tmp_path / "a.glb").remarks()[0]


@pytest.mark.parametrize("scale", [1e-3, 1, 1e4])
def test_shift_to_the_origin_is_reversed_exactly(rng, scale):
    places = (rng.normal(size=(500, 3)) * scale + EARTH * scale).astype(np.float32)
    means, origin = centre_means(places.astype(float))
    back = move_back(means, origin)
    assert origin.any() and back is not None
    np.testing.assert_array_equal(back, places)
    assert move_back(means + np.float32(1e-9 * scale), origin) is None


def test_coarseness_depends_on_the_chosen_part(rng):
    means = rng.uniform(-1, 1, (4000, 3))
    assert describe_coarseness(means, 1.9 / COARSE) is None
    assert describe_coarseness(means[np.abs(means).max(axis=1) < 0.5], 1.9 / COARSE) is not None
    assert describe_coarseness(means, 0) is None


def test_a_sog_far_away_keeps_its_places(tmp_path):
    write_gaussians(tmp_path / "a.sog", ball(COUNT))
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(members["meta.json"])
    ends = np.log1p(np.array([EARTH - 0.5, EARTH + 0.5]) + [0, 1e6, 0])
    meta["means"] |= {"mins": ends[0].tolist(), "maxs": ends[1].tolist()}
    members["meta.json"] = json.dumps(meta).encode()
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    means = read_as_is(tmp_path / "b.sog").gaussians.means
    assert min(len(np.unique(axis)) for axis in means.T) > 0.9 * COUNT
    np.testing.assert_allclose(np.ptp(means, axis=0), 1, rtol=1e-3)


def test_floor_of_a_far_capture_is_in_file_coordinates(tmp_path):
    table = raw_table(rotate_gaussians(captured(7, floaters=0).gaussians, orientation().T))
    columns = {name: table[name].astype(float) for name in table.dtype.names}
    kinds = dict.fromkeys(columns, "f8")
    results = []
    for name, place in (("near", np.zeros(3)), ("far", EARTH)):
        for axis, offset in zip("xyz", place, strict=True):
            columns[axis] = columns[axis] + offset
        path = ply_of(tmp_path / f"{name}.ply", columns, kinds=kinds)
        floor = Reading(floor=True, up="z", front="x")
        results.append(capture(PlyFile(str(path), floor), Scene()).about["capture"]["floor"])
    near_floor, far_floor = results
    np.testing.assert_allclose(far_floor["normal"], near_floor["normal"], atol=1e-6)
    moved = near_floor["offset"] + np.dot(far_floor["normal"], EARTH)
    assert far_floor["offset"] == pytest.approx(moved, abs=5)


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_no_error_is_promised_for_a_file_that_is_too_coarse(tmp_path, kind):
    read = capture(PlyFile(str(far_ply(tmp_path, EARTH, kind))), Scene())
    assert read.about["capture"]["coarse"] == (kind == "f4")
    report = {"capture": read.about["capture"]}
    assert (promise(Scene.named("drop"), Proportions(0.5, 0.3), report).error is None) == (
        kind == "f4"
    )


def test_a_single_gaussian_is_not_called_coarse(tmp_path, three_gaussians):
    first = three_gaussians.select(np.array([1]))
    write_gaussians(tmp_path / "a.ply", first)
    assert read_as_is(tmp_path / "a.ply").remarks() == []


def test_signalling_nan_causes_no_warning():
    means = np.array([0x7FA00000, 0x3F800000, 0x3F000000], np.uint32).view(np.float32)
    with np.errstate(all="raise"):
        assert step_of(means.reshape(1, 3)) == 0.0
