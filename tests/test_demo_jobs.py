"""Behind the buttons: pieces of work, whose they are, and cut-outs that hang stop nobody else."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from demo.jobs import Studio
from demo.line import Job, user_message
from demo.pictures import MISSING, Stroke, how_cut, read_place
from demo.room import Room
from demo.settings import Settings
from demo.source import Choice, Cutout
from demo.visitors import UNFINISHED, Visitors
from demo.work import Done, Order
from phy124.errors import InputError
from phy124.imaging import codecs, cutout
from phy124.runtime import isolated
from phy124.scene import Scene
from support.hostile import PHONE, heic_claiming
from support.processes import until

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"


@pytest.fixture
def studio(tmp_path, monkeypatch) -> Studio:
    # A run of another test may still hold the device.
    monkeypatch.setattr("demo.jobs.DEVICE", threading.Lock())
    return Studio(Settings(), Visitors(tmp_path))


@pytest.fixture
def stuck(monkeypatch) -> threading.Event:
    """The next picture's search never ends, those after it are as usual; set once it has begun."""
    begun = threading.Event()
    usual = cutout.METHODS["alpha"]
    first = iter([True])

    def find(picture: Any, deadline: isolated.Deadline) -> Any:
        if next(first, False):
            begun.set()
            return isolated.run(time.sleep, 600, deadline=deadline)
        return usual.find(picture, deadline)

    monkeypatch.setitem(cutout.METHODS, "alpha", cutout.Method(lambda _: True, find))
    return begun


def _sent(studio: Studio, name: str) -> str:
    studio.visitors.get(name)
    return str(studio.visitors.store(name, DUCK.read_bytes(), ".png"))


def _cut(studio: Studio, name: str) -> Job:
    return studio.cut_out(name, _sent(studio, name))


@pytest.mark.parametrize("ending", ["leave", "stop"])
def test_hanging_cutout_blocks_no_one_and_ends_with_its_visitor(studio, stuck, ending):
    assert not studio.busy
    hung = _cut(studio, "a")
    assert stuck.wait(60) and studio.busy
    other = _cut(studio, "b")
    assert other.wait(60) and Path(other.progress.result.path).exists()
    assert studio.busy and studio.visitors.get("a").busy and not studio.visitors.get("b").busy
    if ending == "leave":
        studio.visitors.remove("a")
    else:
        studio.visitors.get("a").stop()
    assert hung.wait(60) and hung.progress.state == "stopped"
    until(lambda: not studio.busy)


def test_a_search_that_hangs_is_refused_when_its_time_is_up(tmp_path, stuck):
    studio = Studio(Settings(max_cut_seconds=0.5), Visitors(tmp_path))
    hung = _cut(studio, "a")
    assert hung.wait(60) and "did not finish within 0.5 s" in hung.progress.message
    until(lambda: not studio.busy)
    assert list(tmp_path.glob("*/cutouts/*")) == []


def test_a_picture_that_was_refused_is_not_generated_from(studio):
    studio.visitors.get("a")
    bad = studio.visitors.store("a", b"this is no picture", ".png")
    with pytest.raises(InputError, match="not a PNG"):
        studio.cut_out("a", str(bad))
    with pytest.raises(InputError, match="no picture yet"):
        studio.run(Choice("a", None, Scene.named("press").data()))


def test_deleted_picture_has_its_own_message(studio):
    gone = Cutout(str(studio.visitors.get("a").folder / "gone.png"), "")
    for name in ("a", "somebody the page has forgotten"):
        with pytest.raises(InputError, match="no longer has your picture"):
            studio.run(Choice(name, gone, Scene.named("press").data()))


@pytest.mark.parametrize("field", ["image", "mesh", "depth"])
def test_messages_name_the_file(field):
    error = InputError(field, "broken.bin", "it cannot be read.", "Give another file.")
    assert user_message(error).startswith("The ")


@pytest.mark.skipif(not codecs.can_read_heic(), reason="the extra heic is not installed")
def test_a_heic_photograph_is_shown_as_browsers_can(studio):
    studio.visitors.get("a")
    job = studio.cut_out("a", str(studio.visitors.store("a", PHONE.read_bytes(), ".heic")))
    assert job.wait(60) and job.progress.state == "done", job.progress.message
    made = job.progress.result
    with Image.open(made.picture) as shown, Image.open(made.path) as cut:
        assert (shown.format, shown.size, cut.size) == ("WEBP", (320, 256), (320, 256))
    assert studio.visitors.find_upload("a", made.picture) == Path(
        made.picture
    )  # the brush names it


def test_a_heic_bomb_is_refused_before_it_waits_for_its_turn(studio):
    studio.visitors.get("a")
    bomb = studio.visitors.store("a", heic_claiming(6000, 5000), ".heic")
    with pytest.raises(InputError, match="more than 25 million pixels"):
        studio.cut_out("a", str(bomb))


