"""Comparing clips: known differences are measured, and what is no pair is refused in words."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.errors import InputError
from phy124.gaussians import SH_C0
from phy124.metrics import psnr, ssim
from phy124.metrics.comparison import Pictures, compare
from support.clips import AWAY, flight
from support.videos import read_video


@pytest.fixture(scope="module")
def clip():
    return flight(AWAY[:4])


def test_a_clip_equals_itself(clip):
    result = compare(clip, clip)
    assert result.position_rms == result.position_max == result.colour_rms == 0
    assert (result.frames, result.gaussians) == (4, 500)


def test_grains_are_not_compared(clip):
    """Their number depends on the grid."""
    count = len(clip.opacities)
    every = np.r_[:count, :9]
    arrays = {name: getattr(clip, name)[:, every] for name in ("means", "quats", "scales")}
    arrays |= {name: getattr(clip, name)[every] for name in ("opacities", "sh")}
    grainy = replace(clip, **arrays, report={**clip.report, "grains": 9})
    assert compare(clip, grainy).position_max == compare(grainy, clip).position_max == 0


def test_known_differences_are_measured(clip):
    """One frame 0.1 sizes off, one Gaussian 0.5; red brighter by 0.2 everywhere."""
    means, sh = clip.means.copy(), clip.sh.copy()
    means[2] += np.float32([0, 0, 0.1])
    means[3, 7] += np.float32([0.3, 0.4, 0])
    sh[:, 0, 0] = (0.25 - 0.5) / SH_C0
    grey = replace(clip, sh=sh.copy())
    sh[:, 0, 0] = (0.45 - 0.5) / SH_C0
    size = np.ptp(clip.means[0], axis=0).max()
    result = compare(grey, replace(clip, means=means, sh=sh))
    assert result.worst_frame == 2
    assert result.position_max * size == pytest.approx(0.5, rel=1e-5)
    expected = math.sqrt((500 * 0.1**2 + 0.5**2) / (4 * 500))
    assert result.position_rms * size == pytest.approx(expected, rel=1e-5)
    assert result.colour_max == pytest.approx(0.2, rel=1e-4)
    assert result.colour_rms == pytest.approx(0.2 / math.sqrt(3), rel=1e-4)


def test_pictures_add_up_to_those_of_the_video(rng):
    a = rng.integers(0, 255, (3, 20, 30, 3), dtype=np.uint8)
    b = np.clip(a.astype(int) + rng.integers(-9, 9, a.shape), 0, 255).astype(np.uint8)
    pictures, same = Pictures(), Pictures()
    for first, other in zip(a, b, strict=True):
        pictures.add(first, other)
        same.add(first, first)
    result = pictures.likeness("front")
    assert result.psnr == pytest.approx(psnr(a, b))
    assert result.ssim == pytest.approx(np.mean([ssim(x, y) for x, y in zip(a, b, strict=True)]))
    assert same.likeness("front").psnr is None


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (
            flight(AWAY[:4], count=400),
            "the clips have 500 and 400 Gaussians. Make both clips from one",
        ),
        (
            flight(AWAY[:3]),
            "the clips have 4 and 3 frames. Simulate one of the clips again with --frames 4",
        ),
        (replace(flight(AWAY[:4]), times=np.arange(4) / 30), "up to 0.025 s apart in time"),
        (
            replace(flight(AWAY[:4]), means=flight(AWAY[:4]).means[:, ::-1].copy()),
            "the clips show different objects",
        ),
    ],
)
def test_incomparable_clips_are_refused_with_a_message(clip, other, words):
    with pytest.raises(InputError) as refusal:
        compare(clip, other)
    assert "the clips cannot be compared" in str(refusal.value)
    assert words in str(refusal.value)


def test_the_command_films_both_side_by_side(tmp_path, clip, capsys):
    for name, made in (("a", clip), ("b", flight([(0, 0, 0)] * 4))):
        (tmp_path / name).mkdir()
        made.save(tmp_path / name / "clip.safetensors")
    arguments = ["compare", str(tmp_path / "a"), str(tmp_path / "b" / "clip.safetensors")]
    arguments += ["--views", "front", "--size", "48x32", "--device", "cpu"]
    assert main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (
        json.loads((tmp_path / "a/compare-b/comparison.json").read_text()).items() <= said.items()
    )
    assert [Path(name).name for name in said["files"]] == ["comparison.json", "front.mp4"]
    assert said["position_max"] == pytest.approx(0.6, rel=0.02)
    assert said["views"][0]["view"] == "front" and said["views"][0]["psnr"] < 30
    video = read_video(tmp_path / "a/compare-b/front.mp4")
    assert video.shape == (4, 32, 96, 3)
    left, right = video[0, :, :48].astype(int), video[0, :, 48:].astype(int)
    assert np.abs(left - right).mean() < 2 and np.ptp(left) > 100
    assert np.abs(video[-1, :, 48:].astype(int) - right).mean() < 2
    assert np.abs(video[-1, :, :48].astype(int) - right).mean() > 5
    assert main([*arguments[:2], str(tmp_path / "none")]) == 2
    assert "there is no such file" in capsys.readouterr().err
