"""PLY files: every dialect is read, ours is standard, and bad files say what is wrong."""

import gzip
import os
import struct

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import SH_C0, Gaussians, sh_basis
from phy124.io import ply
from phy124.io.axes import DIALECTS, orientation
from phy124.io.ply import read_ply, write_ply
from phy124.io.plyheader import MAX_BYTES, read_header
from support.shapes import random_gaussians

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]


def header(names=NAMES, count=2, kind="float", encoding="binary_little_endian", after=()):
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {count}"]
    lines += [f"property {kind} {name}" for name in names]
    return "\n".join([*lines, *after, "end_header\n"]).encode()


def rows(count=2, names=NAMES):
    """Rows of recognisable raw values, [count, len(names)]."""
    values = np.arange(count * len(names)).reshape(count, -1) / 10.0
    if "rot_0" in names:
        values[:, names.index("rot_0") :] = 1, 0, 0, 0
    return values


def save(folder, content, name="it.ply"):
    path = folder / name
    path.write_bytes(content)
    return path


def assert_same(a, b, atol=3e-7):
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=3e-7, atol=atol)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_written_files_are_read_back(tmp_path, rng, degree):
    gaussians = random_gaussians(rng, degree=degree)
    write_ply(tmp_path / "a.ply", gaussians)
    back, dropped = read_ply(tmp_path / "a.ply")
    assert dropped == 0
    assert_same(gaussians, back, atol=3e-6)
    assert_same(back, read_ply(tmp_path / "a.ply", up="-y").gaussians, atol=0)
    # Axes are only renamed: not one bit of the centres changes.
    np.testing.assert_array_equal(gaussians.means, back.means)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_layout_is_inrias_with_y_down(tmp_path, three_gaussians):
    write_ply(tmp_path / "a.ply", three_gaussians)
    content = (tmp_path / "a.ply").read_bytes()
    text, body = content.split(b"end_header\n", 1)
    lines = text.decode().splitlines()
    names = [line.split()[-1] for line in lines if line.startswith("property float")]
    assert lines[1] == "format binary_little_endian 1.0"
    assert any(line.startswith("comment") and "y down" in line for line in lines)
    assert names == ["x", "y", "z", "nx", "ny", "nz", *NAMES[3:]]
    table = np.frombuffer(body, "<f4").reshape(3, 17)
    x, y, z = three_gaussians.means.T
    # Right is the world's y, down its -z, into the picture its -x.
    np.testing.assert_array_equal(table[:, :3], np.stack([y, -z, -x], axis=1))
    np.testing.assert_allclose(np.exp(table[0, 10:13]), [0.05, 0.02, 0.1], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-table[:, 9])), [0.9, 0.5, 0.7], rtol=1e-6)
    np.testing.assert_allclose(table[0, 6:9] * SH_C0 + 0.5, [1, 0, 0], atol=1e-6)


def test_extreme_values_are_written_finite(tmp_path):
    flat = Gaussians(
        np.zeros((2, 3)), [[1, 0, 0, 0]] * 2, np.zeros((2, 3)), [0, 1], np.zeros((2, 1, 3))
    )
    write_ply(tmp_path / "a.ply", flat)
    back, dropped = read_ply(tmp_path / "a.ply")
    assert dropped == 0
    np.testing.assert_allclose(back.opacities, [0, 1], atol=2e-7)
    assert 0 < back.scales.max() < 1e-11


def test_failed_write_leaves_the_old_file(tmp_path, three_gaussians, monkeypatch):
    write_ply(tmp_path / "a.ply", three_gaussians)
    before = (tmp_path / "a.ply").read_bytes()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(ply.os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_ply(tmp_path / "a.ply", three_gaussians.select(np.array([0])))
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]
    assert (tmp_path / "a.ply").read_bytes() == before


