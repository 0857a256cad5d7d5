"""Formats of Gaussians: what is written reads back, and what other programs wrote is read."""

import os
import zlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile
from phy124.io import content
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.content import MAX_GAUSSIANS
from phy124.io.formats import (
    FORMATS,
    find_written_format,
    is_file_of_gaussians,
    read_as_is,
    read_gaussians,
    recognise,
    splat,
    spz,
    write_gaussians,
    written_formats,
)
from phy124.io.formats.quantise import make_codebook, make_palette, nearest_codes
from phy124.io.ply import read_ply, write_ply
from phy124.pipeline.capture import capture
from phy124.scene import Scene
from support.quantisation import Errors, bound, errors, many

FOREIGN = Path(__file__).parent / "support" / "formats"
GUIDE = (Path(__file__).parents[1] / "docs/guide/formats.md").read_text("utf-8")
CUT = ("sog", "splat")
"""Formats whose other writers cut digits off instead of rounding: a whole step may be missing."""
STILL = [name for name, f in FORMATS.items() if f.encode and f.read]


def assert_same(result: Gaussians, wanted: Gaussians) -> None:
    """Equal but for rounding; the axes of a Gaussian may be named in another order."""
    np.testing.assert_allclose(result.means, wanted.means, atol=1e-5)
    np.testing.assert_allclose(result.covariances(), wanted.covariances(), rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(result.opacities, wanted.opacities, atol=1e-6)
    np.testing.assert_allclose(result.sh, wanted.sh, atol=2e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("name", STILL)
def test_formats_round_trip_within_their_steps(tmp_path, rng, name, degree):
    wanted, path = many(rng, 300, degree), tmp_path / f"a{FORMATS[name].suffix}"
    assert write_gaussians(path, wanted, name, antialiased=True) is FORMATS[name]
    content = read_as_is(path)
    assert content.dropped == 0 and content.axes == FORMATS[name].axes
    assert content.antialiased == (name not in ("splat", "glb"))
    assert content.gaussians.sh_degree == min(degree, FORMATS[name].degree)
    allowed = bound(name, wanted, path.read_bytes())
    there = rotate_gaussians(wanted, orientation(*content.axes).T)
    assert not errors(content.gaussians, there).within(allowed)
    ours = read_gaussians(path).gaussians
    np.testing.assert_allclose(ours.means, wanted.means, atol=allowed.means)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("file", "name", "axes"),
    [
        ("splat-transform.sog", "sog", ()),
        ("splat-transform.glb", "glb", ()),
        ("splat-transform.compressed.ply", "compressed-ply", ()),
        ("splat-transform-v3.spz", "spz foreign", ()),
        ("splat-transform-v4.spz", "spz foreign", ()),
        ("spz-js-v2.spz", "spz foreign v2", ("-y", "-z")),
        ("gaussforge.splat", "splat", ()),
    ],
)
def test_files_of_other_programs_are_read(file, name, axes):
    """Axes, quaternions, scales, colours and opacities; harmonics turn with the axes."""
    wanted = read_ply(FOREIGN / "source.ply").gaussians
    content = read_as_is(FOREIGN / file)
    result, axes = content.gaussians, axes or content.axes
    wanted = rotate_gaussians(wanted, orientation(*axes).T)
    allowed = bound(name, wanted, (FOREIGN / file).read_bytes())
    if name == "sog":  # its palette of harmonics is judged by what its own program reads
        reference = read_as_is(FOREIGN / "splat-transform-sog.ply").gaussians
        assert not errors(result, reference).within(bound("glb", reference))
        wanted = Gaussians(**{**vars(wanted), "sh": wanted.sh[:, :1]})
    if name in CUT:
        allowed = Errors(*(2 * value for value in vars(allowed).values()))
    if name == "glb":
        assert_same(result, wanted)
    else:
        assert not errors(result, wanted, ordered=False).within(allowed)
    assert is_file_of_gaussians(FOREIGN / file)


def test_content_tells_the_format_whatever_the_name(tmp_path):
    kinds = {
        "splat-transform.sog": "sog",
        "splat-transform.glb": "glb",
        "gaussforge.splat": "splat",
        "splat-transform-v4.spz": "spz",
        "spz-js-v2.spz": "spz",
        "source.ply": "ply",
        "splat-transform.compressed.ply": "compressed-ply",
    }
    for file, kind in kinds.items():
        copy = tmp_path / "copy.dat"
        copy.write_bytes((FOREIGN / file).read_bytes())
        assert recognise(copy).name == kind and is_file_of_gaussians(copy)
        assert len(read_gaussians(copy).gaussians) == 40
    other = tmp_path / "relief"
    for data in (b"", b"hello" * 64, bytes(64), np.random.default_rng(0).bytes(3200)):
        other.write_bytes(data)
        assert not is_file_of_gaussians(other)
        with pytest.raises(InputError, match="not a file of Gaussians"):
            recognise(other)
    assert not is_file_of_gaussians("relief") and is_file_of_gaussians("missing.SPZ")


def test_axes_options_go_before_those_of_the_format(tmp_path, three_gaussians):
    path = tmp_path / "a.glb"
    write_gaussians(path, three_gaussians)
    raw = read_as_is(path)
    assert raw.axes == ("y", "z")
    x, y, z = three_gaussians.means.T
    np.testing.assert_array_equal(raw.gaussians.means, np.stack([y, z, x], axis=1))
    lying = read_gaussians(path, up="-y", front="-z").gaussians
    np.testing.assert_array_equal(lying.means, three_gaussians.means * [-1, 1, -1])
    by_dialect = read_gaussians(path, dialect="3dgs").gaussians
    np.testing.assert_array_equal(by_dialect.means, lying.means)
    back = read_gaussians(path, front="-z").gaussians
    np.testing.assert_array_equal(back.means, three_gaussians.means * [-1, -1, 1])
    for options, words in (({"up": "w"}, "not an axis"), ({"dialect": "x"}, "not known")):
        with pytest.raises(InputError, match=words):
            read_gaussians(path, **options)


@pytest.mark.parametrize(
    ("tag", "axes", "antialiased"),
    [
        ("Vertical Axis: z", ("z", None), False),
        ("vertical axis: -x", ("-x", None), False),
        ("Vertical axis: y", ("-y", "-z"), False),
        ("SplatRenderMode: mip", ("-y", "-z"), True),
        ("antialiased 1", ("-y", "-z"), True),
        ("antialiased 0", ("-y", "-z"), False),
        ("SplatRenderMode: 2dgs", ("-y", "-z"), False),
    ],
)
def test_tags_of_a_ply_are_read(tmp_path, three_gaussians, tag, axes, antialiased):
    path = tmp_path / "a.ply"
    write_ply(path, three_gaussians)
    head, body = path.read_bytes().split(b"end_header\n", 1)
    kept = [line for line in head.split(b"\n") if not line.startswith(b"comment")]
    path.write_bytes(
        b"\n".join([*kept[:2], f"comment {tag}".encode(), *kept[2:]]) + b"end_header\n" + body
    )
    content = read_as_is(path)
    assert (content.axes, content.antialiased) == (axes, antialiased)
    turn = orientation(*axes) @ orientation().T
    there = rotate_gaussians(three_gaussians, turn).means
    np.testing.assert_allclose(read_ply(path).gaussians.means, there, atol=1e-6)
    np.testing.assert_allclose(read_gaussians(path).gaussians.means, there, atol=1e-6)


def test_tags_of_a_ply_are_written(tmp_path, three_gaussians):
    path = tmp_path / "a.ply"
    for mip, words in ((True, (b"mip", b"1")), (False, (b"default", b"0"))):
        write_gaussians(path, three_gaussians, antialiased=mip)
        head = path.read_bytes().split(b"end_header")[0]
        assert b"comment Vertical axis: -y\n" in head
        assert b"comment SplatRenderMode: " + words[0] + b"\n" in head
        assert b"comment antialiased " + words[1] + b"\n" in head


def test_far_objects_fit_into_spz(tmp_path, three_gaussians):
    for size in (1e-3, 1.0, 1e3, 1e5):
        wanted = three_gaussians.transform(size, np.zeros(3))
        write_gaussians(tmp_path / "a.spz", wanted)
        result = read_gaussians(tmp_path / "a.spz").gaussians
        reach = np.abs(wanted.means).max()
        assert np.abs(result.means - wanted.means).max() <= max(reach / (1 << 22), 0.5 / 2**16)


def test_degree_4_of_spz_is_left_out(tmp_path):
    """Niantic's library writes degree 4, too."""
    harmonics = np.full((2, 24, 3), 128, np.uint8)
    harmonics[:, 0], harmonics[:, 20] = 160, 255
    sections = [bytes(18), b"\xff" * 2, bytes(6), bytes(6), bytes(8), harmonics.tobytes()]
    head = spz.Head(b"NGSP", 3, 2, 4, 12, 0, 0)
    (tmp_path / "a.spz").write_bytes(spz._gzip(spz.HEADER.pack(*head) + b"".join(sections)))
    sh = read_as_is(tmp_path / "a.spz").gaussians.sh
    assert sh.shape == (2, 16, 3)
    assert (sh[:, 1] == 0.25).all() and (sh[:, 2:] == 0).all()


def bomb(count: int) -> bytes:
    """A gzip of zeros that says it is so many Gaussians."""
    packer = zlib.compressobj(9, wbits=31)
    head = packer.compress(spz.HEADER.pack(b"NGSP", 3, count, 0, 12, 0, 0))
    return head + packer.compress(bytes(20 * min(count, 1_000_000))) + packer.flush()


@pytest.mark.parametrize(
    ("count", "words"),
    [(1_000_000, "bytes can hold"), (MAX_GAUSSIANS + 1, "the limit is"), (0, "contains no")],
)
def test_bombs_are_refused_before_they_unfold(tmp_path, count, words):
    (tmp_path / "a.spz").write_bytes(bomb(count))
    with pytest.raises(InputError, match=words):
        read_gaussians(tmp_path / "a.spz")


def test_file_larger_than_the_memory_is_refused(tmp_path, three_gaussians, monkeypatch):
    (tmp_path / "a.splat").write_bytes(splat.encode(three_gaussians))
    write_ply(tmp_path / "a.ply", three_gaussians)
    monkeypatch.setattr(content, "free_memory", lambda: 700.0)
    for name in ("a.splat", "a.ply"):
        with pytest.raises(InputError, match="3 Gaussians needs about"):
            read_gaussians(tmp_path / name)


def test_random_bytes_are_no_splat(tmp_path):
    (tmp_path / "a.splat").write_bytes(np.random.default_rng(0).bytes(3200))
    with pytest.raises(InputError, match="of another kind"):
        read_gaussians(tmp_path / "a.splat")


def head_of(name: str, count: int) -> bytes:
    """The first bytes of a file that states a number of Gaussians."""
    if name == "a.spz":
        return bomb(count)
    columns = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    head += [f"property float {column}" for column in columns.split()]
    return "\n".join([*head, "end_header\n"]).encode()


@pytest.mark.parametrize("name", ["a.spz", "a.ply"])
def test_too_many_for_a_run_are_refused_by_the_header(tmp_path, name, monkeypatch):
    """The rows are zeros that are never read."""
    (tmp_path / name).write_bytes(head_of(name, 20_000_000))
    if name == "a.ply":
        os.truncate(tmp_path / name, 20_000_000 * 14 * 4 + 1000)
    monkeypatch.setattr(content, "free_memory", lambda: 8.4e9)
    file = PlyFile(str(tmp_path / name))
    with pytest.raises(InputError, match=r"20,000,000 Gaussians needs .* 6.7 GB may") as e:
        capture(file, Scene())
    assert "--gaussians to 5000000 or fewer" in str(e.value)  # the largest that is accepted
    (tmp_path / name).write_bytes(head_of(name, 20_000_000))
    for read in (partial(capture, file, Scene(), count=10_000_000), partial(read_as_is, file.path)):
        with pytest.raises(InputError, match=r"bytes can hold|cut short"):
            read()


def test_unknown_formats_and_folders_are_refused(tmp_path, three_gaussians):
    for path, name, words in (
        ("a.xyz", None, "cannot write a format"),
        ("a.ply", "obj", "Choose one of ply"),
        ("a.ply", "compressed-ply", "This output format is not supported"),
        ("no/a.glb", None, "existing folder"),
    ):
        with pytest.raises(InputError, match=words):
            write_gaussians(tmp_path / path, three_gaussians, name)
    assert (
        find_written_format(Path("x.USDA")).name == "usd"
        and find_written_format(Path("x.spz")).name == "spz"
    )
    assert not list(tmp_path.iterdir())


def test_every_format_is_declared_whole():
    for name, format in FORMATS.items():
        assert format.name == name and format.suffix.startswith(".") and format.opens_in
        assert format.read or format.written
        assert (name in written_formats()) == format.written
        orientation(*format.axes)


def test_a_codebook_is_near_all_values(rng):
    values = np.concatenate([rng.normal(size=5000), [-27.6, 9.0]])
    codes = make_codebook(values)
    error = np.abs(codes[nearest_codes(codes, values)] - values)
    assert len(codes) == 256 and (np.diff(codes) >= 0).all()
    assert error.max() < 37 / 127 and np.sqrt((error**2).mean()) < 0.02
    assert np.ptp(make_codebook(np.zeros(3))) == 0


def test_a_palette_holds_few_vectors_exactly_and_many_nearly(rng):
    vectors = rng.normal(size=(4000, 9)).astype(np.float32)
    entries, labels = make_palette(vectors, 4096)
    np.testing.assert_array_equal(entries[labels], vectors)
    few = (rng.normal(size=(64, 9))[rng.integers(64, size=4000)]).astype(np.float32)
    error = {}
    for most in (16, 256):
        entries, labels = make_palette(few, most)
        assert len(entries) == most and labels.max() == most - 1
        error[most] = float(np.square(entries[labels] - few).mean())
    assert error[256] < 0.05 < error[16] < 1


@pytest.mark.parametrize("name", STILL)
def test_object_ids_are_kept_by_formats_that_have_them(tmp_path, rng, name):
    path, plain = tmp_path / "a", many(rng, 300, 0)
    several = replace(plain, object_id=rng.choice([0, 3, 700, 70_000], 300).astype(np.int32))
    write_gaussians(path, several, name)
    result = read_gaussians(path).gaussians.object_id
    assert (result is not None) == bool(FORMATS[name].objects)
    assert result is None or np.array_equal(result, several.object_id)
    write_gaussians(path, plain, name)
    assert read_gaussians(path).gaussians.object_id is None


def test_the_guide_shows_every_format_as_it_is_declared():
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in GUIDE.splitlines()
        if line.count("|") == 11
    ][2:]
    assert rows == [
        [
            f"`{name}`" if f.written else "-",
            f.title,
            f"`{f.suffix}`",
            f.holds,
            f"to degree {f.degree}" if f.degree else "none",
            f.objects,
            ", ".join(f.axes),
            "yes" if f.read else "",
            "yes" if f.written else "",
            f.opens_in,
        ]
        for name, f in FORMATS.items()
    ]


def test_the_python_of_the_guide_runs(tmp_path, monkeypatch, three_gaussians):
    """The block of docs/guide/formats.md."""
    (tmp_path / "out/duck-press").mkdir(parents=True)
    write_ply(tmp_path / "out/duck-press/gaussians.ply", three_gaussians)
    monkeypatch.chdir(tmp_path)
    exec(GUIDE.split("```python\n")[1].split("```")[0], {})
    for name in ("duck.glb", "duck.spz"):
        assert len(read_gaussians(tmp_path / "out" / name).gaussians) == 3


def test_signalling_nans_stay_nan_without_a_warning():
    quats = np.array([[1, 0, 0, 0], [0, 2, 0, 0]], np.float32)
    quats.view(np.uint32)[0, 1] = 0x7F800001
    units = content.normalise_quats(quats)
    assert np.isnan(units[0]).any() and np.array_equal(units[1], [0, 1, 0, 0])
