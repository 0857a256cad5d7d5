"""bridge.steering.source: the object of a steered run, from a picture or from a clip."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bridge.options import Options
from bridge.steering.source import SteeredOptions, make_live
from phy124.errors import InputError
from phy124.generators.shapes import ball
from phy124.imaging.cutting import Cutting
from phy124.live import Live, choose
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.clips import random_clip

pytestmark = pytest.mark.usefixtures("coarse_solids")

COARSE = ("accuracy={cells=8}",)
SIZE = 128


def setup_of(source, *changes, **options):
    """Return the prepared simulation of a live run, with the crop and the particles."""
    options = SteeredOptions(set=changes, device="cpu", threads=1, **options)
    live, _ = make_live(source, options, Options(), speed=1.0, velocities=False)
    return live._run.setup


@pytest.fixture
def picture(tmp_path):
    """A disc in the lower right quarter of a picture."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    disc = (x - 0.75) ** 2 + (y - 0.75) ** 2 < 0.2**2
    rgba = np.full((SIZE, SIZE, 4), (200, 120, 60, 0), np.uint8)
    rgba[..., 3] = 255 * disc
    Image.fromarray(rgba).save(tmp_path / "disc.png")
    return tmp_path / "disc.png"


@pytest.fixture
def part(tmp_path):
    """The left half of the disc as a part of another material."""
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[:, : 3 * SIZE // 4] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    return f'parts=[{{mask="{tmp_path / "mask.png"}", material={{law="neo_hookean", E=1e4}}}}]'


def test_masks_of_parts_are_where_they_were_painted(picture, part, tmp_path, monkeypatch):
    from_picture = setup_of(picture, *COARSE, "binding=particles", part, scene="drop")
    assert np.mean(from_picture.particles.material == 1) == pytest.approx(0.5, abs=0.05)
    scene = Scene.named("drop").replaced({"accuracy": {"cells": 8}, "time.frames": 1})
    setup = prepare(ball(400), scene, RunContext(threads=1), crop=from_picture.crop)
    Simulation(setup).run().save(tmp_path / "clip.safetensors")
    monkeypatch.setattr(choose, "CELLS", (8,))
    monkeypatch.setattr(choose, "TRIED", 8)
    crops = []
    monkeypatch.setattr(
        choose, "Live", lambda *of, **to: crops.append(to["crop"]) or Live(*of, **to)
    )
    from_clip = setup_of(tmp_path / "clip.safetensors", "binding=particles", part)
    assert crops == [from_clip.crop] == [from_picture.crop]


def test_grains_of_a_clip_are_no_part_of_its_object(tmp_path):
    scene = Scene.named("sand").replaced({"accuracy": {"cells": 8}, "time.frames": 1})
    clip = Simulation(prepare(ball(400), scene, RunContext(threads=1))).run()
    clip.save(tmp_path / "clip.safetensors")
    assert clip.report["grains"] > 0
    assert len(setup_of(tmp_path / "clip.safetensors", *COARSE).gaussians) == 400


REFUSED = {
    "max_error": ({"max_error": 0.1}, "already chosen by --set"),
    "more": ({"more": (Path("other.png"),)}, "a clip already contains its objects"),
    "generator": ({"generator": "lgm"}, "start from the picture"),
    "pick": ({"cutting": Cutting(pick="0.5,0.5")}, "Remove this option"),
    "mask": ({"cutting": Cutting(mask=Path("mask.png"))}, "Remove this option"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_options_without_effect_are_refused(tmp_path, name):
    options, sentence = REFUSED[name]
    random_clip(frames=1).save(tmp_path / "clip.safetensors")
    with pytest.raises(InputError, match=rf"^{name} = .*{sentence}"):
        setup_of(tmp_path / "clip.safetensors", *COARSE, **options)
