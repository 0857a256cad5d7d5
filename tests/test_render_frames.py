"""Frames drawn one after the other: in order, on all cores, cancelled and closed without traces."""

import itertools
import threading

import numpy as np
import pytest

from phy124.camera import Camera
from phy124.errors import Cancelled, InputError
from phy124.gaussians import Frame
from phy124.rendering import frames as drawing
from phy124.rendering import render
from phy124.rendering.frames import render_frames
from phy124.rendering.render import Renderer
from support.shapes import splats as cloud


@pytest.fixture(scope="module")
def renderers() -> dict[str, Renderer]:
    return {"simd": Renderer(device="cpu", blend="simd")}


def moving(rng, count=12) -> list[Frame]:
    g = cloud(rng, 500)
    return [Frame(i, i / 24, g.transform(1, np.array([0, 0.03 * i, 0]))) for i in range(count)]


def render_threads() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name.startswith("render")]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_frames_come_in_order_whatever_the_threads(renderers, rng, threads):
    frames, camera, answer = moving(rng), Camera.orbit(0, 0, 1.5, 64), []
    images = render_frames(
        frames,
        camera,
        size=(40, 30),
        device="cpu",
        threads=threads,
        background=(0, 0, 0),
        progress=lambda *step: answer.append(step),
    )
    small = Camera.orbit(0, 0, 1.5, (40, 30))
    for frame, image in zip(frames, images, strict=True):
        single = renderers["simd"](frame.gaussians, small, (0, 0, 0))
        np.testing.assert_array_equal(image, np.rint(single * 255).astype(np.uint8))
    assert answer == [("render", i, 12) for i in range(1, 13)]
    assert not render_threads()


@pytest.mark.parametrize("count", [1, 3, 7])
def test_as_many_frames_at_once_as_there_are_cores(rng, monkeypatch, count):
    monkeypatch.setattr(drawing, "cores", lambda: count)
    made = []

    class Counted(Renderer):
        def __init__(self, **options):
            made.append(self)
            super().__init__(**options)

    monkeypatch.setattr(drawing, "Renderer", Counted)
    images = list(render_frames(moving(rng, 5), Camera.orbit(0, 0, 1.5, 32), device="cpu"))
    assert len(images) == 5 and len(made) == min(count, 5)
    assert not render_threads()


def test_a_camera_for_each_frame(renderers, rng):
    frame = moving(rng, 1)[0]
    cameras = [Camera.orbit(a, 0, 1.5, 32) for a in (0, 90, 180)]
    images = list(render_frames(itertools.repeat(frame), cameras, device="cpu"))
    assert len(images) == 3
    for camera, image in zip(cameras, images, strict=True):
        wanted = render.to_bytes(renderers["simd"](frame.gaussians, camera))
        np.testing.assert_array_equal(image, wanted)


def test_frames_are_rendered_on_demand_until_closed(rng):
    taken = []

    def endless():
        frame = moving(rng, 1)[0]
        for i in itertools.count():
            taken.append(i)
            yield frame

    images = render_frames(endless(), Camera.orbit(0, 0, 1.5, 32), device="cpu", threads=2)
    for _ in range(5):
        next(images)
    assert len(taken) <= 5 + 2 * drawing.LOOK_AHEAD
    images.close()
    assert not render_threads()
    assert len(taken) <= 5 + 2 * drawing.LOOK_AHEAD


def test_cancelling_and_errors_end_the_threads(rng):
    def stop(stage, done, total):
        if done == 3:
            raise Cancelled

    images = render_frames(moving(rng), Camera.orbit(0, 0, 1.5, 32), device="cpu", progress=stop)
    with pytest.raises(Cancelled):
        list(images)
    assert not render_threads()
    with pytest.raises(InputError, match="eye and target"):
        list(render_frames(moving(rng), Camera.orbit(0, 0, 0.0, 32), device="cpu"))
    assert not render_threads()
