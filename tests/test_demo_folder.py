"""The page's own folder: emptied at the start, gone at the end, swept after a kill."""

import os
import signal
import subprocess
import sys

import pytest

from demo.folder import LOCK, PREFIX, lock_folder
from phy124.errors import InputError


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_folder_is_removed_with_its_content(tmp_path):
    with lock_folder() as root:
        (root / "visitors").mkdir()
        (root / "visitors" / "photograph.png").write_bytes(b"x")
        assert root.parent == tmp_path
    assert list(tmp_path.iterdir()) == []


def test_folder_may_be_named_relative_to_home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with lock_folder("~/page") as root:
        assert root == tmp_path / "page" and not (tmp_path / "~").exists()


def test_folder_is_removed_if_the_page_fails(tmp_path):
    with pytest.raises(RuntimeError), lock_folder() as root:
        (root / "photograph.png").write_bytes(b"x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


HOLD = """
import sys, tempfile
tempfile.tempdir = sys.argv[1]
from demo.folder import lock_folder
with lock_folder() as root:
    (root / "photograph.png").write_bytes(b"x")
    print(root, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """Another page with a folder of its own."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    process.stdout.readline()
    yield process
    process.kill()
    process.communicate()


def test_folder_of_a_killed_page_is_swept_and_live_one_kept(tmp_path, other):
    with lock_folder():
        assert len(list(tmp_path.glob(f"{PREFIX}*/photograph.png"))) == 1
    os.kill(other.pid, signal.SIGKILL)
    other.wait()
    assert len(list(tmp_path.glob(f"{PREFIX}*/photograph.png"))) == 1
    with lock_folder():
        assert list(tmp_path.glob(f"{PREFIX}*/photograph.png")) == []


def test_links_are_not_followed_when_sweeping(tmp_path):
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "letter").write_text("x")
    (tmp_path / f"{PREFIX}link").symlink_to(tmp_path / "precious")
    with lock_folder():
        assert (tmp_path / "precious" / "letter").exists()


def test_named_folder_is_emptied_unless_it_has_other_files(tmp_path):
    with lock_folder(str(tmp_path / "a")) as root:
        (root / "left").write_text("x")
        with (
            pytest.raises(InputError, match="another page uses this folder"),
            lock_folder(str(root)),
        ):
            pass
    assert [path.name for path in (tmp_path / "a").iterdir()] == [LOCK]
    with lock_folder(str(tmp_path / "a")):
        pass
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "letter").write_text("x")
    with (
        pytest.raises(InputError, match="holds other files, such as letter"),
        lock_folder(str(tmp_path / "b")),
    ):
        pass
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["letter"]


def test_folder_with_another_programs_lock_file_is_refused(tmp_path):
    (tmp_path / "lock").write_text("apt")
    (tmp_path / "thesis.txt").write_text("x")
    with pytest.raises(InputError, match="holds other files"), lock_folder(str(tmp_path)):
        pass
    assert (tmp_path / "thesis.txt").exists()
