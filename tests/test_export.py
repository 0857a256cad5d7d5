"""Exports: what is written reads back, and nothing half-done stays."""

import re
import zipfile

import numpy as np
import pytest

from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.export import write_ply_sequence
from phy124.gaussians import Frame
from phy124.ply import read_ply

SUPERSPLAT = re.compile(r"(.*?)(\d+)(?:\.compressed)?\.ply$")
"""How the SuperSplat editor recognises a sequence: same first group, rising second."""


@pytest.fixture
def clip(three_gaussians) -> Clip:
    frames = [
        Frame(i, i / 24, three_gaussians.moved(1, np.array([0.1 * i, 0, -0.2 * i])))
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
    told = []
    folder = tmp_path / "out"
    names = write_ply_sequence(folder, clip, name="duck", progress=lambda *s: told.append(s))
    assert sorted(p.name for p in folder.iterdir()) == names
    check(names, [folder / n for n in names], clip)
    assert told == [("export", i, 3) for i in (1, 2, 3)]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert b"y down" in (folder / names[0]).read_bytes()[:400]


def test_an_archive(tmp_path, clip):
    path = tmp_path / "duck.ZIP"
    names = write_ply_sequence(path, clip, name="duck")
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == names
        archive.extractall(tmp_path / "unpacked")
    check(names, [tmp_path / "unpacked" / n for n in names], clip)


def test_five_digits_for_ten_thousand_frames(tmp_path, three_gaussians, monkeypatch):
    g = three_gaussians.select(np.array([0]))
    many = Clip.from_frames([Frame(i, i / 24, g) for i in range(10_000)])
    monkeypatch.setattr("phy124.export.write_ply", lambda file, gaussians: None)
    names = write_ply_sequence(tmp_path / "out", many)
    assert names[0] == "frame_00001.ply" and names[-1] == "frame_10000.ply"
    assert names == sorted(names)


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_cancelling_leaves_nothing(tmp_path, clip, name):
    def stop(stage, done, total):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        write_ply_sequence(tmp_path / name, clip, progress=stop)
    assert not list(tmp_path.iterdir())


def test_refusals(tmp_path, clip):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "frame_0004.ply").touch()
    (tmp_path / "file").touch()
    for place, words in (
        ("full", "not empty"),
        ("missing/out", "cannot be made"),
        ("missing/out.zip", "no file can be written"),
        ("file", "cannot be made"),
    ):
        with pytest.raises(InputError, match=words):
            write_ply_sequence(tmp_path / place, clip)
    for name in ("", "a/b", "../up"):
        with pytest.raises(InputError, match="start a file's name"):
            write_ply_sequence(tmp_path / "out", clip, name=name)
    empty = Clip(
        *(a[:0] for a in (clip.means, clip.quats, clip.scales)),
        clip.opacities,
        clip.sh,
        clip.times[:0],
    )
    with pytest.raises(InputError, match="no frames"):
        write_ply_sequence(tmp_path / "out", empty)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "full"]
    (tmp_path / "empty").mkdir()
    assert len(write_ply_sequence(tmp_path / "empty", clip)) == 3
