"""Exports: what is written reads back, and nothing half-done stays."""

import builtins
import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.errors import Cancelled, InputError
from phy124.gaussians import Frame
from phy124.io.clip import Clip
from phy124.io.formats.usd import write_usd
from phy124.io.ply import read_ply
from phy124.io.sequence import write_sequence

SUPERSPLAT = re.compile(r"(.*?)(\d+)(?:\.compressed)?\.ply$")
"""Pattern by which the SuperSplat editor recognises a sequence: equal first group, rising second
group."""


@pytest.fixture
def clip(three_gaussians) -> Clip:
    frames = [
        Frame(i, i / 24, three_gaussians.transform(1, np.array([0.1 * i, 0, -0.2 * i])))
        for i in range(3)
    ]
    return Clip.from_frames(frames)


def check(names, files, clip):
    assert names == [f"duck_{i:04}.ply" for i in (1, 2, 3)]
    matches = [SUPERSPLAT.match(name) for name in names]
    assert {m[1] for m in matches} == {"duck_"} and [int(m[2]) for m in matches] == [1, 2, 3]
    for file, frame in zip(files, clip.frames(), strict=True):
        back = read_ply(file).gaussians
        np.testing.assert_allclose(back.means, frame.gaussians.means, atol=1e-6)
        np.testing.assert_allclose(back.rgb, frame.gaussians.rgb, atol=1e-6)


def test_a_folder_of_numbered_files(tmp_path, clip):
    messages = []
    folder = tmp_path / "out"
    names = write_sequence(folder, clip, name="duck", progress=lambda *s: messages.append(s))
    assert sorted(p.name for p in folder.iterdir()) == names
    check(names, [folder / n for n in names], clip)
    assert messages == [("export", i, 3) for i in (1, 2, 3)]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert b"y down" in (folder / names[0]).read_bytes()[:400]


def test_an_archive(tmp_path, clip):
    path = tmp_path / "duck.ZIP"
    names = write_sequence(path, clip, name="duck")
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == names
        archive.extractall(tmp_path / "unpacked")
    check(names, [tmp_path / "unpacked" / n for n in names], clip)


def test_five_digits_for_ten_thousand_frames(tmp_path, three_gaussians, monkeypatch):
    g = three_gaussians.select(np.array([0]))
    frames = [Frame(i, i / 24, g) for i in range(2)]
    clip = Clip.from_frames(frames)
    monkeypatch.setattr(Clip, "__len__", lambda _: 10_000)
    names = write_sequence(tmp_path / "out", clip, frames=frames)
    assert names == ["frame_00001.ply", "frame_00002.ply"]


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_cancelling_leaves_nothing(tmp_path, clip, name):
    def stop(stage, done, total):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        write_sequence(tmp_path / name, clip, progress=stop)
    assert not list(tmp_path.iterdir())


def test_refusals(tmp_path, clip):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "frame_0004.ply").touch()
    (tmp_path / "file").touch()
    for place, words in (
        ("full", "not empty"),
        ("missing/out", "cannot be created"),
        ("missing/out.zip", "no file can be written"),
        ("file", "cannot be created"),
    ):
        with pytest.raises(InputError, match=words):
            write_sequence(tmp_path / place, clip)
    for name in ("", "a/b", "../up"):
        with pytest.raises(InputError, match="cannot begin with this text"):
            write_sequence(tmp_path / "out", clip, name=name)
    empty = Clip(
        *(a[:0] for a in (clip.means, clip.quats, clip.scales)),
        clip.opacities,
        clip.sh,
        clip.times[:0],
    )
    with pytest.raises(InputError, match="no frames"):
        write_sequence(tmp_path / "out", empty)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "full"]
    (tmp_path / "empty").mkdir()
    assert len(write_sequence(tmp_path / "empty", clip)) == 3


@pytest.fixture
def pxr():
    return pytest.importorskip("pxr", reason="usd-core is not installed")


def turning(clip, rng) -> Clip:
    """The same clip with harmonics of degree 1 that turn with the material."""
    sh = rng.normal(size=(3, 4, 3)).astype(np.float32)
    return replace(clip, sh=sh, rotations=rng.normal(size=(3, 3, 4)).astype(np.float32))