@pytest.mark.parametrize("kind", ["file", "other", "device", "folder", "link", "missing", "odd"])
def test_only_pictures_that_a_visitor_has_sent_are_read(studio, tmp_path, kind):
    other = _sent(studio, "b")
    folder = studio.visitors.get("a").folder / "uploads"
    link = folder / "link.png"
    link.symlink_to(DUCK)
    options = {
        "file": DUCK,
        "other": other,
        "device": "/dev/zero",
        "folder": folder,
        "link": link,
        "missing": folder / "none.png",
        "odd": "\0/../..",
    }[kind]
    with pytest.raises(InputError) as refusal:
        studio.cut_out("a", str(options))
    assert (
        str(refusal.value)
        == "picture = unknown: The server does not have this picture. Choose it again."
    )


def test_a_fifo_among_the_uploads_is_not_opened(studio):
    pipe = studio.visitors.get("a").folder / "uploads" / "pipe.png"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="does not have this picture"):
        studio.cut_out("a", str(pipe))


def test_upload_of_a_program_gets_its_owner_on_first_use(studio):
    studio.visitors.get("session a")
    sent = studio.visitors.store(None, DUCK.read_bytes(), ".png")
    job = studio.cut_out("session a", str(sent))
    assert Path(job.subject).parent == studio.visitors.get("session a").folder / "uploads"
    assert not sent.exists()
    with pytest.raises(InputError, match="does not have this picture"):
        studio.cut_out("session b", str(sent))


def test_one_visitor_cannot_fill_the_queue(studio, stuck):
    jobs = [_cut(studio, "a") for _ in range(UNFINISHED - 1)]
    jobs.append(_cut(studio, "a")) if studio.visitors.get("a").busy else None
    unfinished = [job for job in jobs if not job.over]
    while len(unfinished) < UNFINISHED:
        studio.visitors.get("a").remember(Job("run", Path("never")))
        unfinished.append(jobs[0])
    with pytest.raises(InputError, match="You have work waiting"):
        _cut(studio, "a")
    studio.visitors.close()


def test_full_queue_of_runs_still_accepts_cutouts(tmp_path):
    over = threading.Event()

    def hold(_: Order) -> Iterator[None]:
        while not over.wait(0.05):
            yield None

    studio = Studio(Settings(max_queue=1), Visitors(tmp_path), work=hold)
    scene, made = Scene.named("press").data(), {}
    for name in ("a", "b", "c"):
        job = _cut(studio, name)
        assert job.wait(60) and job.progress.state == "done"
        made[name] = job.progress.result
    studio.run(Choice("a", made["a"], scene))
    until(lambda: studio.runs.running == 1)
    studio.run(Choice("b", made["b"], scene))
    with pytest.raises(InputError, match="Too many visitors"):
        studio.run(Choice("c", made["c"], scene))
    assert _cut(studio, "c").wait(60)
    over.set()
    until(lambda: studio.runs.running == 0)
    studio.visitors.close()


def test_a_run_is_done_when_its_room_is_no_longer_promised(tmp_path, monkeypatch):
    done = Done(tmp_path, tmp_path, tmp_path)
    studio = Studio(Settings(), Visitors(tmp_path / "files"))
    monkeypatch.setattr(studio.forecaster, "learn", lambda *_: None)
    monkeypatch.setattr(Done, "report", {})
    usual, over = studio.visitors.writing, []

    @contextmanager
    def writing(*options: Any) -> Iterator[None]:
        with usual(*options):
            yield
        over.append(job.over)

    cut = _cut(studio, "a")
    assert cut.wait(60)
    monkeypatch.setattr(studio, "work", lambda _: iter([done]))
    monkeypatch.setattr(studio.visitors, "writing", writing)
    job = studio.run(Choice("a", cut.progress.result, Scene.named("press").data()))
    assert job.wait(60) and job.progress.result is done
    assert over == [False]
    studio.visitors.close()


