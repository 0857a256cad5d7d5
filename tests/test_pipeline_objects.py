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


def test_a_file_of_more_objects_than_the_scene_has_is_refused(tmp_path):
    path = tmp_path / "several.ply"
    write_ply(path, replace(ball(300), object_id=np.arange(300, dtype=np.int32) % 3))
    scene = Scene.from_data({"objects": [{"name": "second", "place": [0, 2]}]})
    with pytest.raises(InputError, match="are of 3 objects, the scene has 2"):
        pipeline.static(path, scene, generator=str(path))


def test_notes_of_every_file_come_into_the_report(tmp_path):
    for name in ("first", "second"):
        write_ply(tmp_path / f"{name}.ply", ball(300))
        data = (tmp_path / f"{name}.ply").read_bytes()
        data = data.replace(b"property float nx", b"property float " + name.encode())
        (tmp_path / f"{name}.ply").write_bytes(data)
    first, second = tmp_path / "first.ply", tmp_path / "second.ply"
    scene = Scene.from_data(
        {
            "time": {"frames": 1},
            "accuracy": {"cells": 8},
            "objects": [{"name": "other", "place": [0, 2]}],
        }
    )
    made = pipeline.static([first, second], scene, generator=str(first))
    report = pipeline.simulate(
        made.gaussians, made.scene, tmp_path / "out", about=made.about, films=False
    ).report
    assert report["notes"][:2] == [
        "Columns that are not known are passed over: first.",
        "other: Columns that are not known are passed over: second.",
    ]
