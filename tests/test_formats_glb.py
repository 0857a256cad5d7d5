"""GLB: log and linear scales, nodes, integers, linear light, other containers' reader, refusals."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import Gaussians, join
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.formats import glb, read_as_is, read_gaussians, write_gaussians
from support.model_files import edited
from support.quantisation import many
from support.shapes import ball


def assert_same(result: Gaussians, wanted: Gaussians) -> None:
    """Equal but for rounding; the axes of a Gaussian may be named in another order."""
    np.testing.assert_allclose(result.means, wanted.means, atol=1e-5)
    np.testing.assert_allclose(result.covariances(), wanted.covariances(), rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(result.opacities, wanted.opacities, atol=1e-6)
    np.testing.assert_allclose(result.sh, wanted.sh, atol=2e-6)


def glb_with(path: Path, gaussians: Gaussians, change) -> Path:
    """A GLB whose description is changed."""
    write_gaussians(path, gaussians)
    path.write_bytes(edited(path.read_bytes(), change))
    return path


def test_early_glb_scales_are_logarithms(tmp_path, three_gaussians):
    logs = Gaussians(**{**vars(three_gaussians), "scales": np.log(three_gaussians.scales)})
    write_gaussians(tmp_path / "a.glb", logs)
    result = read_gaussians(tmp_path / "a.glb").gaussians
    np.testing.assert_allclose(result.scales, three_gaussians.scales, rtol=1e-6)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_a_glb_keeps_the_object_of_each_gaussian(tmp_path, three_gaussians, order):
    several = replace(three_gaussians, object_id=np.array([2, 0, 7], np.int32))
    write_gaussians(tmp_path / "a.glb", several)
    assert read_gaussians(tmp_path / "a.glb").gaussians.object_id.tolist() == [2, 0, 7]

    def twice(tree):
        """Two meshes, of which one does not say it."""
        (mesh,) = tree["meshes"]
        other = json.loads(json.dumps(mesh))
        del other["primitives"][0]["attributes"]["_OBJECT_ID"]
        tree["meshes"] = [mesh, other]
        tree["nodes"] = [{"mesh": 0}, {"mesh": 1}]
        tree["scenes"] = [{"nodes": order}]

    content = read_gaussians(glb_with(tmp_path / "b.glb", several, twice))
    assert content.gaussians.object_id is not None
    assert content.gaussians.object_id.tolist() == [2, 0, 7] * 2
    assert "3 Gaussians belong to no object" in content.notes[0]


def test_nodes_of_a_glb_move_turn_and_scale_their_gaussians(tmp_path, rng):
    wanted = many(rng, 50, 3)
    half = float(np.sqrt(0.5))

    def change(tree):
        tree["nodes"] = [
            {"children": [1, 2], "translation": [0, 10, 0]},
            {"mesh": 0},
            {"mesh": 0, "rotation": [0, half, 0, half], "scale": [2, 2, 2]},
        ]

    result = read_gaussians(glb_with(tmp_path / "a.glb", wanted, change)).gaussians
    assert len(result) == 100
    halves = [result.select(np.arange(50)), result.select(np.arange(50, 100))]
    plain, other = sorted(halves, key=lambda g: g.scales.sum())
    up = np.array([0, 0, 10])
    assert_same(plain, wanted.transform(1, up))
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # about our z, which is the file's y
    assert_same(other, rotate_gaussians(wanted, turn).transform(2, up))


def _set(path: str, value) -> object:
    def change(tree):
        *keys, last = [int(key) if key.isdigit() else key for key in path.split("/")]
        for key in keys:
            tree = tree[key]
        if value is None:
            del tree[last]
        else:
            tree[last] = value

    return change


SPLATS = "meshes/0/primitives/0/extensions/KHR_gaussian_splatting"


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (f"{SPLATS}/kernel", "box", "kernel is box"),
        (f"{SPLATS}/extensions", {"KHR_x_spz_2": {}}, "compressed by KHR_x_spz_2, a draft"),
        (SPLATS, None, "no mesh has KHR_gaussian_splatting"),
        ("nodes/0/scale", [1, 2, 1], "unevenly"),
        ("nodes/0/scale", [-1, 1, 1], "mirrors"),
        ("nodes/0/children", [0], "cycle of nodes"),
        ("accessors/0/count", 10**9, "states 1,000,000,000"),
        ("accessors/2/count", 7, "7 values for 3 Gaussians"),
        ("accessors/2/componentType", 5123, "not normalised"),
        ("accessors/3/type", "MAT2", "of type MAT2"),
        ("bufferViews/2/byteLength", 7, "shorter than its 3 values"),
        ("accessors/0/sparse", {}, 'malformed: "count" is missing'),
        ("accessors/2/componentType", 7, "no numbers of type 7"),
        (
            "accessors/0/sparse",
            {"count": 1, "indices": {"bufferView": 0, "componentType": 5126}},
            "are not integers",
        ),
        (
            "accessors/0/sparse",
            {"count": 1, "indices": {"bufferView": 3, "componentType": 5125}},
            "index beyond its last value",
        ),
        ("meshes/0/primitives/0/attributes/POSITION", -1, "no number -1"),
        ("meshes/0/primitives/0/attributes/POSITION", None, '"POSITION" is missing'),
        ("meshes/0/primitives/0/indices", 0, "selected by indices"),
        ("nodes/0/matrix", [1, 2, 3], "wrong type or size"),
        ("nodes/0/rotation", [0, 0, 0, 0], "skews"),
        ("nodes/0/scale", [0, 0, 0], "skews"),
        ("scene", 7, "no number 7"),
        ("buffers/0/uri", "a.bin", "in another file"),
        ("bufferViews/0/byteOffset", 1 << 60, "cut short"),
        ("meshes", 3, "malformed: a value has the wrong type"),
        ("scene", "x", "malformed: its scenes have no number x"),
        ("asset", 3, "malformed: a value has the wrong type"),
        ("meshes/0/primitives/0/attributes/KHR_gaussian_splatting:SCALE", None, "no KHR.*SCALE"),
    ],
)
def test_glb_of_other_kinds_are_refused(tmp_path, three_gaussians, path, value, words):
    file = glb_with(tmp_path / "a.glb", three_gaussians, _set(path, value))
    with pytest.raises(InputError, match=words):
        read_gaussians(file)


def test_integers_and_linear_light_of_a_glb(tmp_path, three_gaussians):
    """Rotations in int16, opacities in uint8; colours of linear light become those of displays."""
    write_gaussians(tmp_path / "a.glb", three_gaussians)
    data = bytearray((tmp_path / "a.glb").read_bytes())
    body = data.index(b"BIN\0") + 4
    rotations, opacities = [0, 0], [0]

    def change(tree):
        views, accessors = tree["bufferViews"], tree["accessors"]
        rotations[:] = views[2]["byteOffset"], accessors[2]["count"]
        opacities[0] = views[4]["byteOffset"]
        accessors[2] |= {"componentType": 5122, "normalized": True}
        accessors[4] |= {"componentType": 5121, "normalized": True}
        tree["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"] |= {
            "colorSpace": "lin_rec709_display"
        }

    edited(bytes(data), change)
    quats = np.roll(read_as_is(tmp_path / "a.glb").gaussians.quats, -1, axis=1)
    at = body + rotations[0]
    data[at : at + 24] = np.rint(quats * 32767).astype("<i2").tobytes()
    at = body + opacities[0]
    data[at : at + 3] = np.rint(three_gaussians.opacities * 255).astype(np.uint8).tobytes()
    (tmp_path / "a.glb").write_bytes(edited(bytes(data), change))
    result = read_gaussians(tmp_path / "a.glb").gaussians
    np.testing.assert_allclose(result.opacities, three_gaussians.opacities, atol=0.5 / 255)
    dots = np.abs((result.quats * three_gaussians.quats).sum(axis=1))
    np.testing.assert_allclose(dots, 1, atol=1e-6)
    linear = np.clip(three_gaussians.rgb, 0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(result.rgb, shown, atol=1e-5)


def test_glb_reads_in_the_library_of_another_container(tmp_path, rng):
    fourdgs = pytest.importorskip("fourdgs", reason="the extra fourdgs is not installed")
    wanted = many(rng, 200, 3)
    write_gaussians(tmp_path / "a.glb", wanted)
    result = fourdgs.from_gltf(str(tmp_path / "a.glb")).gaussians
    there = rotate_gaussians(wanted, orientation(*glb.Y_UP).T)
    np.testing.assert_allclose(result.positions, there.means, atol=1e-6)
    np.testing.assert_allclose(result.scales, there.scales, rtol=1e-6)
    np.testing.assert_allclose(result.rotations, np.roll(there.quats, -1, axis=1), atol=1e-6)
    np.testing.assert_allclose(result.colors[:, :3], there.rgb, atol=1e-6)
    np.testing.assert_allclose(result.colors[:, 3], there.opacities, atol=1e-6)
    channels = there.sh[:, 1:].transpose(0, 2, 1).reshape(200, -1)
    assert np.abs(result.sh * (8 / 255) - 4 - channels).max() <= 0.51 * 8 / 255


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("logs", [False, True])
def test_scale_kind_is_detected_in_any_unit(tmp_path, unit, logs):
    """In millimetres all logarithms are above 0, too: what covers the object tells."""
    wanted = ball(3000).transform(unit, np.zeros(3))
    scales = np.maximum(wanted.scales, 1.01) if unit > 1 else wanted.scales
    wanted = replace(wanted, scales=scales)
    written = replace(wanted, scales=np.log(scales)) if logs else wanted
    path = glb_with(tmp_path / "a.glb", written, _set("asset/generator", "a trainer"))
    content = read_gaussians(path)
    np.testing.assert_allclose(content.gaussians.scales, wanted.scales, rtol=1e-5)
    assert bool(content.notes) == (logs and unit > 1)


@pytest.mark.parametrize("apart", [0.05, 0.5, 2.0])
def test_a_sparse_cloud_of_lengths_is_no_file_of_logarithms(tmp_path, rng, apart):
    places = rng.uniform(0, 10 * apart, (1000, 3))
    sparse = replace(many(rng, 1000, 0), means=places, scales=np.full((1000, 3), apart / 5))
    path = glb_with(tmp_path / "a.glb", sparse, _set("asset/generator", "a trainer"))
    content = read_as_is(path)
    np.testing.assert_allclose(content.gaussians.scales, apart / 5, rtol=1e-6)
    assert content.notes == ()


@pytest.mark.parametrize(
    ("generator", "logs"),
    [
        ("splat-transform 2.6.0", True),
        ("splat-transform 2.7.0", False),
        ("splat-transform 3.2.0", False),
        ("splat-transform 10.0.0", False),
        ("phy124", False),
    ],
)
def test_known_programs_wrote_scales_of_one_kind(tmp_path, three_gaussians, generator, logs):
    path = glb_with(tmp_path / "a.glb", three_gaussians, _set("asset/generator", generator))
    scales = three_gaussians.scales
    result = np.sort(read_as_is(path).gaussians.scales, axis=1)
    np.testing.assert_allclose(
        result, np.sort(np.exp(scales) if logs else scales, axis=1), rtol=1e-6
    )


def test_a_negative_scale_in_one_mesh_tells_of_all(tmp_path, three_gaussians):
    small = replace(three_gaussians, scales=np.log(three_gaussians.scales))
    large = replace(three_gaussians, scales=np.float32([[1, 2, 3]] * 3))
    write_gaussians(tmp_path / "a.glb", join([small, large]))

    def apart(tree):
        """Two meshes that share the values: one shows the first half, the other the second."""
        (mesh,) = tree["meshes"]
        other = json.loads(json.dumps(mesh))
        for accessor in list(tree["accessors"]):
            width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
            size = width * (1 if accessor["componentType"] == 5121 else 4)
            accessor["count"] = 3
            tree["accessors"].append({**accessor, "byteOffset": 3 * size})
        count = len(tree["accessors"]) // 2
        attributes = other["primitives"][0]["attributes"]
        other["primitives"][0]["attributes"] = {n: i + count for n, i in attributes.items()}
        tree["meshes"], tree["nodes"] = [mesh, other], [{"mesh": 0}, {"mesh": 1}]
        tree["scenes"] = [{"nodes": [0, 1]}]

    (tmp_path / "a.glb").write_bytes(edited((tmp_path / "a.glb").read_bytes(), apart))
    result = np.sort(read_as_is(tmp_path / "a.glb").gaussians.scales.max(axis=1))
    np.testing.assert_allclose(result[3:], np.exp(3.0), rtol=1e-5)


def test_attributes_that_are_not_read_are_named(tmp_path, three_gaussians):
    def change(tree):
        attributes = tree["meshes"][0]["primitives"][0]["attributes"]
        attributes["_FEATURE_ID_0"] = attributes["KHR_gaussian_splatting:OPACITY"]
        attributes["KHR_gaussian_splatting:SH_DEGREE_4_COEF_0"] = attributes["POSITION"]

    content = read_as_is(glb_with(tmp_path / "a.glb", three_gaussians, change))
    assert len(content.notes) == 2
    assert "degree 4" in content.notes[0] and "_FEATURE_ID_0" in content.notes[1]


def as_integers(path: Path, gaussians: Gaussians, name: str, raw, kind: int, change) -> Path:
    """A GLB of which an attribute holds integers [N,W] or [N], and that is changed otherwise."""
    write_gaussians(path, gaussians)
    data = bytearray(path.read_bytes())
    body = data.index(b"BIN\0") + 4

    def mark(tree):
        accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"][name]]
        accessor["componentType"] = kind
        at = body + tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
        data[at : at + raw.nbytes] = raw.tobytes()
        change(tree, accessor)

    changed = edited(bytes(data), mark)
    path.write_bytes(changed[: -len(data[body:])] + data[body:])
    return path


def test_centres_may_be_whole_steps_that_a_node_scales(tmp_path, three_gaussians):
    steps = np.array([[-300, 0, 20], [0, 7, 0], [1000, -50, 3]], "<i2")

    def scale(tree, accessor):
        tree["nodes"][0]["scale"] = [0.001] * 3

    path = as_integers(tmp_path / "a.glb", three_gaussians, "POSITION", steps, 5122, scale)
    result = read_as_is(path).gaussians.means
    np.testing.assert_allclose(result, steps * 1e-3, rtol=1e-6)


@pytest.mark.parametrize("normalized", [False, True])
def test_objects_may_be_numbered_by_integers(tmp_path, three_gaussians, normalized):
    several = replace(three_gaussians, object_id=np.zeros(3, np.int32))
    ids = np.array([2, 0, 7], np.uint8)

    def mark(tree, accessor):
        accessor["normalized"] = normalized

    path = as_integers(tmp_path / "a.glb", several, "_OBJECT_ID", ids, 5121, mark)
    assert read_as_is(path).gaussians.object_id.tolist() == [2, 0, 7]


@pytest.mark.parametrize("viewed", [False, True])
def test_sparse_values_take_the_place_of_others(tmp_path, three_gaussians, viewed):
    def sparse(tree):
        """The last opacity is replaced; without a view the others are 0."""
        views, accessors = tree["bufferViews"], tree["accessors"]
        opacity = accessors[4]
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": 4})
        views.append({"buffer": 0, "byteOffset": len(body) + 4, "byteLength": 4})
        opacity["sparse"] = {
            "count": 1,
            "indices": {"bufferView": len(views) - 2, "componentType": 5125},
            "values": {"bufferView": len(views) - 1},
        }
        if not viewed:
            del opacity["bufferView"]

    write_gaussians(tmp_path / "a.glb", three_gaussians)
    data = (tmp_path / "a.glb").read_bytes()
    body = data[data.index(b"BIN\0") + 4 :]
    more = struct.pack("<If", 2, 0.125)
    changed = edited(data, sparse)
    at = changed.index(b"BIN\0") - 4
    size = struct.pack("<I", len(body) + len(more))
    (tmp_path / "a.glb").write_bytes(changed[:at] + size + changed[at + 4 :] + more)
    result = read_as_is(tmp_path / "a.glb").gaussians.opacities
    wanted = [*(three_gaussians.opacities[:2] if viewed else (0, 0)), 0.125]
    np.testing.assert_allclose(result, wanted, rtol=1e-6)


def test_a_turned_node_keeps_gaussians_without_a_rotation(tmp_path, three_gaussians):
    still = replace(three_gaussians, quats=np.zeros((3, 4)))
    turn = _set("nodes/0/rotation", [0, 0, 0.6, 0.8])
    result = read_as_is(glb_with(tmp_path / "a.glb", still, turn))
    assert result.dropped == 0
    np.testing.assert_allclose(np.abs(result.gaussians.quats), [[0.8, 0, 0, 0.6]] * 3, atol=1e-6)


def test_a_mirrored_length_among_many_is_no_logarithm(tmp_path, rng):
    wanted = many(rng, 100, 0)
    scales = wanted.scales.copy()
    scales[7, 1] *= -1
    write_gaussians(tmp_path / "a.glb", replace(wanted, scales=scales))
    assert_same(read_gaussians(tmp_path / "a.glb").gaussians, wanted)


def test_extensions_that_may_change_the_gaussians_are_named(tmp_path, three_gaussians):
    def change(tree):
        tree["extensionsRequired"] = ["KHR_gaussian_splatting", "KHR_x"]
        tree["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {}}
        tree["nodes"].append({"extensions": {"KHR_lights_punctual": {"light": 0}}})

    (note,) = read_as_is(glb_with(tmp_path / "a.glb", three_gaussians, change)).notes
    assert "KHR_x, EXT_mesh_gpu_instancing." in note
