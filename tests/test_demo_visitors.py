"""Visitors' folders: keys by content, grace, clean-up by silence, number and size."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from demo.line import Job
from demo.visitors import ARRIVED, Room, Visitor, Visitors, key
from phy124.errors import InputError


@pytest.fixture
def visitors(tmp_path) -> Visitors:
    return Visitors(tmp_path)


def _folders(root: Path) -> set[str]:
    return {path.name for path in root.iterdir()} - {"arrivals"}


def _with_result(visitor: Visitor) -> Visitor:
    (visitor.folder / "clips" / "x").mkdir()
    return visitor


def test_keys_depend_on_every_part_and_on_nothing_else():
    assert key("a", {"x": 1, "y": 2}) == key("a", {"y": 2, "x": 1})
    assert len({key("a", "b"), key("ab"), key("b", "a"), key("a", b"b"), key("a", ["b"])}) == 5


def test_folders_cannot_be_guessed_and_are_kept_apart(visitors):
    one, two = visitors.get("a"), visitors.get("b")
    assert one is visitors.get("a")
    assert one.folder != two.folder and one.folder.name != "a"
    assert len(one.folder.name) >= 32


def test_removing_a_visitor_removes_pictures_and_results(visitors, tmp_path):
    _with_result(visitors.get("a"))
    visitors.store("a", b"a photograph", ".png")
    visitors.remove("a")
    assert _folders(tmp_path) == set() and len(visitors) == 0
    visitors.remove("a")


def test_removing_while_work_goes_on_asks_it_to_stop_and_leaves_nothing(visitors, tmp_path):
    visitor = visitors.get("a")
    job = Job("run", visitor.new_stop_file())
    job.progress.begin()
    visitor.remember(job)
    visitors.remove("a")
    assert job.stop.exists() and not (visitor.folder / "uploads").exists()
    visitors.sweep()
    assert job.stop.exists(), "the work has not seen it yet"
    job.end("stopped")
    visitors.sweep()
    assert _folders(tmp_path) == set()


def test_silence_is_forgiven_for_a_time_of_grace(tmp_path):
    visitors = Visitors(tmp_path, Room(grace=900))
    visitor = _with_result(visitors.get("a"))
    visitor.seen -= 890
    visitors.sweep()
    assert visitors.known("a") is visitor and visitor.silence < 1, "a look is a sign of life"
    visitor.seen -= 910
    visitors.sweep()
    assert visitors.known("a") is None and _folders(tmp_path) == set()


def test_asking_for_a_job_is_a_sign_of_life(visitors):
    visitor, job = visitors.get("a"), Job("run", Path("stop"))
    visitor.remember(job)
    visitor.seen -= 500
    assert visitors.job(job.name) is job and visitor.silence < 1
    assert visitors.job("unknown") is None


def test_newcomers_do_not_push_out_results_of_an_open_page(tmp_path):
    visitors = Visitors(tmp_path, Room(visitors=3))
    kept = [_with_result(visitors.get(name)) for name in "ab"]
    for number in range(50):
        visitors.get(f"new {number}").seen -= 10
    assert [visitors.known(name) for name in "ab"] == kept and len(visitors) == 3


def test_newcomers_are_refused_in_words_while_everybody_is_there(tmp_path):
    visitors = Visitors(tmp_path, Room(visitors=2))
    for name in "ab":
        _with_result(visitors.get(name))
    with pytest.raises(InputError, match=r"Too many visitors .* Try again in a few minutes"):
        visitors.get("c")
    visitors.get("a").seen -= 200
    assert visitors.get("c") and visitors.known("a") is None


def test_uploads_count_towards_a_visitor_and_all(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=2000))
    visitors.store("a", bytes(900), ".png")
    with pytest.raises(InputError, match="room here"):
        visitors.store("a", bytes(900), ".png")
    visitors.store("b", bytes(900), ".png")
    for name in ("c", None):
        with pytest.raises(InputError, match="Too many visitors"):
            visitors.store(name, bytes(900), ".png")


def test_uploads_that_nobody_claims_go(visitors):
    path = visitors.store(None, b"a photograph", ".png")
    visitors.sweep()
    assert path.exists()
    os.utime(path, (path.stat().st_mtime - ARRIVED - 1,) * 2)
    visitors.sweep()
    assert not path.exists()


def test_only_the_newest_results_are_kept(visitors):
    visitor = visitors.get("a")
    for age in range(5):
        folder = visitor.folder / "clips" / str(age)
        folder.mkdir()
        os.utime(folder, (1000 - age, 1000 - age))
    visitor.trim(Room(clips=2))
    assert sorted(path.name for path in (visitor.folder / "clips").iterdir()) == ["0", "1"]


def test_the_newest_result_stays_however_large(visitors):
    visitor = visitors.get("a")
    for age in range(3):
        path = visitor.folder / "clips" / str(age)
        path.write_bytes(bytes(1000))
        os.utime(path, (1000 - age, 1000 - age))
    visitor.trim(Room(each=500))
    assert [path.name for path in (visitor.folder / "clips").iterdir()] == ["0"]


def test_only_a_few_jobs_are_remembered_and_none_that_goes_on_is_forgotten(visitors):
    visitor = visitors.get("a")
    going = Job("run", Path("stop"))
    visitor.remember(going)
    for _ in range(20):
        over = Job("run", Path("stop"))
        over.end("done")
        visitor.remember(over)
    assert len(visitor.jobs) == 8 and going.name in visitor.jobs
    assert visitor.latest("run") is over and visitor.latest("cut") is None
