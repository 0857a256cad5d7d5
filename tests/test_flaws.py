"""phy124.io.flaws: files of clips in which some Gaussians have NaN or infinite values."""

import json
from dataclasses import replace

import numpy as np
import pytest

import phy124
from phy124.__main__ import main
from phy124.camera import Camera
from phy124.io.flaws import describe_flaws, hide_flaws
from phy124.io.formats import read_gaussians, written_formats
from phy124.scene import View
from support.clips import flight

BAD = 7
"""Index of the Gaussian that is not finite in frame 1."""


def flawed(name, value, frames=1):
    clip = flight(np.linspace([0, 0, 0], [1, 0, 0], 3), count=300)
    values = np.array(getattr(clip, name))
    values[frames, BAD, 0] = value
    return replace(clip, **{name: values})


@pytest.mark.parametrize(
    ("name", "value"), [("means", np.nan), pytest.param("scales", np.inf, marks=pytest.mark.slow)]
)
def test_every_format_hides_a_gaussian_that_is_not_finite(tmp_path, capsys, name, value):
    clip = flawed(name, value)
    clip.save(tmp_path / "clip.safetensors")
    for to, chosen in written_formats().items():
        if not chosen.installed:
            continue
        out = tmp_path / f"{to}{chosen.suffix}"
        frame = [] if chosen.write_clip else ["--frame", "1"]
        words = ["export", tmp_path / "clip.safetensors", "--to", to, "--out", out, *frame]
        assert main([*map(str, words), "--json"]) == 0, to
        notes = json.loads(capsys.readouterr().out)["notes"]
        assert notes[0].startswith("1 of 300 Gaussians have NaN or infinite values in frame 1")
        if chosen.read and not to.startswith("mesh"):
            read = read_gaussians(out).gaussians
            assert len(read) == 300, to
            assert np.flatnonzero(read.opacities < 0.01).tolist() == [BAD], to


def test_functions_hide_a_gaussian_that_is_not_finite(tmp_path):
    clip = flawed("means", np.nan)
    phy124.write_gaussians(tmp_path / "a.spz", clip.frame(1).gaussians)
    assert read_gaussians(tmp_path / "a.spz").gaussians.opacities[BAD] < 0.01
    phy124.write_html(tmp_path / "a.html", clip, Camera.orbit(0, 10, 4, 64))
    view = View(formats=("html", "ply", "usd") if written_formats()["usd"].installed else ("ply",))
    phy124.film(clip, view, tmp_path)
    for name in ("frame_0001.ply", "frame_0002.ply"):
        assert read_gaussians(tmp_path / "clip-ply" / name).gaussians.opacities[BAD] < 0.01


def test_a_clip_without_finite_gaussians_is_refused(tmp_path, capsys):
    clip = flawed("means", np.nan, slice(1, 3))
    means = clip.means.copy()
    means[2] = np.nan
    replace(clip, means=means).save(tmp_path / "clip.safetensors")
    words = ["export", str(tmp_path / "clip.safetensors"), "--to", "ply"]
    assert main([*words, "--all"]) == 2
    assert "frames = 1 to 2: every Gaussian has NaN or infinite values" in capsys.readouterr().err
    assert main([*words, "--frame", "0"]) == 0


def test_hidden_gaussians_follow_their_neighbours():
    clip, notes = hide_flaws(flawed("means", np.nan, slice(0, 2)))
    assert "frames 0 to 1" in notes[0] and not describe_flaws(clip) and clip.opacities[BAD] == 0
    np.testing.assert_array_equal(clip.means[:, BAD], clip.means[:, BAD + 1])
    assert hide_flaws(clip)[0] is clip