@pytest.mark.parametrize("ending", ["usdc", "usda", "usd"])
def test_usd_reads_back(pxr, tmp_path, clip, rng, ending):
    from pxr import Usd, UsdGeom, UsdVol

    messages = []
    clip = turning(clip, rng)
    path = tmp_path / f"duck.{ending}"
    write_usd(path, clip, progress=lambda *s: messages.append(s))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert messages == [("export", i, 3) for i in (1, 2, 3)]
    assert path.read_bytes().startswith(b"#usda" if ending == "usda" else b"PXR-USDC")
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetTimeCodesPerSecond() == pytest.approx(24)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, pytest.approx(2))
    splats = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    assert splats.GetPositionsAttr().GetTimeSamples() == pytest.approx([0, 1, 2])
    np.testing.assert_allclose(splats.GetOpacitiesAttr().Get(), clip.opacities)
    assert splats.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 1
    for code, frame in enumerate(clip.frames()):
        g = frame.gaussians
        np.testing.assert_allclose(splats.GetPositionsAttr().Get(code), g.means, atol=1e-6)
        np.testing.assert_allclose(splats.GetScalesAttr().Get(code), g.scales, atol=1e-6)
        for quat, wanted in zip(splats.GetOrientationsAttr().Get(code), g.quats, strict=True):
            np.testing.assert_allclose([quat.real, *quat.imaginary], wanted, atol=1e-6)
        sh = splats.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(code)
        np.testing.assert_allclose(np.reshape(sh, (3, 4, 3)), g.sh, atol=1e-6)
        low, high = splats.GetExtentAttr().Get(code)
        assert (np.array(low) < g.means).all() and (np.array(high) > g.means).all()


def test_usd_keeps_still_colours_once(pxr, tmp_path, clip):
    from pxr import Usd, UsdVol

    write_usd(tmp_path / "a.usdc", clip)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    splats = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    sh = splats.GetRadianceSphericalHarmonicsCoefficientsAttr()
    assert not sh.GetTimeSamples()
    np.testing.assert_allclose(sh.Get(), clip.sh[:, 0])


def test_usd_of_one_frame(pxr, tmp_path, clip):
    write_usd(tmp_path / "a.usdc", Clip.from_frames([clip.frame(1)]))
    assert (tmp_path / "a.usdc").stat().st_size > 100


def test_usd_refusals(pxr, tmp_path, clip):
    with pytest.raises(InputError, match=r"\.usdc, \.usda or \.usd"):
        write_usd(tmp_path / "a.ply", clip)
    with pytest.raises(InputError, match="existing folder"):
        write_usd(tmp_path / "missing" / "a.usdc", clip)

    def stop(stage, done, total):
        raise Cancelled

    with pytest.raises(Cancelled):
        write_usd(tmp_path / "a.usdc", clip, progress=stop)
    assert not list(tmp_path.iterdir())


def test_without_usd_core_it_says_what_to_install(tmp_path, clip, monkeypatch):
    whole = builtins.__import__

    def absent(name, *args, **options):
        if name.startswith("pxr"):
            raise ModuleNotFoundError(name)
        return whole(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(InputError, match=r"pip install .*\[usd\]"):
        write_usd(tmp_path / "a.usdc", clip)


@pytest.mark.parametrize("name", ["report.json", "scene.toml", "front.mp4"])
def test_no_export_replaces_the_files_of_a_run(tmp_path, capsys, name):
    (tmp_path / name).write_text("kept")
    clip, out = str(tmp_path / "clip.safetensors"), str(tmp_path / name)
    assert main(["export", clip, "--to", "ply", "--out", out]) == 2
    assert "end in .ply. Rename it." in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "kept"


def test_no_export_replaces_the_gaussians_of_a_run(tmp_path, capsys, clip):
    clip.save(tmp_path / "clip.safetensors")
    (tmp_path / "report.json").write_text('{"files": ["clip.safetensors", "gaussians.ply"]}')
    path, out = tmp_path / "gaussians.ply", str(tmp_path / "gaussians.ply")
    path.write_text("kept")
    assert main(["export", str(tmp_path / "clip.safetensors"), "--to", "ply", "--out", out]) == 2
    assert "is a result of the run in its folder. Give another" in capsys.readouterr().err
    assert path.read_text() == "kept"
