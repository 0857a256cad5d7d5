"""phy124.io.formats.losses: notes about Gaussians that a format changes visibly."""

import json
import re

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.gaussians import Frame
from phy124.io.clip import Clip
from phy124.io.formats import FORMATS, read_gaussians, write_gaussians
from phy124.io.formats.losses import describe_losses
from support.shapes import ball


@pytest.mark.parametrize("name", ["splat", "spz", "spz4", "sog", "glb"])
def test_losses_of_small_huge_and_far_objects_are_described(tmp_path, name):
    """SPZ has scales from 0.045 mm to 380 m, and centres in 24 bits."""
    body, path = ball(500), tmp_path / f"a{FORMATS[name].suffix}"
    for size, place in ((1, 0), (2e-3, 0), (1e5, 0), (1, 1e6)):
        g = body.transform(size, np.full(3, place, float))
        chosen = write_gaussians(path, g, name)
        notes = describe_losses(path, g, chosen)
        lossy = name.startswith("spz") and (size, place) in ((2e-3, 0), (1e5, 0), (1, 1e6))
        assert bool(notes) == lossy, (size, place, notes)
        if size == 2e-3:
            read = read_gaussians(path).gaussians.means
            np.testing.assert_allclose(read, g.means, atol=1e-4 * size)


def test_export_and_convert_note_their_losses(tmp_path, capsys):
    small = ball(500).transform(1e-3, np.zeros(3))
    Clip.from_frames([Frame(0, 0.0, small)]).save(tmp_path / "clip.safetensors")
    write_gaussians(tmp_path / "a.ply", small)
    to_spz = ["export", tmp_path / "clip.safetensors", "--to", "spz"]
    for words in (
        to_spz,
        [*to_spz, "--all"],
        [*to_spz, "--all", "--out", tmp_path / "a.zip"],
        ["convert", tmp_path / "a.ply", tmp_path / "a.spz"],
    ):
        assert main([*map(str, words), "--json"]) == 0
        (note,) = json.loads(capsys.readouterr().out)["notes"]
        assert re.search(r"changes the scales of 100 % .* Use the format ply", note)
