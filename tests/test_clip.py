import dataclasses
import os

import numpy as np
import pytest
from safetensors.numpy import save_file

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians, rotate_sh
from phy124.io import clip as clip_module
from phy124.io.clip import Clip


@pytest.fixture
def clip(rng, three_gaussians) -> Clip:
    g = three_gaussians
    frames = [
        Frame(i, i / 24, dataclasses.replace(g, means=g.means + i), rng.normal(size=(3, 3)))
        for i in range(4)
    ]
    frames = [dataclasses.replace(f, velocities=f.velocities.astype(np.float32)) for f in frames]
    made = Clip.from_frames(frames)
    return dataclasses.replace(made, scene={"seed": 7}, report={"complete": True, "frames": 4})


def test_round_trip_is_exact(tmp_path, clip):
    clip.save(tmp_path / "a.safetensors")
    loaded = Clip.load(tmp_path / "a.safetensors")
    for name in ("means", "quats", "scales", "opacities", "sh", "times", "velocities"):
        a, b = getattr(clip, name), getattr(loaded, name)
        assert a.dtype == b.dtype
        assert np.array_equal(a, b), name
    assert loaded.rotations is None
    assert loaded.scene == {"seed": 7}
    assert loaded.report == {"complete": True, "frames": 4}


def test_arrays_of_large_files_stay_on_disk(tmp_path, clip, monkeypatch):
    monkeypatch.setattr("phy124.io.clip.SMALL", 0)
    clip.save(tmp_path / "a.safetensors")
    loaded = Clip.load(tmp_path / "a.safetensors")
    assert isinstance(loaded.means, np.memmap)
    assert np.array_equal(loaded.means, clip.means)


def test_small_file_may_be_cut_after_it_was_opened(tmp_path, clip):
    clip.save(tmp_path / "a.safetensors")
    loaded = Clip.load(tmp_path / "a.safetensors")
    os.truncate(tmp_path / "a.safetensors", 0)
    assert np.array_equal(loaded.means, clip.means)


@pytest.mark.parametrize("size", [0, 6, 400, -1])
def test_file_that_is_cut_while_it_is_read_is_refused(tmp_path, clip, size, monkeypatch):
    path = tmp_path / "a.safetensors"
    clip.save(path)
    metadata = clip_module._read_metadata(path)
    monkeypatch.setattr(clip_module, "_read_metadata", lambda path: metadata)
    os.truncate(path, size % path.stat().st_size)
    with pytest.raises(InputError, match="cut short while it was read"):
        Clip.load(path)


def test_frames_give_back_the_gaussians(clip):
    frames = list(clip.frames())
    assert [f.index for f in frames] == [0, 1, 2, 3]
    assert frames[2].time == 2 / 24
    assert np.array_equal(frames[2].gaussians.means, clip.means[2])


def test_a_clip_without_frames_is_refused():
    with pytest.raises(ValueError, match="at least one frame"):
        Clip.from_frames([])


def test_velocities_are_differences_of_neighbouring_frames(clip):
    assert np.array_equal(clip.frame(1, velocities=True).velocities, clip.velocities[1])
    bare = dataclasses.replace(clip, velocities=None)
    assert bare.frame(1).velocities is None
    for frame in bare.frames(velocities=True):  # a metre per frame along each axis
        assert frame.velocities.dtype == np.float32
        assert frame.velocities == pytest.approx(np.full((3, 3), 24.0), rel=1e-5)
    body = Clip.from_frames([bare.frame(0)])
    assert body.frame(0, velocities=True).velocities is None


def test_colours_turn_with_the_material(rng, three_gaussians):
    g = three_gaussians
    sh = rng.normal(size=(3, 4, 3)).astype(np.float32)
    full = Gaussians(g.means, g.quats, g.scales, g.opacities, sh)
    turn = np.tile(np.float32([0.5, 0.5, 0.5, 0.5]), (1, 3, 1))
    clip = Clip.from_frames([Frame(0, 0.0, full)], rotations=turn)
    assert np.array_equal(clip.frame(0).gaussians.sh, rotate_sh(sh, turn[0]))


def test_a_cut_file_is_refused(tmp_path, clip):
    path = tmp_path / "a.safetensors"
    clip.save(path)
    whole = path.read_bytes()
    for size in (0, 4, 100, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(
            InputError, match="it cannot be read; it is cut short or of another kind"
        ):
            Clip.load(path)


def test_a_foreign_file_is_refused(tmp_path):
    path = tmp_path / "a.safetensors"
    save_file({"weights": np.zeros(3, np.float32)}, path)
    with pytest.raises(InputError, match="not a phy124 clip"):
        Clip.load(path)
    path.write_text("hello")
    with pytest.raises(InputError, match="cut short or of another kind"):
        Clip.load(path)


def test_another_version_is_refused(tmp_path, clip):
    path = tmp_path / "a.safetensors"
    metadata = {"format": "phy124-clip", "version": "99", "scene": "{}", "report": "{}"}
    save_file({"times": np.zeros(1)}, path, metadata)
    with pytest.raises(InputError, match="format version is 99, but this program reads 1 and 2"):
        Clip.load(path)


def test_missing_or_unfitting_tensors_are_refused(tmp_path, clip):
    path = tmp_path / "a.safetensors"
    metadata = {"format": "phy124-clip", "version": "1", "scene": "{}", "report": "{}"}
    save_file({"times": np.zeros(1)}, path, metadata)
    with pytest.raises(InputError, match="the tensors means, quats, scales"):
        Clip.load(path)
    names = ("means", "quats", "scales", "opacities", "sh", "times")
    tensors = {name: getattr(clip, name) for name in names}
    save_file({**tensors, "quats": tensors["quats"][:2].copy()}, path, metadata)
    with pytest.raises(InputError, match="the shapes of its tensors are inconsistent"):
        Clip.load(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        Clip.load(tmp_path / "none.safetensors")


def test_equal_clips_are_equal_files(tmp_path, clip):
    for number in range(6):
        clip.with_report({"frames": 3, "said": "Größe \u2028 \t"}).save(tmp_path / f"{number}")
    assert len({(tmp_path / f"{number}").read_bytes() for number in range(6)}) == 1
    assert Clip.load(tmp_path / "0").report["said"] == "Größe \u2028 \t"


def test_a_failed_save_leaves_nothing(tmp_path, clip, monkeypatch):
    def refuse(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="disk full"):
        clip.save(tmp_path / "a.safetensors")
    assert list(tmp_path.iterdir()) == []
