"""The work behind the page: stages that run only when needed, and stop when asked."""

import gc
import json
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from demo.exports import EXPORTS
from demo.pictures import cut_out
from demo.progress import Done, Glimpse, Live, Reused, Step
from demo.visitors import STAGES
from demo.work import DEVICE, Order, stages_done, steps
from demo.work.limits import Limits, easier
from demo.work.motion import Watching
from phy124.errors import Cancelled, InputError
from phy124.io.clip import Clip
from phy124.mpm import Model
from phy124.mpm.runner import Runner
from phy124.scene import Scene
from phy124.simulation import Setup
from support.orders import small_order
from support.processes import until

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"


@pytest.fixture
def order(tmp_path) -> Order:
    return small_order(tmp_path)


def _run(order: Order) -> tuple[Done, list]:
    events = [event for event in steps(order) if event is not None]
    assert isinstance(events[-1], Done)
    return events[-1], events


def _stages(events) -> set[str]:
    return {event.stage for event in events if isinstance(event, Step)}


def test_a_visitor_sees_that_kernels_are_compiled(order):
    messages = []
    Watching(order, Limits(order, messages.append)).progress("compile", 3, 13)
    assert messages[-1] == Step("simulate", 0, 3, "compiling, 3 of 13")


def test_everything_is_made(order):
    done, events = _run(replace(order, threads=2))
    assert _stages(events) == {"generate", "simulate", "render", "save"}
    assert json.loads((done.clip / "report.json").read_text("utf-8"))["threads"] == 2
    assert sum(isinstance(event, Glimpse) for event in events) == 3
    made = {path.name for path in [*done.clip.iterdir(), *done.films.iterdir()]}
    assert made == {
        "clip.safetensors",
        "gaussians.ply",
        "scene.toml",
        "report.json",
        "front.mp4",
        "clip.pack",
        "orbit.webp",
    }
    assert "scene.toml" in {path.name for path in done.films.iterdir()}
    assert len(Clip.load(done.clip / "clip.safetensors")) == 3
    assert not order.stop.exists()
    until(lambda: not DEVICE.locked())


def test_a_clip_that_is_filmed_again_has_the_view_of_its_videos(order):
    first, _ = _run(order)
    again, _ = _run(replace(order, scene=order.scene.replaced({"view.elevation": 33.0})))
    assert again.clip == first.clip and not (first.films / "clip.safetensors").exists()
    views = [Scene.of_clip(Clip.load(done.viewed_clip).scene).view for done in (first, again)]
    assert views == [first.scene.view, again.scene.view]
    assert views[1].elevation == 33.0


def test_finished_runs_are_freed_at_once(order):
    """Otherwise a page with many runs keeps several solvers until Python looks for cycles."""
    gc.disable()
    try:
        before = [each for each in gc.get_objects() if isinstance(each, Runner | Model | Setup)]
        _run(order)
        after = [each for each in gc.get_objects() if isinstance(each, Runner | Model | Setup)]
    finally:
        gc.enable()
    assert {id(each) for each in after} <= {id(each) for each in before}


def test_promise_is_worded_as_on_the_command_line(order):
    done, _ = _run(order)
    report = json.loads((done.films / "report.json").read_text("utf-8"))
    assert report["promise"]["error"] is None and report["versions"]["phy124"]
    assert len(report["motion"]["min_J"]) == report["frames"] == 3


def test_no_file_of_a_run_says_where_an_upload_lies(order):
    mask = order.folder / "uploads" / "hat.png"
    mask.parent.mkdir(exist_ok=True)
    Image.fromarray(np.tile(np.uint8([[0], [255]]), (32, 64))).save(mask)
    part = {"mask": str(mask), "material": {"law": "neo_hookean", "E": 2e5}}
    done, _ = _run(replace(order, scene=order.scene.replaced({"parts": [part]})))
    for path in [*done.clip.iterdir(), *done.films.iterdir()]:
        assert str(order.folder).encode() not in path.read_bytes(), path.name
    assert Clip.load(done.clip / "clip.safetensors").scene["parts"][0]["mask"] == "hat.png"


def test_the_report_says_how_the_object_was_cut_out(order):
    cut_out(DUCK, order.cutout)
    done, _ = _run(order)
    for folder in (done.clip, done.films):
        cutout = json.loads((folder / "report.json").read_text("utf-8"))["cutout"]
        assert (cutout["method"], cutout["warnings"]) == ("alpha", [])
        assert 0.3 < cutout["coverage"] < 0.6


def test_unchanged_steps_are_not_repeated(order):
    first, _ = _run(order)
    again, events = _run(order)
    assert again == first
    assert events[:-1] == [Reused("generate"), Reused("simulate"), Reused("render")]


def test_another_view_does_not_simulate(order):
    first, _ = _run(order)
    view = {"view.elevation": 40.0, "view.cameras": [{"kind": "dolly"}], "view.outputs": ["depth"]}
    done, events = _run(replace(order, scene=order.scene.replaced(view)))
    made = {path.name for path in done.films.iterdir()}
    assert {"front.mp4", "dolly.mp4"} <= made and not any("outputs" in name for name in made)
    assert done.clip == first.clip and done.films != first.films
    assert _stages(events) == {"render", "save"}


