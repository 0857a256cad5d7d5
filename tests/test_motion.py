"""Clips that store the motion of the particles that carry their Gaussians."""

from dataclasses import replace

import numpy as np
import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.budget import cost
from phy124.errors import InputError
from phy124.gaussians import rotation_matrices
from phy124.io.clip import Clip, read_shape, restate
from phy124.motion import recorded
from phy124.motion.packing import STEP_F, STEP_X, hilbert_order
from phy124.simulation import Simulation, prepare
from support.runs import SCENE, TORN, WITH, copied_at
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

ARRAYS = ("means", "quats", "scales")
SCENES = {
    **{name: WITH[name] for name in ("plain", "free solid")},
    "grains": {"material.law": "sand", "boundaries": [{"kind": "ground"}]},
    "torn": TORN,
}


@pytest.fixture(scope="module", params=SCENES)
def simulated(request):
    """The clip of a run."""
    return Simulation(prepare(ball(300), SCENE.replaced(SCENES[request.param]))).run()


@pytest.fixture
def saved(simulated, tmp_path):
    """The clip of a run, and its file."""
    assert simulated.motion is not None
    simulated.save(tmp_path / "clip.safetensors")
    return simulated, tmp_path / "clip.safetensors"


def covariances(quats, scales):
    axes = rotation_matrices(quats) * scales[:, None].astype(float)
    return axes @ axes.transpose(0, 2, 1)


def test_saved_clip_equals_run_within_rounding(saved):
    clip, path = saved
    read = Clip.load(path)
    assert read_shape(path) == clip.means.shape[:2] == read.means.shape[:2]
    for name in ("opacities", "sh", "times"):
        assert np.array_equal(getattr(read, name), getattr(clip, name))
    size = np.ptp(clip.means[0], axis=0).max()
    assert np.abs(np.asarray(read.means) - clip.means).max() < 2 * STEP_X * size
    for index in range(len(clip)):
        ours = covariances(read.quats[index], read.scales[index])
        theirs = covariances(clip.quats[index], clip.scales[index])
        largest = np.abs(theirs).max(axis=(1, 2), keepdims=True)
        assert (np.abs(ours - theirs) / largest).max() < 10 * STEP_F


def test_frames_are_the_same_in_any_order(saved):
    clip, path = saved
    forwards, backwards = Clip.load(path), Clip.load(path)
    last = len(clip) - 1
    after = [backwards.frame(last - index).gaussians for index in range(len(clip))][::-1]
    chosen = np.arange(3, len(clip.opacities), 7)
    for name in ARRAYS:
        whole = np.asarray(getattr(forwards, name))
        assert np.array_equal(whole, np.stack([getattr(frame, name) for frame in after]))
        assert np.array_equal(whole[:, chosen], getattr(Clip.load(path), name)[:, chosen])


def test_read_clip_is_saved_as_it_was(saved, tmp_path):
    clip, path = saved
    read = Clip.load(path)
    read.save(tmp_path / "again")
    assert (tmp_path / "again").read_bytes() == path.read_bytes()
    assert restate(path, clip.with_report({"gaussians": 3}))
    assert Clip.load(path).report == {"gaussians": 3}
    assert np.array_equal(Clip.load(path).means[-1], read.means[-1])


def test_far_motion_of_a_single_carrier_is_saved(tmp_path):
    held = [{"static": True, "gaussians": [1, 300]}]
    scene = SCENE.replaced({"parts": held, "binding": "particles", "boundaries": []})
    clip = Simulation(prepare(ball(300), scene)).run()
    assert clip.motion is not None and len(clip.motion.carriers) == 1
    clip.save(tmp_path / "clip")
    np.testing.assert_allclose(Clip.load(tmp_path / "clip").means[-1], clip.means[-1], atol=1e-6)


