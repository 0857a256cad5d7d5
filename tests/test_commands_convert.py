"""`phy124 export` and `phy124 convert`: files for other programs, and what is refused."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.gaussians import Frame
from phy124.generators import make, needs_image
from phy124.io.clip import Clip
from phy124.io.formats import FORMATS, read_as_is, read_gaussians, write_gaussians
from phy124.io.ply import raw_table
from support.model_files import ply_of
from support.quantisation import many
from support.shapes import ball


@pytest.fixture
def clip(tmp_path, three_gaussians):
    frames = [Frame(i, i / 8, three_gaussians.transform(1, np.array([i, 0, 0]))) for i in range(3)]
    Clip.from_frames(frames).save(tmp_path / "clip.safetensors")
    return tmp_path / "clip.safetensors"


def run_json(capsys, *words) -> dict:
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("name", [n for n, f in FORMATS.items() if f.encode and f.read])
def test_one_frame_and_all_frames_of_still_formats(clip, capsys, three_gaussians, name):
    suffix = FORMATS[name].suffix
    (file,) = run_json(capsys, "export", clip, "--to", name, "--frame", 2)["files"]
    assert file == str(clip.with_name(f"clip_0003{suffix}")), "named as with --all"
    there = read_gaussians(file).gaussians.means
    np.testing.assert_allclose(there, three_gaussians.means + [2, 0, 0], atol=1e-3)
    files = run_json(capsys, "export", clip, "--to", name, "--all")["files"]
    assert files == [str(clip.parent / f"clip-{name}/clip_000{i}{suffix}") for i in (1, 2, 3)]
    for i, path in enumerate(files):
        there = read_gaussians(path).gaussians.means
        np.testing.assert_allclose(there, three_gaussians.means + [i, 0, 0], atol=1e-3)


def test_all_frames_go_into_an_archive(clip, capsys):
    out = clip.with_name("it.zip")
    answer = run_json(capsys, "export", clip, "--to", "spz", "--all", "--out", out)
    assert answer["files"] == [str(out)] and answer["bytes"] == out.stat().st_size
    with zipfile.ZipFile(out) as archive:
        assert archive.namelist() == [f"clip_000{i}.spz" for i in (1, 2, 3)]


def test_moving_formats_hold_the_clip_or_one_frame(clip, capsys, three_gaussians):
    """Read by the format's own library."""
    fourdgs = pytest.importorskip("fourdgs.keyframe_delta_file", reason="fourdgs is not installed")
    (file,) = run_json(capsys, "export", clip, "--to", "4dgs")["files"]
    assert file == str(clip.with_suffix(".4dgs"))
    decoded, index = fourdgs.decode_indexed(clip.with_suffix(".4dgs").read_bytes())
    assert len(index) == 3
    bounds = decoded.grids.steps
    for i in range(3):
        state = fourdgs.render_at(decoded, i / 8 + 1e-3)
        there = (three_gaussians.means + [i, 0, 0])[:, [1, 2, 0]]  # y up, the front is z
        assert np.abs(state["centers"] - there).max() <= bounds.pos / 2 + 1e-6
        scales = np.log(state["scales"]) - np.log(three_gaussians.scales[:, [1, 2, 0]])
        assert np.abs(scales).max() <= bounds.scale_log / 2 + 1e-6
        quats = np.roll(state["rotations"], 1, axis=1)
        wanted = three_gaussians.quats[:, [0, 2, 3, 1]]
        dots = np.abs((quats * wanted).sum(axis=1))
        assert (4 * np.arcsin(np.sqrt((1 - dots.clip(0, 1)) / 2)) < 8 * bounds.rot).all()
        assert np.abs(state["rgb"] - three_gaussians.rgb).max() <= bounds.rgb / 2 + 1e-6
        opacities = three_gaussians.opacities
        assert np.abs(state["opacity"] - opacities).max() <= bounds.alpha / 2 + 1e-6
    run_json(
        capsys, "export", clip, "--to", "4dgs", "--frame", 1, "--out", clip.with_name("a.4dgs")
    )
    _, index = fourdgs.decode_indexed(clip.with_name("a.4dgs").read_bytes())
    assert len(index) == 1


