"""Visitors' folders: keys by content, clean-up when they leave, by age and by number."""

from __future__ import annotations

import os

import pytest

from demo.visitors import Visitors, key
from phy124.errors import InputError


@pytest.fixture
def visitors(tmp_path) -> Visitors:
    return Visitors(tmp_path)


def test_keys_depend_on_every_part_and_on_nothing_else():
    assert key("a", {"x": 1, "y": 2}) == key("a", {"y": 2, "x": 1})
    assert len({key("a", "b"), key("ab"), key("b", "a"), key("a", b"b"), key("a", ["b"])}) == 5


def test_folders_cannot_be_guessed_and_are_kept_apart(visitors):
    one, two = visitors.get("a"), visitors.get("b")
    assert one is visitors.get("a")
    assert one.folder != two.folder and one.folder.name != "a"
    assert len(one.folder.name) >= 32


def test_leaving_removes_the_folder(visitors, tmp_path):
    (visitors.get("a").folder / "clips" / "x").mkdir()
    visitors.leave("a")
    assert list(tmp_path.iterdir()) == [] and len(visitors) == 0
    visitors.leave("a")


def test_leaving_while_work_goes_on_asks_it_to_stop(visitors):
    visitor = visitors.get("a")
    flag = visitor.begin()
    assert visitor.start(flag)
    visitors.leave("a")
    assert flag.exists()
    assert not (visitor.folder / "clips").exists()


def test_what_was_queued_for_someone_who_has_left_is_refused(visitors, tmp_path):
    visitors.get("a")
    visitors.leave("a")
    with pytest.raises(InputError, match="was closed"):
        visitors.get("a")
    assert list(tmp_path.iterdir()) == []


def test_a_stop_reaches_all_work_in_hand_and_no_other(visitors):
    visitor = visitors.get("a")
    one, two, over = visitor.begin(), visitor.begin(), visitor.begin()
    assert all(visitor.start(flag) for flag in (one, two, over))
    visitor.end(over)
    assert visitor.stop()
    assert one.exists() and two.exists() and not over.exists()
    assert not visitor.begin().exists()


def test_work_that_waits_is_called_off_and_never_starts(visitors):
    visitor = visitors.get("a")
    early, late = visitor.begin(), visitor.begin()
    assert visitor.busy and not visitors.stop("a"), "nothing was running"
    assert not visitor.busy and not visitor.start(early)
    assert not late.exists(), "no stop file is left behind"
    assert visitor.start(visitor.begin()) and visitor.busy


def test_sweeping_by_age_and_by_number(visitors, tmp_path):
    folders = {name: visitors.get(name).folder for name in "abcd"}
    for age, name in enumerate("dcba"):
        visitors.get(name).seen -= 100 * age
    for folder in folders.values():
        os.utime(folder, (0, 0))
    visitors.sweep(age=250, most=2)
    assert set(tmp_path.iterdir()) == {folders["d"], folders["c"]}


def test_visitors_with_work_in_hand_are_not_swept_by_number(visitors):
    busy = visitors.get("a")
    busy.begin()
    visitors.get("b")
    visitors.sweep(age=1000, most=1)
    assert visitors.get("a") is busy


def test_only_the_newest_results_are_kept(visitors):
    visitor = visitors.get("a")
    for age in range(5):
        folder = visitor.folder / "clips" / str(age)
        folder.mkdir()
        os.utime(folder, (1000 - age, 1000 - age))
    visitor.trim(2)
    assert sorted(path.name for path in (visitor.folder / "clips").iterdir()) == ["0", "1"]
