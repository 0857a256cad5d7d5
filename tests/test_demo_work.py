"""The work behind the page: stages that run only when needed, and stop when asked."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from demo.visitors import Visitor
from demo.work import DEVICE, Done, Glimpse, Order, Reused, Step, steps
from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.gaussians import Gaussians
from phy124.ply import write_ply
from phy124.scene import Scene

FEW = {"accuracy": {"cells": 8, "ppc": 1.0}, "time.frames": 3, "view.size": 48}


@pytest.fixture
def order(tmp_path, rng) -> Order:
    """A small ball instead of a generator's work."""
    away = rng.normal(size=(400, 3))
    means = 0.5 * away / np.linalg.norm(away, axis=1, keepdims=True)
    quats, scales = np.tile([1.0, 0, 0, 0], (400, 1)), np.full((400, 3), 0.06)
    ball = Gaussians.from_rgb(means, quats, scales, np.full(400, 0.9), rng.random((400, 3)))
    write_ply(tmp_path / "ball.ply", ball)
    visitor = Visitor(tmp_path / "visitor")
    cutout = visitor.folder / "cutouts" / "a.png"
    Image.new("RGBA", (8, 8), "red").save(cutout)
    scene = Scene.named("drop").replaced({**FEW, "view.views": ["front"]})
    return Order(
        visitor.folder, cutout, scene, visitor.begin(), 60, 10**6,
        generator=str(tmp_path / "ball.ply"), device="cpu",
    )  # fmt: skip


def _run(order: Order) -> tuple[Done, list]:
    events = [event for event in steps(order) if event is not None]
    assert isinstance(events[-1], Done)
    return events[-1], events


def _stages(events) -> set[str]:
    return {event.stage for event in events if isinstance(event, Step)}


def test_everything_is_made(order):
    done, events = _run(order)
    assert _stages(events) == {"generate", "simulate", "render", "save"}
    assert sum(isinstance(event, Glimpse) for event in events) == 3
    made = {path.name for path in [*done.clip.iterdir(), *done.films.iterdir()]}
    assert made == {
        "clip.safetensors", "gaussians.ply", "scene.toml", "report.json",
        "front.mp4", "clip.pack", "orbit.webp",
    }  # fmt: skip
    assert len(Clip.load(done.clip / "clip.safetensors")) == 3
    assert not order.stop.exists() and not DEVICE.locked()


def test_what_has_not_changed_is_not_done_again(order):
    first, _ = _run(order)
    again, events = _run(order)
    assert again == first
    assert events[:-1] == [Reused("generate"), Reused("simulate"), Reused("render")]


def test_another_view_does_not_simulate(order):
    first, _ = _run(order)
    other = replace(order, scene=order.scene.replaced({"view.elevation": 40.0}))
    done, events = _run(other)
    assert done.clip == first.clip and done.films != first.films
    assert _stages(events) == {"render", "save"}


def test_other_physics_do_not_generate(order):
    first, _ = _run(order)
    softer = replace(order, scene=order.scene.replaced({"material.E": 1e4}))
    done, events = _run(softer)
    assert done.clip != first.clip
    assert Reused("generate") in events
    assert _stages(events) == {"simulate", "render", "save"}


def test_the_stop_file_ends_the_work_and_frees_the_device(order):
    many = replace(order, scene=order.scene.replaced({"time.frames": 500}))
    events = steps(many)
    for event in events:
        if isinstance(event, Glimpse):
            order.stop.touch()
            break
    with pytest.raises(Cancelled):
        list(events)
    assert not DEVICE.locked() and not order.stop.exists()
    assert list((order.folder / "clips").iterdir()) == []


def test_a_closed_generator_ends_the_work(order):
    many = replace(order, scene=order.scene.replaced({"time.frames": 500}))
    events = steps(many)
    next(event for event in events if isinstance(event, Glimpse))
    events.close()
    for thread in threading.enumerate():
        if thread.name == "work":
            thread.join(10)
    assert not DEVICE.locked() and not order.stop.exists()
    assert list((order.folder / "clips").iterdir()) == [], "it went on to the end"


def test_waiting_for_the_device_can_be_cancelled(order):
    with DEVICE:
        events = steps(order)
        assert next(events) is None
        order.stop.touch()
        with pytest.raises(Cancelled):
            list(events)


def test_work_that_takes_too_long_is_ended(order):
    with pytest.raises(InputError, match=r"took longer than .* Choose draft accuracy"):
        list(steps(replace(order, seconds=0.0)))
    assert not DEVICE.locked()


def test_too_many_particles_are_refused(order):
    with pytest.raises(InputError, match=r"one run may have 10 here"):
        list(steps(replace(order, max_particles=10)))


def test_a_visitor_who_has_left_leaves_no_folder(order):
    import shutil

    many = replace(order, scene=order.scene.replaced({"time.frames": 500}))
    events = steps(many)
    next(event for event in events if isinstance(event, Glimpse))
    for stage in order.folder.iterdir():
        shutil.rmtree(stage)
    order.stop.touch()
    with pytest.raises(Cancelled):
        list(events)
    end = time.monotonic() + 5
    while order.folder.exists() and time.monotonic() < end:
        time.sleep(0.01)
    assert not order.folder.exists()


def test_motion_is_reported_per_frame(order):
    import json

    done, _ = _run(order)
    motion = json.loads((done.films / "report.json").read_text())["motion"]
    assert motion["time"] == pytest.approx([0, 0.05, 0.1])
    # A ball in free fall: v = g t but for the half substep that velocities are behind.
    assert motion["greatest_speed"] == pytest.approx([0, 9.81 * 0.05, 9.81 * 0.1], abs=0.04)
    assert motion["smallest_J"] == pytest.approx([1, 1, 1], abs=1e-4)