@pytest.mark.parametrize(("dialect", "axes"), DIALECTS.items())
def test_axes_of_each_dialect(tmp_path, dialect, axes):
    """The file's up direction becomes +z and its front +x; nothing is mirrored."""
    units = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    up, front = (np.array(units[a[-1]]) * (-1 if a[0] == "-" else 1) for a in axes)
    values = rows(3)
    values[:, :3] = up, front, np.cross(up, front)
    path = save(tmp_path, header(count=3) + values.astype("<f4").tobytes())
    means = read_ply(path, dialect=dialect).gaussians.means
    np.testing.assert_array_equal(means, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(means, read_ply(path, up=axes[0], front=axes[1]).gaussians.means)


@pytest.mark.parametrize("up", ["y", "-y", "z", "-x"])
def test_shape_and_colour_turn_with_the_axes(tmp_path, rng, up):
    gaussians = random_gaussians(rng, degree=3)
    write_ply(tmp_path / "a.ply", gaussians)
    as_file = read_ply(tmp_path / "a.ply", up="z", front="x").gaussians
    ours = read_ply(tmp_path / "a.ply", up=up).gaussians
    turn = np.linalg.lstsq(as_file.means, ours.means, rcond=None)[0].T.round()
    assert np.linalg.det(turn) == 1
    expected = turn @ as_file.covariances() @ turn.T
    np.testing.assert_allclose(ours.covariances(), expected, atol=1e-7)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = np.einsum("dk,nkc->ndc", sh_basis(directions, 16), as_file.sh)
    seen_ours = np.einsum("dk,nkc->ndc", sh_basis(directions @ turn.T, 16), ours.sh)
    np.testing.assert_allclose(seen_ours, seen, atol=2e-5)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian", "ascii"])
@pytest.mark.parametrize("kind", ["float", "float32", "double"])
def test_encodings_and_number_types(tmp_path, encoding, kind):
    values = rows()
    type_ = ("<" if "little" in encoding else ">") + ("f8" if kind == "double" else "f4")
    if encoding == "ascii":
        body = "\n".join(" ".join(map(repr, row)) for row in values.tolist()).encode()
    else:
        body = values.astype(type_).tobytes()
    path = save(tmp_path, header(kind=kind, encoding=encoding) + body)
    gaussians = read_ply(path, up="z").gaussians
    np.testing.assert_allclose(gaussians.means, values[:, :3], rtol=1e-6)
    np.testing.assert_allclose(gaussians.sh[:, 0], values[:, 3:6], rtol=1e-6)
    np.testing.assert_allclose(gaussians.scales, np.exp(values[:, 7:10]), rtol=1e-5)


def test_other_elements_comments_and_line_ends(tmp_path):
    before = b"ply\r\nformat binary_little_endian 1.0\r\ncomment hello\r\nobj_info x\r\n"
    before += b"element camera 3\r\nproperty uchar a\r\nproperty double b\r\n"
    rest = header().split(b"1.0\n", 1)[1].replace(b"end_header\n", b"")
    after = b"element extra 1\r\nproperty list uchar int i\r\nend_header\r\n"
    content = (
        before + rest.replace(b"\n", b"\r\n") + after + bytes(27) + rows().astype("<f4").tobytes()
    )
    gaussians = read_ply(save(tmp_path, content + b"\x01\x00\x00\x00\x00"), up="z").gaussians
    np.testing.assert_allclose(gaussians.means, rows()[:, :3], rtol=1e-6)


@pytest.mark.parametrize(
    "comment",
    [
        "made from Åse",
        "line …end",
        "\x85",
        "\u2028\x1c\x0b",
        "one\xa0word",
        b"\x85\xff \xe5",
        b"end_header x",
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_comments_of_any_bytes_are_no_lines(tmp_path, comment, end):
    text = comment if isinstance(comment, bytes) else comment.encode()
    head = header().replace(b"element vertex", b"comment " + text + b"\nelement vertex")
    values = rows()
    values[0, 0] = 1.4e-44  # its first byte is that of a line's end
    assert values.astype("<f4").tobytes()[:1] == b"\n"
    content = head.replace(b"\n", end.encode()) + values.astype("<f4").tobytes()
    gaussians = read_ply(save(tmp_path, content), up="z").gaussians
    np.testing.assert_allclose(gaussians.means, rows()[:, :3], rtol=1e-6, atol=1e-30)


def test_comments_are_read_as_utf_8(tmp_path):
    head = header().replace(
        b"element", "comment Vertical axis: z\ncomment Åse\nelement".encode(), 1
    )
    path = save(tmp_path, head + rows().astype("<f4").tobytes())
    assert read_header(path).comments == ("Vertical axis: z", "Åse")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_blank_lines_of_an_ascii_file_are_no_rows(tmp_path, end):
    head = header(encoding="ascii").replace(
        b"element", b"element camera 2\nproperty int a\nelement", 1
    )
    lines = [
        "",
        "7",
        " \t",
        "8",
        "",
        *(" ".join(map(repr, row)) for row in rows().tolist()),
        "",
        "",
    ]
    lines.insert(6, "")
    content = head.replace(b"\n", end.encode()) + end.join(lines).encode()
    gaussians = read_ply(save(tmp_path, content), up="z").gaussians
    np.testing.assert_allclose(gaussians.means, rows()[:, :3], rtol=1e-6)


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "1.#QNAN", "-1.#INF00", "-inf"])
def test_words_for_no_number_drop_their_row_alone(tmp_path, word):
    lines = [" ".join(map(repr, row)) for row in rows().tolist()]
    lines[0] = lines[0].replace("0.1", word, 1)
    path = save(tmp_path, header(encoding="ascii") + "\n".join(lines).encode())
    gaussians, dropped = read_ply(path, up="z")
    assert dropped == 1
    np.testing.assert_allclose(gaussians.means, rows()[1:, :3], rtol=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rest_is_channel_major_in_any_order(tmp_path, degree):
    count = (degree + 1) ** 2 - 1
    names = [f"f_rest_{i}" for i in reversed(range(3 * count))] + NAMES
    values = rows(1, names)
    sh = read_ply(save(tmp_path, header(names, 1) + values.astype("<f4").tobytes()), up="z")[0].sh
    by_name = dict(zip(names, values[0], strict=True))
    for channel in range(3):
        for k in range(count):
            assert sh[0, 1 + k, channel] == pytest.approx(by_name[f"f_rest_{channel * count + k}"])


def test_rows_that_are_not_finite_are_dropped_and_counted(tmp_path):
    values = rows(5)
    values[1, 0], values[2, 7], values[3, 9] = np.nan, np.inf, 1e4
    values[4, 10:] = 0
    path = save(tmp_path, header(count=5) + values.astype("<f4").tobytes())
    gaussians, dropped = read_ply(path, up="z")
    assert dropped == 3
    np.testing.assert_allclose(gaussians.means, values[[0, 4], :3], rtol=1e-6)
    np.testing.assert_array_equal(gaussians.quats[1], [1, 0, 0, 0])


GAP = NAMES + [f"f_rest_{i}" for i in range(1, 10)]
REFUSED = {
    "empty file": (b"", "it.ply", "is empty .0 bytes"),
    "text": (b"hello, I am text", "it.ply", "does not begin with `ply`"),
    "spz": (gzip.compress(b"x"), "it.ply", "an SPZ.*phy124 convert"),
    "ksplat": (bytes(64), "it.ksplat", "does not begin with `ply`.*splat-transform"),
    "sog": (b"PK\x03\x04", "it.sog", "SOG.*phy124 convert"),
    "no points": (header(count=0), "it.ply", "contains no Gaussians"),
    "plain points": (header(["x", "y", "z", "red"]) + bytes(32), "it.ply", "plain point cloud"),
    "a gap": (header(NAMES[:8] + NAMES[9:]) + bytes(999), "it.ply", "has no scale_1"),
    "no turns": (header(NAMES[:10]) + bytes(999), "it.ply", "has no rot_0, rot_1"),
    "anchors": (header([*NAMES, "f_offset_0"]) + bytes(999), "it.ply", "anchors of Scaffold-GS"),
    "packed": (header(["packed_position", "packed_scale"]), "it.ply", "by SuperSplat.*convert"),
    "cut rows": (header() + bytes(100), "it.ply", "cut short: only 1 of 2"),
    "cut ascii": (header(encoding="ascii") + b"1 2 3", "it.ply", "cut short: only 0 of 2"),
    "words": (header(encoding="ascii") + b"one " * 28, "it.ply", "cannot be parsed"),
    "ragged": (header(encoding="ascii") + b"1 " * 29, "it.ply", "one value per property"),
    "cut header": (header()[:-20], "it.ply", "cut short within its header"),
    "huge header": (b"ply\n" + b"comment x\n" * MAX_BYTES, "it.ply", "header is longer than"),
    "huge count": (header(count=10**9), "it.ply", "states 1,000,000,000"),
    "negative": (header(count=-1), "it.ply", "malformed .element vertex counts -1 rows"),
    "fraction": (header(count="2.0"), "it.ply", "element vertex counts 2.0 rows"),
    "digits": (header(count="9" * 5000), "it.ply", "element vertex counts 9{40} rows"),
    "encoding": (header(encoding="utf8"), "it.ply", "ascii or binary"),
    "type": (header(kind="quaternion"), "it.ply", "unknown type quaternion"),
    "no vertex": (header().replace(b"vertex", b"thing"), "it.ply", "no element vertex"),
    "twice": (header([*NAMES, "x"]), "it.ply", "malformed"),
    "rest": (header([*NAMES, "f_rest_0"]) + bytes(999), "it.ply", "has 1 f_rest values"),
    "rest gap": (header(GAP) + bytes(999), "it.ply", "9 f_rest"),
    "all nan": (header(count=1) + struct.pack("<f", np.nan) * 14, "it.ply", "finite values"),
    "list": (header(after=["property list uchar int i"]), "it.ply", "list properties before or in"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused_with_a_reason(tmp_path, case):
    content, name, message = REFUSED[case]
    with pytest.raises(InputError, match=message) as caught:
        read_ply(save(tmp_path, content, name))
    assert caught.value.remedy.endswith(".")
    assert caught.value.limit.endswith(".")


def test_a_file_that_shrinks_while_it_is_read_is_cut_short(tmp_path, monkeypatch):
    path = save(tmp_path, header(count=2) + rows(2).astype("<f4").tobytes())
    read_whole = np.fromfile

    def shrunk(file, *arguments, **options):
        os.truncate(file, path.stat().st_size - 4)
        return read_whole(file, *arguments, **options)

    monkeypatch.setattr(np, "fromfile", shrunk)
    with pytest.raises(InputError, match="cut short: only 1 of 2"):
        read_ply(path)


def test_missing_file_and_bad_options_are_refused(tmp_path, three_gaussians):
    with pytest.raises(InputError, match="no such file"):
        read_ply(tmp_path / "none.ply")
    write_ply(tmp_path / "a.ply", three_gaussians)
    for options, message in (
        ({"up": "w"}, "not an axis.*Choose one of"),
        ({"up": "z", "front": "-z"}, "along the up axis"),
        ({"front": "q"}, "not an axis"),
        ({"dialect": "klingon"}, "not known.*3dgs"),
    ):
        with pytest.raises(InputError, match=message):
            read_ply(tmp_path / "a.ply", **options)


ZOO = ["ascii", "big_endian", "inria_sh0", "inria_sh1", "inria_sh3", "lgm_layout", "shuffled"]


@pytest.mark.parametrize("name", [*ZOO, "with_uchar_rgb", "sharp_layout_opencv"])
def test_zoo_of_dialects(golden, name):
    truth = np.load(golden / "generators/ply_zoo.npz")
    gaussians, dropped = read_ply(golden / f"generators/ply_zoo/{name}.ply", up="z")
    assert dropped == 0
    shift = [0, 0, 2.5] if "sharp" in name else 0
    np.testing.assert_allclose(gaussians.means, truth["xyz"] + shift, atol=1e-6)
    np.testing.assert_allclose(gaussians.scales, truth["scale"], rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, truth["opacity"], rtol=1e-6)
    np.testing.assert_allclose(gaussians.covariances(), truth["covariance"], rtol=1e-6, atol=2e-8)
    np.testing.assert_allclose(gaussians.rgb, np.clip(truth["rgb"], 0, 1), atol=1e-6)
    rest = truth["sh_rest"][:, : gaussians.sh.shape[1] - 1]
    np.testing.assert_array_equal(gaussians.sh[:, 1:], rest)


def test_zoo_of_broken_ones(golden):
    folder = golden / "generators/ply_zoo"
    gaussians, dropped = read_ply(folder / "nan_inf_zeroquat.ply", up="z")
    assert (len(gaussians), dropped) == (62, 2)
    np.testing.assert_allclose(np.linalg.norm(gaussians.quats, axis=1), 1, atol=1e-6)
    with pytest.raises(InputError, match="no Gaussians"):
        read_ply(folder / "empty.ply")


def test_turn_equals_the_trellis_transform(golden):
    """TRELLIS saves (x, -z, y) of its z-up world; undoing that is our reading of it."""
    matrix = np.load(golden / "generators/ply_zoo.npz")["trellis_T"]
    back = orientation(dialect="trellis") @ matrix
    np.testing.assert_array_equal(back @ [0, 0, 1], [0, 0, 1])
    assert np.linalg.det(back) == pytest.approx(1)
