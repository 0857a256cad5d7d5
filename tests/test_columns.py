"""Columns of other trainers: applied where they are known, named where they are not."""

import numpy as np
import pytest

from phy124.gaussians import SH_C0
from phy124.io.formats import read_as_is
from support.model_files import ply_of

STANDARD = {
    "x": [0.0, 1.0, 2.0], "y": 0.0, "z": 0.0, "f_dc_0": 0.5, "f_dc_1": 0.0, "f_dc_2": -0.5,
    "opacity": np.log(0.9 / 0.1), "scale_0": np.log(0.01), "scale_1": np.log(0.01),
    "scale_2": np.log(0.01), "rot_0": 1.0, "rot_1": 0.0, "rot_2": 0.0, "rot_3": 0.0,
}  # fmt: skip


def read(path, left_out=(), *, kinds=None, ascii=False, **more):
    columns = {name: value for name, value in STANDARD.items() if name not in left_out}
    return read_as_is(ply_of(path / "a.ply", {**columns, **more}, kinds=kinds, ascii=ascii))


@pytest.mark.parametrize("ascii", [False, True])
def test_the_filter_of_mip_splatting_is_applied(tmp_path, ascii):
    result = read(tmp_path, filter_3D=[0.008, 0.0, -0.008], ascii=ascii)
    wide, thin = np.hypot(0.01, 0.008), 0.9 * (1e-4 / 1.64e-4) ** 1.5
    np.testing.assert_allclose(result.gaussians.scales[:, 0], [wide, 0.01, wide], rtol=1e-5)
    np.testing.assert_allclose(result.gaussians.opacities, [thin, 0.9, thin], rtol=1e-5)
    assert len(result.notes) == 1 and "filter_3D" in result.notes[0]


def test_the_filter_widens_each_side_by_itself(tmp_path):
    sides = {"scale_0": np.log(0.03), "scale_1": np.log(0.02), "scale_2": -np.inf}
    result = read(tmp_path, **sides, filter_3D=0.01)
    wanted = np.sqrt(np.square([0.03, 0.02, 0]) + 1e-4)
    np.testing.assert_allclose(result.gaussians.scales, np.tile(wanted, (3, 1)), rtol=1e-5)
    assert not result.gaussians.opacities.any(), "a flat one has no volume to spread"


def test_a_filter_without_numbers_drops_the_row(tmp_path):
    result = read(tmp_path, filter_3D=[0.0, np.nan, np.inf])
    assert (len(result.gaussians), result.dropped) == (1, 2)


def test_activated_values_are_read_as_they_are(tmp_path):
    values = {"scale_0": 0.03, "scale_1": 0.02, "scale_2": 0.01, "opacity": [0.0, 0.25, 1.0]}
    result = read(tmp_path, **values)
    np.testing.assert_allclose(result.gaussians.scales[0], [0.03, 0.02, 0.01], rtol=1e-6)
    np.testing.assert_allclose(result.gaussians.opacities, [0, 0.25, 1], rtol=1e-6)
    assert len(result.notes) == 1 and "not logarithms" in result.notes[0]


@pytest.mark.parametrize(
    "values",
    [
        {"scale_0": 2.0, "scale_1": 1.0, "scale_2": 0.5},
        {"opacity": [0.1, 0.5, 0.9]},
        {"scale_0": 2.0, "scale_1": 1.0, "scale_2": 0.5, "opacity": [0.1, 0.5, 1.1]},
        {"scale_0": [2.0, 1.0, 0.0], "scale_1": 1.0, "scale_2": 0.5, "opacity": 0.5},
    ],
    ids=["millimetres", "opacities", "one opacity", "one scale"],
)
def test_only_all_scales_and_all_opacities_tell_activated_values(tmp_path, values):
    result = read(tmp_path, **values)
    raw = {**STANDARD, **values}
    wanted = np.broadcast_to(np.exp(raw["scale_0"]), 3)
    np.testing.assert_allclose(result.gaussians.scales[:, 0], wanted, rtol=1e-5)
    wanted = np.broadcast_to(1 / (1 + np.exp(-np.array(raw["opacity"]))), 3)
    np.testing.assert_allclose(result.gaussians.opacities, wanted, rtol=1e-5)
    assert result.notes == ()