def test_doubtful_cutout_warns_once(studio, tmp_path, monkeypatch):
    table = np.zeros((60, 80), np.uint8)
    table[20:] = 255
    way = cutout.Method(lambda _: True, lambda *_: table)
    monkeypatch.setitem(cutout.METHODS, "u2netp", way)
    monkeypatch.setattr(cutout.u2net, "weights_file", lambda: None)
    stripes = np.tile(255 * (np.arange(80) // 20 % 2), (60, 1)).astype(np.uint8)
    Image.fromarray(np.dstack([stripes] * 3)).save(tmp_path / "a.png")
    studio.visitors.get("a")
    sent = str(studio.visitors.store("a", (tmp_path / "a.png").read_bytes(), ".png"))

    def doubts(strokes: tuple[Stroke, ...] = ()) -> tuple[str, dict[str, Any]]:
        job = studio.cut_out("a", sent, strokes)
        assert job.wait(60), job.progress.message
        with Image.open(job.progress.result.path) as written:
            return " ".join(job.progress.result.doubts), how_cut(written) or {}

    answer, how = doubts()
    assert "outline runs where the picture has no edge" in answer
    # The picture itself knows it for the report, whenever it is used.
    assert doubts() == ("", how)
    assert how["method"] == "u2netp" and answer == " ".join([MISSING, *how["warnings"]])
    answer, how = doubts((Stroke(keep=False, width=0.2, points=((0.1, 0.5),)),))
    assert answer == "" and how["method"] == "brush"


def test_click_picks_an_object_that_the_brush_corrects(studio, tmp_path, monkeypatch):
    result = np.zeros((60, 90), np.uint8)
    result[10:50, 5:45] = result[30:50, 60:80] = 255
    way = cutout.Method(lambda _: True, lambda *_: result, "a test")
    monkeypatch.setitem(cutout.METHODS, "u2netp", way)
    monkeypatch.setattr(cutout.u2net, "weights_file", lambda: None)
    Image.fromarray(np.dstack([result // 2 + 60] * 3)).save(tmp_path / "a.png")
    studio.visitors.get("a")
    sent = str(studio.visitors.store("a", (tmp_path / "a.png").read_bytes(), ".png"))

    def made(**how: Any) -> tuple[Any, np.ndarray]:
        job = studio.cut_out("a", sent, **how)
        assert job.wait(60) and job.progress.result, job.progress.message
        return job.progress.result, np.asarray(Image.open(job.progress.result.path))[..., 3] > 127

    assert studio.search_seconds is None
    first, whole = made()
    assert whole[20, 20] and not whole[40, 70]
    assert first.by == "a test" and "has 2 separate objects" in first.doubts[1]
    assert studio.search_seconds is not None
    place = (0.77, 0.67)
    second, other = made(pick=place)
    assert other[40, 70] and not other[20, 20] and second.doubts == () and second.pick == place
    stroke = Stroke(keep=True, width=0.05, points=((0.9, 0.1),))
    third, paint = made(pick=place, strokes=(stroke,))
    assert paint[40, 70] and paint[9, 81] and not paint[20, 20]
    assert third.by == "brush strokes" and third.pick == place
    assert len({first.path, second.path, third.path}) == 3


def test_corrections_keep_the_cutout_that_they_correct(tmp_path):
    room = Room(clips=1)
    studio = Studio(Settings(), Visitors(tmp_path, room))
    first = _cut(studio, "a")
    assert first.wait(60)
    visitor, path = studio.visitors.get("a"), Path(first.progress.result.path)

    def coverage(number: int) -> float:
        stroke = Stroke(keep=False, width=0.02, points=((0.5, 0.1 * number),))
        job = studio.cut_out("a", first.subject, (stroke,))
        assert job.wait(60) and job.progress.result, job.progress.message
        return np.mean(np.asarray(Image.open(job.progress.result.path))[..., 3] > 127)

    whole = coverage(1)
    assert whole > 0.3
    for number in range(2, 6):
        assert coverage(number) == pytest.approx(whole, abs=0.01)
        visitor.trim(room)
    assert path.exists()
    path.unlink()
    assert coverage(6) == pytest.approx(whole, abs=0.01)


@pytest.mark.slow
def test_corrections_fit_into_the_visitors_room(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 255, (100, 100, 4), np.uint8)
    pixels[..., 3] = 0
    pixels[10:90, 10:90, 3] = 255
    Image.fromarray(pixels).save(tmp_path / "a.png")
    studio = Studio(Settings(), Visitors(tmp_path / "files", Room(each=150_000)))
    visitor = studio.visitors.get("a")
    sent = str(studio.visitors.store("a", (tmp_path / "a.png").read_bytes(), ".png"))
    for number in range(8):
        points = tuple((0.2 + 0.01 * n, 0.5) for n in range(number + 1))
        job = studio.cut_out("a", sent, (Stroke(keep=False, width=0.02, points=points),))
        assert job.wait(60) and Path(job.progress.result.path).exists(), job.progress.message
        assert visitor.measure() <= 150_000


@pytest.mark.parametrize("place", [[0.3], [0.3, 1.5], "middle", [float("nan"), 0.5], {"x": 1}])
def test_points_outside_the_picture_are_refused(place):
    assert (
        read_place(None) is None and read_place([]) is None and read_place([0.25, 1]) == (0.25, 1.0)
    )
    with pytest.raises(InputError, match=r"not a point in the picture\. Give two fractions"):
        read_place(place)