def test_without_its_package_4dgs_says_what_to_install(clip, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "fourdgs", None)
    assert main(["export", str(clip), "--to", "4dgs"]) == 2
    assert "needs the package fourdgs" in capsys.readouterr().err
    assert [p.name for p in clip.parent.iterdir()] == [clip.name]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--to obj", "This output format is not supported"),
        ("--to frame", "Did you mean frames?"),
        ("--to html", "clip.safetensors --format html`"),
        ("--to glb --frame 3", "The clip has the frames 0 to 2"),
        ("--to glb --frame -1", "The clip has the frames 0 to 2"),
        ("--to glb --frame 1 --all", "Remove one of the two options"),
        ("--to glb --out no/a.glb", "no file can be written"),
        ("--to p4d --out clip.safetensors", "a file that this command reads"),
        ("--to frames --out ./clip.safetensors", "a file that this command reads"),
        ("--to mesh --out a.obj", "end in .glb. Rename it, or choose --to mesh-obj"),
        ("--to frames --frame 1", "--to frames writes all frames and all Gaussians"),
        ("--to frames --merge 2", "--to frames writes all frames and all Gaussians"),
    ],
)
def test_exports_that_cannot_be_are_refused(clip, capsys, monkeypatch, words, sentence):
    monkeypatch.chdir(clip.parent)
    assert main(["export", str(clip), *words.split()]) == 2
    assert sentence in capsys.readouterr().err
    assert [p.name for p in clip.parent.iterdir()] == [clip.name]


def test_convert_keeps_up_axis_and_metadata(tmp_path, capsys, rng):
    wanted = many(rng, 30, 2)
    write_gaussians(tmp_path / "a.spz", wanted, antialiased=True)
    run_json(capsys, "convert", tmp_path / "a.spz", tmp_path / "b.ply")
    content = read_gaussians(tmp_path / "b.ply")
    np.testing.assert_allclose(content.gaussians.means, wanted.means, atol=1e-5)
    assert content.antialiased and content.gaussians.sh_degree == 2
    run_json(capsys, "convert", tmp_path / "b.ply", tmp_path / "c.glb", "--up", "y", "--front", "z")
    turned = read_gaussians(tmp_path / "c.glb").gaussians.means
    np.testing.assert_allclose(turned, wanted.means * [-1, 1, -1], atol=1e-5)
    notes = run_json(capsys, "convert", tmp_path / "c.glb", tmp_path / "d.splat")["notes"]
    assert len(notes) == 1 and "no harmonics above degree 0" in notes[0]
    run_json(capsys, "convert", tmp_path / "c.glb", tmp_path / "e.spz", "--to", "spz4")
    assert (tmp_path / "e.spz").read_bytes()[:8] == b"NGSP\x04\0\0\0"
    assert main(["convert", str(tmp_path / "c.glb"), str(tmp_path / "f.splat")]) == 0
    assert "opens in antimatter15/splat" in capsys.readouterr().out


def test_a_clip_or_a_picture_is_not_converted(clip, capsys):
    assert main(["convert", str(clip), "a.ply"]) == 2
    assert "Use `phy124 render" in capsys.readouterr().err
    assert main(["convert", "a.png", "a.ply"]) == 2
    assert "Use `phy124 generate a.png`" in capsys.readouterr().err


def test_every_format_that_is_read_is_an_object(tmp_path, rng):
    """Like a `.ply` file, the format is accepted by `--generator`, `simulate` and the bridge, also
    by content."""
    wanted = many(rng, 200, 1)
    wanted = replace(wanted, opacities=wanted.opacities.clip(0.2))
    for name in ("spz", "spz4", "sog", "glb", "splat", "ply"):
        path = tmp_path / f"object-{name}{FORMATS[name].suffix}"
        write_gaussians(path, wanted, name)
        bare = path.with_suffix("")
        bare.write_bytes(path.read_bytes())
        for file in (path, bare):
            assert not needs_image(str(file))
            made = make(str(file))(None, seed=0, progress=lambda *_: None)
            assert len(made) == 200 and np.ptp(made.means, axis=0).max() == pytest.approx(1, 0.01)
    assert needs_image("relief") and needs_image("cmd: program a.ply")


def test_ignored_content_of_a_file_is_noted(tmp_path, capsys):
    table = raw_table(ball(50))
    columns = {name: table[name].astype(float) for name in table.dtype.names}
    columns |= {"filter_3D": 0.001, "roughness": 0.5, "x": columns["x"] + 5e6}
    path = ply_of(tmp_path / "a.ply", columns, kinds=dict.fromkeys(columns, "f8"))
    assert main(["convert", str(path), str(tmp_path / "b.ply")]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note:")]
    assert len(notes) == 3
    assert "filter_3D" in notes[0] and "roughness" in notes[1]
    assert "0, 5000000, 0 was subtracted" in notes[2]
    means = read_as_is(tmp_path / "b.ply").gaussians.means
    np.testing.assert_allclose(means[:, 0], table["x"], atol=2e-6)