def test_rows_without_numbers_do_not_hide_activated_values(tmp_path):
    scales = {f"scale_{i}": [0.1, np.nan, 0.2] for i in range(3)}
    result = read(tmp_path, **scales, opacity=[0.5, 0.5, 0.7])
    np.testing.assert_allclose(result.gaussians.scales[:, 0], [0.1, 0.2], rtol=1e-6)
    assert result.dropped == 1


def test_gaussians_of_2dgs_are_flat(tmp_path):
    result = read(tmp_path, ["scale_2"], scale_1=np.log(0.02))
    np.testing.assert_allclose(result.gaussians.scales[0], [0.01, 0.02, 0.0001], rtol=1e-5)
    assert len(result.notes) == 1 and "2DGS" in result.notes[0]


def test_gaussians_of_one_scale_are_round(tmp_path):
    result = read(tmp_path, ["scale_1", "scale_2"])
    np.testing.assert_allclose(result.gaussians.scales[0], [0.01] * 3, rtol=1e-5)
    assert len(result.notes) == 1 and "round" in result.notes[0]


@pytest.mark.parametrize(
    ("kind", "values"), [("u1", [255, 0, 51]), ("f4", [1.0, 0.0, 0.2]), ("f4", [255.0, 0.0, 51.0])]
)
@pytest.mark.parametrize("ascii", [False, True])
def test_colours_as_rgb_take_the_place_of_harmonics(tmp_path, kind, values, ascii):
    rgb = dict(zip(("red", "green", "blue"), values, strict=True))
    result = read(
        tmp_path, ["f_dc_0", "f_dc_1", "f_dc_2"], **rgb, ascii=ascii, kinds=dict.fromkeys(rgb, kind)
    )
    np.testing.assert_allclose(result.gaussians.rgb[0], [1, 0, 0.2], atol=1e-6)


def test_colours_beside_harmonics_are_only_a_copy(tmp_path):
    result = read(tmp_path, red=[0, 0, 0], green=0, blue=0, kinds={"red": "u1"})
    np.testing.assert_allclose(result.gaussians.sh[0, 0], [0.5, 0, -0.5])
    assert SH_C0 > 0 and result.notes == ()


def test_harmonics_of_degree_4_are_left_out(tmp_path):
    rest = {f"f_rest_{i}": float(i) for i in range(72)}
    result = read(tmp_path, **rest)
    assert result.gaussians.sh.shape == (3, 16, 3)
    for channel in range(3):
        np.testing.assert_allclose(
            result.gaussians.sh[0, 1:, channel], np.arange(15) + 24 * channel
        )
    assert result.notes == ("Harmonics of degree 4 are ignored.",)


def test_unknown_columns_are_named_once(tmp_path):
    more = {"roughness": 0.5, "obj_dc_0": 0, "obj_dc_1": 0, "obj_dc_2": 0, "t\x1b[31mx": 0, "nx": 0}
    result = read(tmp_path, **more, **{f"f_rest_{i}": 0.0 for i in range(9)})
    (note,) = result.notes
    assert note.endswith("ignored: roughness, obj_dc_0 to obj_dc_2, t?[31mx.")


def test_many_unknown_columns_make_a_short_note(tmp_path):
    (note,) = read(tmp_path, **dict.fromkeys("abcdefghijklmnopqr", 0.0)).notes
    assert note.endswith("a, b, c, d, e, f, g, h, i, j, k, l and 6 more.")


def test_gaussians_without_object_follow_their_neighbour(tmp_path):
    places = {"x": [0.0, 5.0, 5.1, 0.1, 9.0], "y": 0.0}
    result = read(tmp_path, **places, object_id=[0, 3, np.nan, -1, 2e9])
    assert result.gaussians.object_id.tolist() == [0, 3, 3, 0, 10**6]
    assert (result.dropped, len(result.notes)) == (0, 1)
    assert result.notes[0].startswith("2 Gaussians belong to no object")


def test_file_without_valid_objects_is_a_single_object(tmp_path):
    result = read(tmp_path, object_id=[np.nan, -1, -np.inf])
    assert result.gaussians.object_id is None and len(result.gaussians) == 3
    assert "one object" in result.notes[0]
