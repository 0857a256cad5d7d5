"""Visitors' folders: keys by content, grace, clean-up by silence, number and size."""

import errno
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from demo.line import Job
from demo.room import EACH, Room
from demo.visitor import Visitor
from demo.visitors import UNFINISHED, UNUSED, Visitors, key
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
    single, two = visitors.get("a"), visitors.get("b")
    assert single is visitors.get("a")
    assert single.folder != two.folder and single.folder.name != "a"
    assert len(single.folder.name) >= 32


def test_removing_a_visitor_removes_pictures_and_results(visitors, tmp_path):
    _with_result(visitors.get("a"))
    visitors.store("a", b"a photograph", ".png")
    visitors.remove("a")
    assert _folders(tmp_path) == set() and len(visitors) == 0
    visitors.remove("a")


def test_removing_a_busy_visitor_stops_its_work(visitors, tmp_path):
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
    visitor.seen -= 800
    visitors.sweep()
    assert visitors.find("a") is visitor and visitor.silence < 60, "a look is a sign of life"
    visitor.seen -= 910
    visitors.sweep()
    assert visitors.find("a") is None and _folders(tmp_path) == set()


def test_a_request_that_is_processed_for_long_is_no_silence(visitors):
    with visitors.asking("a"):
        with visitors.asking("a"):
            visitors.get("a").seen -= visitors.room.grace + 1
        visitors.get("a").seen -= visitors.room.grace + 1
        visitors.sweep()
        assert visitors.has("a")
    visitors.get("a").seen -= visitors.room.grace + 1
    visitors.sweep()
    assert not visitors.has("a")


def test_silence_of_a_suspended_server_is_not_that_of_a_visitor(visitors):
    visitors.get("a").seen -= visitors.room.grace + 100
    visitors.sweep(late=200)
    assert visitors.has("a")
    visitors.get("a").seen -= visitors.room.grace + 100
    visitors.sweep(late=50)
    assert not visitors.has("a")


def test_an_upload_that_fills_the_disk_is_refused_and_removed(visitors, tmp_path, monkeypatch):
    def fill(source, target) -> None:
        target.write(b"a phot")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(shutil, "copyfileobj", fill)
    for name in ("a", None):
        with pytest.raises(InputError, match="disk of this server is full"):
            visitors.store(name, b"a photograph", ".png")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_visitors_whose_files_were_removed_begin_anew(visitors, tmp_path):
    """Programs that clean temporary folders remove files of pages that run for days."""
    visitors.store("a", b"a photograph", ".png")
    shutil.rmtree(tmp_path)
    visitors.sweep()
    assert not visitors.has("a"), "the page of this visitor sends its picture again"
    for name in ("a", None):
        assert visitors.store(name, b"a photograph", ".png").read_bytes() == b"a photograph"


def test_asking_for_a_job_is_a_sign_of_life(visitors):
    visitor, job = visitors.get("a"), Job("run", Path("stop"))
    visitor.remember(job)
    visitor.seen -= 500
    assert visitors.job(job.name) is job and visitor.silence < 60
    assert visitors.job("unknown") is None


def test_newcomers_do_not_push_out_results_of_an_open_page(tmp_path):
    visitors = Visitors(tmp_path, Room(visitors=3))
    kept = [_with_result(visitors.get(name)) for name in "ab"]
    for number in range(50):
        visitors.get(f"new {number}").seen -= 10
    assert [visitors.find(name) for name in "ab"] == kept and len(visitors) == 3


@pytest.mark.parametrize("address", ["", "10.0.0.2", "10.0.1.{}"])
def test_newcomers_do_not_push_out_who_has_chosen_a_picture(tmp_path, address):
    """However long the visitor looks at it: of all visitors, this one is silent longest."""
    visitors = Visitors(tmp_path, Room(visitors=5))
    visitors.store("a", b"a photograph", ".png", address.format("a"))
    visitors.get("a").remember(Job("cut", Path("stop")))
    visitors.get("a").latest("cut").end("done")
    visitors.get("a").seen -= visitors.room.grace - 1
    for number in range(75):
        visitors.store(f"new {number}", b"1", ".png", address.format(number))
        visitors.get(f"new {number}").seen -= 10
    assert visitors.find("a") is not None and len(visitors) == 5


