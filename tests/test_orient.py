"""`phy124 orient`: the sheet of the ways up of a file."""

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.commands.orient import SIZE
from phy124.gaussians import Gaussians
from phy124.io.axes import FRONTS
from phy124.io.ply import write_ply
from phy124.rendering.orienting import candidates


@pytest.fixture
def file(tmp_path):
    """A red pole, upright in our world, with a blue end at the top."""
    z = np.linspace(-0.5, 0.5, 60)
    means = np.stack([0 * z, 0 * z, z], axis=1)
    colours = np.where(z[:, None] > 0.3, [0.0, 0, 1], [1.0, 0, 0])
    quats = np.tile([1.0, 0, 0, 0], (60, 1))
    pole = Gaussians.from_rgb(means, quats, np.full((60, 3), 0.03), np.full(60, 0.99), colours)
    write_ply(tmp_path / "pole.ply", pole)
    return tmp_path / "pole.ply"


def blue(tile: np.ndarray) -> np.ndarray:
    """Middle of what is blue [row, column], from -1 to 1."""
    tile = tile.astype(int)
    at = np.argwhere((tile[..., 2] > 120) & (tile[..., 0] < 100))
    return at.mean(axis=0) / SIZE * 2 - 1


def test_only_the_right_up_axis_has_blue_on_top(file, tmp_path, capsys):
    out = tmp_path / "sheet.png"
    assert main(["orient", str(file), "--out", str(out), "--device", "cpu"]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    sheet = np.asarray(Image.open(out))
    assert sheet.shape == (2 * SIZE, 3 * SIZE, 3)
    tiles = [t for row in np.split(sheet, 2) for t in np.split(row, 3, axis=1)]
    heights = {r.up: blue(tile)[0] for r, tile in zip(candidates(None), tiles, strict=True)}
    assert heights["-y"] < -0.3 and heights["y"] > 0.3
    assert all(abs(heights[axis]) < 0.45 for axis in ("x", "-x", "z", "-z"))


def test_fronts_are_drawn_for_a_known_up_direction(file, tmp_path):
    out = tmp_path / "sheet.png"
    assert main(["orient", str(file), "--up=-y", "--out", str(out), "--device", "cpu"]) == 0
    assert np.asarray(Image.open(out)).shape == (2 * SIZE, 2 * SIZE, 3)
    assert {reading.front for reading in candidates("-y")} == {"x", "-x", "z", "-z"}
    assert {reading.up for reading in candidates(None)} == set(FRONTS)


@pytest.mark.parametrize(
    ("options", "limit"),
    [(["--up", "w"], "It is not an axis"), (["--out", "a.jpg"], "Only a PNG file can be written")],
)
def test_refusals(file, capsys, options, limit):
    assert main(["orient", str(file), *options]) == 2
    assert limit in capsys.readouterr().err


def test_a_file_of_one_point_is_named_in_the_refusal(tmp_path, capsys):
    point = Gaussians.from_rgb(
        np.zeros((1, 3)), np.eye(4)[:1], np.full((1, 3), 0.1), np.ones(1), np.ones((1, 3))
    )
    write_ply(tmp_path / "point.ply", point)
    assert main(["orient", str(tmp_path / "point.ply"), "--device", "cpu"]) == 2
    assert (
        f"file = {tmp_path / 'point.ply'}: Nearly all of its opacity is at a single point"
        in capsys.readouterr().err
    )


def test_sheet_does_not_replace_the_file_that_is_read(file, capsys):
    named = file.rename(file.with_suffix(".png"))
    before = named.read_bytes()
    assert main(["orient", str(named), "--out", str(named), "--device", "cpu"]) == 2
    assert "It is the name of a file that this command reads" in capsys.readouterr().err
    assert named.read_bytes() == before