def test_damaged_motion_is_refused(saved):
    _, path = saved
    data = bytearray(path.read_bytes())
    for start in range(len(data) // 2, len(data) - 8, 64):
        data[start : start + 8] = bytes(8)
    path.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        np.asarray(Clip.load(path).means)


def test_hilbert_order_visits_neighbours():
    points = np.stack(np.meshgrid(*[np.arange(8.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    order = hilbert_order(points * 1023 / 7)
    assert np.array_equal(np.sort(order), np.arange(512))
    steps = np.abs(np.diff(points[order], axis=0)).sum(axis=1)
    assert steps.mean() < 1.1


def test_export_to_frames_writes_every_value(saved, tmp_path):
    _, path = saved
    main(["export", str(path), "--to", "frames", "--out", str(tmp_path / "all.safetensors")])
    read, whole = Clip.load(path), Clip.load(tmp_path / "all.safetensors")
    assert whole.motion is None and whole.scene == read.scene and whole.report == read.report
    for name in (*ARRAYS, "opacities", "sh", "times"):
        assert np.array_equal(getattr(whole, name), getattr(read, name))


@pytest.mark.parametrize(
    "name",
    [
        "plain",
        pytest.param("free solid", marks=pytest.mark.slow),
        pytest.param("at rest", marks=pytest.mark.slow),
        "torn",
    ],
)
def test_run_without_held_frames_has_the_same_clip(tmp_path, every_frame, monkeypatch, name):
    scene = SCENE.replaced(WITH.get(name, TORN))
    pipeline.simulate(ball(300), scene, tmp_path / "held", films=False)
    monkeypatch.setattr(cost, "HELD", 0)
    copy = copied_at(3, tmp_path / "light", tmp_path / "killed")
    pipeline.simulate(ball(300), scene, tmp_path / "light", films=False, each=copy)
    pipeline.go_on(tmp_path / "killed")
    held, *others = (
        Clip.load(tmp_path / folder / "clip.safetensors") for folder in ("held", "light", "killed")
    )
    for clip in others:
        assert clip.report["shapes"] == held.report["shapes"]
        for array in ARRAYS:
            assert np.array_equal(getattr(held, array), getattr(clip, array))


def test_changed_arrays_are_saved(saved, tmp_path):
    """A clip whose centres were replaced is written with them, not with its old motion."""
    for clip in (saved[0], Clip.load(saved[1])):
        changed = replace(clip, means=np.array(clip.means) + np.float32(1))
        assert changed.motion is None and clip.with_report({}).motion is not None
        changed.save(tmp_path / "changed.safetensors")
        read = Clip.load(tmp_path / "changed.safetensors")
        np.testing.assert_array_equal(read.means, changed.means)


def test_long_clips_keep_few_frames(saved, monkeypatch):
    clip = Clip.load(saved[1])
    carried = getattr(clip.means.recorded, "_recorded", clip.means.recorded)
    monkeypatch.setattr(recorded, "KEPT", recorded.BYTES * carried.count * (len(clip) - 1))
    monkeypatch.setattr(recorded, "NEAR", 2)
    assert len(list(clip.frames())) > 2
    assert list(carried._frames) == [len(clip) - 2, len(clip) - 1]
    begun = replace(clip.motion, times=clip.times[:3])
    for frames, kept in ((0, [0, 1, 2]), (len(clip), [1, 2])):
        growing = recorded.Recorded(begun, frames=frames)
        assert [len(growing.row(index)) for index in range(3)] and list(growing._frames) == kept


@pytest.mark.parametrize("kept", [0, recorded.KEPT])
def test_rows_of_some_gaussians_are_those_of_frames(saved, monkeypatch, kept):
    monkeypatch.setattr(recorded, "KEPT", kept)
    clip, chosen = Clip.load(saved[1]), np.arange(0, 300, 7)
    for read in (clip, replace(clip, means=np.asarray(clip.means))):
        rows = list(read.rows_of(chosen))
        for name, values in zip(ARRAYS, zip(*rows, strict=True), strict=True):
            assert np.array_equal(values, getattr(clip, name)[:, chosen])


def test_each_frame_of_a_short_clip_is_computed_once(saved, monkeypatch):
    clip, advance, computed = Clip.load(saved[1]), recorded.Recorded._advance, []
    monkeypatch.setattr(
        recorded.Recorded, "_advance", lambda self: computed.append(self._next) or advance(self)
    )
    for _ in range(2):
        assert len(list(clip.rows_of(np.arange(9)))) == len(list(clip.frames()))
    assert computed == list(range(len(clip)))