def test_each_result_of_a_clip_has_the_view_of_its_videos(order):
    first, _ = _run(order)
    picture = order.folder / "uploads" / "beach.png"
    Image.new("RGB", (8, 8), "blue").save(picture)
    view = {"view.elevation": 40.0, "view.picture": str(picture)}
    done, _ = _run(replace(order, scene=order.scene.replaced(view)))
    assert done.clip == first.clip and str(order.folder) not in str(done.scene)
    assert (done.view.elevation, done.view.picture) == (40.0, picture)
    assert first.scene == order.scene and first.view == order.scene.view
    players = [each.films / "player.html" for each in (first, done)]
    for each, path in zip((first, done), players, strict=True):
        EXPORTS["html"].write(each, path)
    assert players[0].read_bytes() != players[1].read_bytes()


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
    until(lambda: not DEVICE.locked())
    assert not order.stop.exists()
    assert list((order.folder / "clips").iterdir()) == []


def test_a_closed_generator_ends_the_work(order):
    many = replace(order, scene=order.scene.replaced({"time.frames": 500}))
    events = steps(many)
    next(event for event in events if isinstance(event, Glimpse))
    events.close()
    for thread in threading.enumerate():
        if thread.name == "work":
            thread.join(300)
    until(lambda: not DEVICE.locked())
    assert not order.stop.exists()
    assert list((order.folder / "clips").iterdir()) == [], "it went on to the end"


def test_waiting_for_the_device_can_be_cancelled(order):
    with DEVICE:
        events = steps(order)
        assert next(events) is None
        order.stop.touch()
        with pytest.raises(Cancelled):
            list(events)


def test_when_the_time_is_up_what_is_finished_is_kept(order, monkeypatch):
    monkeypatch.setattr(Limits, "spent", property(lambda limits: 0.9))
    views = replace(order, scene=order.scene.replaced({"view.views": ["front", "back"]}))
    done, _ = _run(views)
    report = json.loads((done.films / "report.json").read_text())
    assert report["frames"] == 1 and not report["complete"]
    assert (
        "only the frames computed until then were kept. Choose draft accuracy" in report["stopped"]
    )
    limit = "The time limit was reached before these videos were made"
    assert f"{limit}: back." in report["notes"]
    assert [path.name for path in done.films.glob("*.mp4")] == ["front.mp4"]


def test_work_that_takes_far_too_long_is_ended(order):
    with pytest.raises(InputError, match=r"far longer than .* Choose draft accuracy"):
        list(steps(replace(order, seconds=0.0)))
    until(lambda: not DEVICE.locked())


def test_a_draft_is_not_advised_to_be_a_draft():
    press = Scene.named("press")
    assert easier(press) == "Choose draft accuracy or a softer material or fewer frames."
    soft = press.replaced({"accuracy": "draft", "material.E": 1e3})
    assert easier(soft) == "Choose fewer frames."
    assert easier(soft.replaced({"time.frames": 4})) == "Choose a gentler motion."


def test_the_viewer_gets_every_frame_while_it_is_computed(order):
    _, events = _run(order)
    files = [event.file for event in events if isinstance(event, Live)]
    assert [Path(file).name for file in files] == ["0000.pack", "0001.pack", "0002.pack"]
    assert all(Path(file).read_bytes()[:2] == b"\x1f\x8b" for file in files)


def test_too_many_particles_are_refused(order):
    with pytest.raises(InputError, match=r"The limit of this page is 10 particles"):
        list(steps(replace(order, max_particles=10)))


def test_a_visitor_who_has_left_leaves_no_folder(order):
    import shutil

    many = replace(order, scene=order.scene.replaced({"time.frames": 500}))
    events = steps(many)
    next(event for event in events if isinstance(event, Glimpse))
    # As when a visitor's folder is being removed; the run itself still has all it needs.
    shutil.rmtree(order.folder / STAGES[0])
    order.stop.touch()
    with pytest.raises(Cancelled):
        list(events)
    end = time.monotonic() + 60
    while order.folder.exists() and time.monotonic() < end:
        time.sleep(0.01)
    assert not order.folder.exists()


def test_motion_is_reported_per_frame(order):
    done, _ = _run(order)
    motion = json.loads((done.films / "report.json").read_text())["motion"]
    assert motion["time"] == pytest.approx([0, 1 / 24, 2 / 24])
    # A ball in free fall: v = g t but for the half substep that velocities are behind.
    assert motion["max_speed"] == pytest.approx([0, 9.81 / 24, 9.81 / 12], abs=0.04)
    assert motion["min_J"] == pytest.approx([1, 1, 1], abs=1e-4)


def test_composed_film_is_made_once_and_nothing_else(order, monkeypatch):
    from phy124.rendering.compose import colours

    monkeypatch.setattr(colours, "ROUNDS", 1)
    photograph = order.folder / "uploads" / "a.png"
    Image.new("RGB", (90, 60), "white").save(photograph)
    with Image.new("RGBA", (90, 60)) as cutout:
        cutout.paste((200, 40, 30, 255), (30, 15, 60, 45))
        cutout.save(order.cutout)
    first, _ = _run(order)
    shown = replace(order, photograph=photograph)
    assert stages_done(order)["composed"] == 0 < stages_done(shown)["composed"]
    done, events = _run(shown)
    assert (done.clip, _stages(events)) == (first.clip, {"render", "save"})
    assert done.films != first.films
    assert (done.films / "composed.mp4").stat().st_size > 1000
    assert any(event.note == "composed" for event in events if isinstance(event, Step))
    report = json.loads((done.films / "report.json").read_text("utf-8"))
    assert {"psnr", "psnr_before"} == set(report["compose"])
    monkeypatch.setattr(Limits, "spent", property(lambda limits: 0.9))
    again, _ = _run(replace(shown, scene=order.scene.replaced({"view.elevation": 40.0})))
    report = json.loads((again.films / "report.json").read_text("utf-8"))
    limit = "The time limit was reached before these videos were made"
    assert f"{limit}: the photograph." in report["notes"]
