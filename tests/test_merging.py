"""Merging: fewer Gaussians with the same mass, middle and colour."""

import json
from dataclasses import replace

import numpy as np
import pytest

from phy124.commands.convert import Convert, Export
from phy124.errors import InputError
from phy124.gaussians import Gaussians, as_objects
from phy124.io.clip import Clip
from phy124.io.formats import read_gaussians, write_gaussians
from phy124.particles.merging import group_neighbours, merge_clip_to, merge_groups, merge_to
from support.shapes import ball, splats


def mass(gaussians: Gaussians) -> np.ndarray:
    return gaussians.opacities * gaussians.scales.astype(np.float64).prod(axis=1)


def moving(gaussians: Gaussians, frames: int = 3) -> Clip:
    """The upper half goes up by 1 m per frame."""
    way = np.arange(frames)[:, None, None] * (gaussians.means[:, 2:] > 0) * [[0, 0, 1.0]]
    n = len(gaussians)
    return Clip(
        (gaussians.means + way).astype(np.float32),
        np.broadcast_to(gaussians.quats, (frames, n, 4)),
        np.broadcast_to(gaussians.scales, (frames, n, 3)),
        gaussians.opacities,
        gaussians.sh,
        np.arange(frames) / 24.0,
    )


@pytest.mark.parametrize("count", [1, 50, 199, 599])
def test_mass_middle_and_colour_are_kept(count):
    body = splats(np.random.default_rng(0))
    less = merge_to(body, count)
    assert len(less) == count
    assert less.opacities.max() <= 1
    before, after = mass(body), mass(less)
    assert after.sum() == pytest.approx(before.sum(), rel=1e-4)
    for name in ("means", "sh"):
        expected, made = (getattr(g, name).reshape(len(g), -1) for g in (body, less))
        np.testing.assert_allclose(
            after @ made / after.sum(), before @ expected / before.sum(), atol=1e-4
        )


def test_two_become_one_with_the_covariance_of_both():
    pair = Gaussians.from_rgb(
        np.array([[0, 0, 0], [0.2, 0, 0]]),
        np.tile([1.0, 0, 0, 0], (2, 1)),
        np.full((2, 3), 0.1),
        np.full(2, 0.3),
        np.array([[1.0, 0, 0], [0, 0, 1.0]]),
    )
    first = merge_groups(pair, np.zeros(2, int))
    np.testing.assert_allclose(first.covariances()[0], np.diag([0.02, 0.01, 0.01]), rtol=1e-5)
    np.testing.assert_allclose(first.rgb[0], [0.5, 0, 0.5], atol=1e-6)
    assert first.opacities[0] == pytest.approx(0.6 / np.sqrt(2))


def test_lone_gaussians_stay_unmerged():
    body = ball(300)
    assert merge_to(body, 300) is body
    less = merge_to(body, 299)
    same = (less.means[:, None] == body.means[None]).all(axis=2)
    assert same.any(axis=1).sum() == 298
    at = same.argmax(axis=1)[same.any(axis=1)]
    assert np.array_equal(less.scales[same.any(axis=1)], body.scales[at])


def test_neighbours_are_joined():
    line = np.array([[0.0], [0.1], [5.0], [5.1], [9.0]])
    group = group_neighbours(line, 3)
    assert group[0] == group[1] != group[2] == group[3] != group[4]
    assert len(np.unique(group_neighbours(np.zeros((7, 2)), 1))) == 1


def test_in_a_clip_those_are_joined_that_stay_together():
    clip = moving(ball(400))
    less = merge_clip_to(clip, 100)
    assert less.means.shape == (3, 100, 3) and less.report["gaussians"] == 100
    lower = less.means[0, :, 2] < 0
    gone = np.linalg.norm(less.means[-1] - less.means[0], axis=1)
    whole = (gone < 1e-5) | (np.abs(gone - 2) < 1e-5)
    assert whole.all() and (gone[lower] < 1).mean() > 0.9
    for frame in (0, 2):
        after = mass(less.frame(frame).gaussians).sum()
        assert after == pytest.approx(mass(clip.frame(frame).gaussians).sum(), rel=1e-4)
    assert merge_clip_to(clip, 400) is clip


@pytest.mark.parametrize("count", [2, 100])
def test_gaussians_of_different_objects_are_not_merged(count):
    places = {0: ball(200), 7: ball(3).transform(1, np.array([0.1, 0, 0]))}
    black, white = (
        replace(item, sh=np.full_like(item.sh, value))
        for item, value in zip(places.values(), (-1, 1), strict=True)
    )
    both = as_objects({0: black, 7: white})
    less = merge_to(both, count)
    assert len(less) == count and set(less.object_id) == {0, 7}
    np.testing.assert_allclose(less.sh[:, 0, 0], np.where(less.object_id == 7, 1, -1))
    clip = replace(moving(both), object_id=both.object_id)
    frame = merge_clip_to(clip, count).frame(2).gaussians
    np.testing.assert_allclose(frame.sh[:, 0, 0], np.where(frame.object_id == 7, 1, -1))
    with pytest.raises(InputError, match=r"Choose at least 2\."):
        merge_to(both, 1)


def test_commands_merge(tmp_path, capsys):
    body = ball(200)
    write_gaussians(tmp_path / "a.ply", body, "ply")
    Convert(tmp_path / "a.ply", tmp_path / "b.ply", merge=50, json=True).run()
    assert json.loads(capsys.readouterr().out)["gaussians"] == 50
    assert len(read_gaussians(tmp_path / "b.ply").gaussians) == 50
    moving(body).save(tmp_path / "clip.safetensors")
    Export(tmp_path / "clip.safetensors", "ply", merge=60, json=True).run()
    assert json.loads(capsys.readouterr().out)["gaussians"] == 60
    with pytest.raises(InputError, match="merge = 0"):
        Convert(tmp_path / "a.ply", tmp_path / "c.ply", merge=0).run()
    assert not (tmp_path / "c.ply").exists()
