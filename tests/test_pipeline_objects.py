"""Further objects of a scene that are made from files; tests/test_objects_scene.py has the rest."""

from dataclasses import replace

import numpy as np
import pytest

from phy124 import pipeline
from phy124.errors import InputError
from phy124.io.ply import write_ply
from phy124.scene import Scene
from support.clips import random_clip
from support.shapes import ball


def test_an_object_is_that_of_a_clip(tmp_path):
    clip, path = random_clip(count=300), tmp_path / "fell.safetensors"
    clip.save(path)
    write_ply(tmp_path / "first.ply", ball(200))
    first, waiting = tmp_path / "first.ply", {"name": "second", "place": [0, 2]}
    for given, more in (({**waiting, "file": str(path)}, []), (waiting, [path])):
        made = pipeline.static(
            [first, *more], Scene.from_data({"objects": [given]}), generator=str(first)
        )
        second = made.gaussians.of_object(1)
        assert np.array_equal(second.means, clip.frame(0).gaussians.means)
        assert made.about["sources"]["second"] == {"source": path.name, "generator": "clip"}
    replace(clip, object_id=np.repeat([0, 1], 150).astype(np.int32)).save(path)
    with pytest.raises(InputError, match=r"objects.0 \(second\).*clip of several objects"):
        pipeline.static(
            [first, path], Scene.from_data({"objects": [waiting]}), generator=str(first)
        )