def test_newcomers_of_one_address_push_out_each_other(tmp_path):
    visitors = Visitors(tmp_path, Room(visitors=40))
    visitors.get("b", "10.0.0.1")
    for number in range(50):
        visitors.get(f"new {number}", "10.0.0.2")
    assert visitors.find("b") is not None and len(visitors) == 1 + UNUSED


def test_one_address_has_only_so_many_visitors(tmp_path):
    visitors = Visitors(tmp_path, Room(visitors=40, address=3))
    for name in "abc":
        _with_result(visitors.get(name, "10.0.0.1"))
    with pytest.raises(InputError, match="from your address"):
        visitors.get("d", "10.0.0.1")
    assert visitors.get("e", "10.0.0.2")


def test_one_address_has_only_half_of_the_queue(visitors):
    for name in "abcd":
        visitor = visitors.get(name, "10.0.0.1")
        for _ in range(UNFINISHED if name < "c" else 2 if name == "c" else 0):
            visitors.check_work(visitor, 16)
            visitor.remember(Job("run", Path("stop")))
    with pytest.raises(InputError, match="You have work waiting"):
        visitors.check_work(visitors.get("a"), 16)
    with pytest.raises(InputError, match="from your network"):
        visitors.check_work(visitors.get("d"), 16)
    visitors.check_work(visitors.get("e", "10.0.0.2"), 16)


def test_uploads_without_a_name_have_little_room_and_go_first(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=2000))
    mine = visitors.store(None, bytes(100), ".png", "10.0.0.1")
    paths = [visitors.store(None, bytes(100), ".png", "10.0.0.2") for _ in range(20)]
    assert visitors.arrivals.size == 500 and mine.exists() and paths[-1].exists()
    for name in "ab":
        visitors.store(name, bytes(950), ".png")
    assert visitors.arrivals.size == 100 and visitors.used == 2000


def test_uploads_without_a_name_are_few_for_each_address(visitors):
    mine = visitors.store(None, b"1", ".png", "10.0.0.1")
    paths = [visitors.store(None, b"1", ".png", "10.0.0.2") for _ in range(EACH + 9)]
    assert [path.exists() for path in paths] == [False] * 9 + [True] * EACH and mine.exists()
    assert len(visitors.arrivals) == EACH + 1 == len(list(visitors.arrivals.folder.iterdir()))


def test_an_upload_is_counted_where_it_is(visitors):
    visitors.get("a")
    path = visitors.store(None, bytes(100), ".png")
    upload = visitors.find_upload("a", str(path))
    assert upload.exists() and visitors.find_upload("a", str(path)) == upload
    assert visitors.used == visitors.expect("a").used == 100 and visitors.arrivals.size == 0


def test_uploads_that_a_visitor_names_fit_into_the_visitors_room(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=20_000))
    visitor = visitors.get("a")
    for _ in range(9):
        path = visitors.store(None, bytes(400), ".png")
        assert visitors.find_upload("a", str(path)).exists() and visitor.used <= 1000
    path = visitors.store(None, bytes(1001), ".png")
    with pytest.raises(InputError, match="your limit is"):
        visitors.find_upload("a", str(path))
    assert visitor.measure() == visitor.used <= 1000


def test_counting_files_blocks_no_request(tmp_path, monkeypatch):
    """Folders are looked through outside the lock, and only one's own."""
    visitors, looked = Visitors(tmp_path), []
    for name in "ab":
        visitors.store(name, bytes(10), ".png")

    def size_of(folder):
        looked.append(folder)
        with ThreadPoolExecutor(1) as pool:
            assert pool.submit(visitors.find, "b").result(9) is not None
        return 10

    monkeypatch.setattr("demo.visitor.size_of", size_of)
    visitors.store("a", bytes(10), ".png")
    visitors.store(None, bytes(10), ".png")
    assert set(looked) == {visitors.get("a").folder}
    visitors.sweep()
    assert visitors.get("b").folder in looked


def _export(visitor: Visitor, name: str, size: int, age: float = 0.0) -> Path:
    path = visitor.folder / "exports" / "x" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(bytes(size))
    os.utime(path, (1000 - age, 1000 - age))
    return path


