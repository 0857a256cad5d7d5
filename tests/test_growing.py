"""A clip's file that is written frame by frame is the file that is written at once."""

import errno
import os
from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.io import files
from phy124.io.clip import Clip, stack_arrays
from phy124.io.growing import Growing, Unlike
from support.shapes import ball


def frames(count=3, **more):
    still = ball(40)
    for index in range(count):
        means = still.means + np.float32(index)
        v = np.full((len(still), 3), index, np.float32)
        yield Frame(index, index / 24, replace(still, means=means), v, **more)


def grown(path, count=3, header=500):
    """The file, its frames as they are read from it, and the clip of them."""
    first, *_ = made = list(frames(count))
    growing = Growing.like(path, first, count, rotation=None, header=header)
    read = [growing.put(frame)[0] for frame in made]
    return growing, read, Clip.from_frames(read)


def test_growing_frames_are_stacked_without_a_copy(tmp_path):
    growing, read, clip = grown(tmp_path / "frames")
    for frame, wanted in zip(read, frames(), strict=True):
        assert np.array_equal(frame.gaussians.means, wanted.gaussians.means)
        assert np.shares_memory(frame.gaussians.quats, growing.arrays["quats"])
    assert np.shares_memory(clip.means, growing.arrays["means"])
    assert np.shares_memory(clip.velocities, growing.arrays["velocities"])


def test_growing_file_becomes_the_clip_unchanged(tmp_path):
    growing, _, clip = grown(tmp_path / "frames")
    named = replace(clip, scene={"a": "ü"}, report={"complete": True})
    assert growing.finish(named, tmp_path / "clip.safetensors")
    named.save(tmp_path / "usual.safetensors")
    first, other = (Clip.load(tmp_path / f"{n}.safetensors") for n in ("clip", "usual"))
    for name, array in other.tensors().items():
        assert np.array_equal(first.tensors()[name], array), name
    assert (first.scene, first.report) == (other.scene, other.report)
    with safe_open(tmp_path / "clip.safetensors", "np") as file:
        assert set(file.keys()) == set(other.tensors())
    growing.remove()
    assert not (tmp_path / "frames").exists() and first.means[2, 0, 0] == clip.means[2, 0, 0]


@pytest.mark.parametrize("other", ["shorter", "copied", "long report"])
def test_a_clip_that_is_another_is_not_taken_for_it(tmp_path, other):
    growing, read, clip = grown(tmp_path / "frames")
    changed = {
        "shorter": lambda: Clip.from_frames(read[:2]),
        "copied": lambda: replace(clip, means=clip.means.copy()),
        "long report": lambda: clip.with_report({"text": "a" * 40_000}),
    }[other]()
    assert not growing.finish(changed, tmp_path / "clip.safetensors")
    assert not (tmp_path / "clip.safetensors").exists()


def test_frames_that_differ_in_kind_are_refused(tmp_path):
    growing, read, _ = grown(tmp_path / "frames")
    with pytest.raises(Unlike, match="frame 1 has"):
        growing.put(replace(read[1], velocities=None))
    fewer = Gaussians(
        *(
            getattr(read[1].gaussians, n)[:9]
            for n in ("means", "quats", "scales", "opacities", "sh")
        )
    )
    with pytest.raises(Unlike, match="means of frame 1"):
        growing.put(replace(read[1], gaussians=fewer, velocities=fewer.means))


def test_a_file_in_use_or_cut_short_is_refused(tmp_path):
    growing, *_ = grown(tmp_path / "frames")
    place = growing.place()
    if files.LOCKS_AVAILABLE:
        with pytest.raises(InputError, match="another process is still computing this run"):
            Growing.there(tmp_path, place)
    growing.close()
    again = Growing.there(tmp_path, place)
    assert again.arrays["means"][2, 0, 0] == growing.arrays["means"][2, 0, 0]
    again.close()
    with open(tmp_path / "frames", "r+b") as file:
        file.truncate(1000)
    with pytest.raises(InputError, match="missing or cut short"):
        Growing.there(tmp_path, place)


def test_arrays_that_only_look_consecutive_are_copied():
    rows = [np.ones(3), np.ones(3)]
    assert not any(np.shares_memory(stack_arrays(rows), row) for row in rows)
    whole = np.arange(12.0).reshape(4, 3)
    assert np.array_equal(stack_arrays([whole[0], whole[2]]), whole[[0, 2]])
    assert np.shares_memory(stack_arrays([whole[1], whole[2]]), whole)


def test_a_file_that_has_no_room_does_not_stay(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.EFBIG, "File too large")

    monkeypatch.setattr(os, "ftruncate", refuse)
    with pytest.raises(OSError, match="too large"):
        grown(tmp_path / "frames")
    assert not (tmp_path / "frames").exists()


def test_a_file_that_cannot_be_mapped_is_not_locked(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    growing, *_ = grown(tmp_path / "frames")
    growing.close()
    with monkeypatch.context() as patch, pytest.raises(OSError, match="Cannot allocate"):
        patch.setattr(np, "memmap", refuse)
        Growing.there(tmp_path, growing.place())
    Growing.there(tmp_path, growing.place()).close()