def test_room_is_made_by_older_exports_of_the_same_visitor(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=3000))
    mine, other = visitors.get("a"), visitors.get("b")
    theirs = _export(other, "0", 900, age=99)
    shown = mine.folder / "live" / "0.pack"
    shown.parent.mkdir()
    shown.write_bytes(bytes(50))
    old, new, kept = (_export(mine, str(n), 300, age=n) for n in (3, 2, 9))
    with visitors.writing(mine, 350, {kept}):
        assert visitors.used == 300 + 300 + 350
    assert [path.exists() for path in (old, new, kept, theirs)] == [False, True, True, True]
    assert not shown.exists(), "what was shown of a run that is over"
    assert visitors.used == mine.measure() + other.used


def test_too_large_uploads_are_refused_and_leave_nothing(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=2000))
    mine, other = visitors.get("a"), visitors.get("b")
    kept = _export(mine, "0", 700)
    _export(other, "0", 900)
    other.measure()
    for size, said in ((400, "Your storage on this server is full"), (1001, "your limit is")):
        with pytest.raises(InputError, match=said), visitors.writing(mine, size, {kept}):
            pytest.fail("it began")
    assert kept.exists()
    with pytest.raises(InputError, match="Too many"), visitors.writing(mine, 250, {kept}):
        pytest.fail("the last tenth is for those who come")
    with visitors.writing(mine, 150, {kept}):
        pass


def test_a_file_larger_than_the_room_removes_no_older_one(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=2000))
    mine = visitors.get("a")
    kept = [_export(mine, name, 300) for name in ("0", "1")]
    with pytest.raises(InputError, match="your limit is"), visitors.writing(mine, 1001):
        pytest.fail("it began")
    assert all(path.exists() for path in kept) and mine.promised == 0


def test_a_visitor_removed_during_an_upload_is_refused(visitors, monkeypatch):
    def write(path: Path, file) -> None:
        visitors.remove("a")
        path.write_bytes(file.read())

    monkeypatch.setattr("demo.visitors._write", write)
    with pytest.raises(InputError, match="Too many visitors"):
        visitors.store("a", b"a photograph", ".png")
    assert visitors.used == 0 == len(visitors)


def test_simultaneous_writes_are_counted_together(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=2000))
    mine = visitors.get("a")
    with visitors.writing(mine, 600):
        with pytest.raises(InputError, match="Your storage"), visitors.writing(mine, 600):
            pytest.fail("it began")
        with visitors.writing(mine, 300):
            pass
    with visitors.writing(mine, 600):
        pass


def test_newcomers_are_refused_while_all_visitors_are_active(tmp_path):
    visitors = Visitors(tmp_path, Room(visitors=2))
    for name in "ab":
        _with_result(visitors.get(name))
    with pytest.raises(InputError, match=r"Too many visitors .* Try again in a few minutes"):
        visitors.get("c")
    visitors.get("a").seen -= 200
    with pytest.raises(InputError, match="Too many visitors"):
        visitors.get("c")
    visitors.get("a").seen -= visitors.room.grace + 1
    visitors.sweep()
    assert visitors.get("c") and visitors.find("a") is None


def test_uploads_count_towards_a_visitor_and_all(tmp_path):
    visitors = Visitors(tmp_path, Room(each=1000, all=2000))
    visitors.store("a", bytes(900), ".png")
    with pytest.raises(InputError, match="Your storage"):
        visitors.store("a", bytes(900), ".png")
    visitors.store("b", bytes(900), ".png")
    for name in ("c", None):
        with pytest.raises(InputError, match="Too many visitors"):
            visitors.store(name, bytes(900), ".png")


def test_unclaimed_uploads_are_removed(visitors, monkeypatch):
    path = visitors.store(None, b"a photograph", ".png")
    visitors.sweep()
    assert path.exists() and visitors.used == 12
    monkeypatch.setattr("demo.room.ARRIVED", -1.0)
    visitors.sweep()
    assert not path.exists() and visitors.used == 0


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


def test_only_finished_jobs_are_forgotten(visitors):
    visitor = visitors.get("a")
    going = Job("run", Path("stop"))
    visitor.remember(going)
    for _ in range(20):
        over = Job("run", Path("stop"))
        over.end("done")
        visitor.remember(over)
    assert len(visitor.jobs) == 8 and going.name in visitor.jobs
    assert visitor.latest("run") is over and visitor.latest("cut") is None
