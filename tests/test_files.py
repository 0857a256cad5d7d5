"""Output files appear whole or not at all."""

import errno
import os

import pytest

from phy124.errors import Incomplete, InputError
from phy124.io import files
from phy124.io.files import replacing, staging, writable
from phy124.runtime.failures import failure


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_staged_folder_s_files_appear_together(tmp_path):
    with staging(tmp_path / "out") as folder:
        (folder / "clip").write_text("new")
        (folder / "report.json").touch()
        assert not (tmp_path / "out" / "clip").exists()
    assert names(tmp_path / "out") == ["clip", "report.json"]


def test_empty_folders_are_not_listed_as_results(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(Incomplete, match=r"out: file, full$"), staging(out, keeps=True) as made:
        for folder in ("plots", "full"):
            (made / folder).mkdir()
        for name in ("file", "full/inner"):
            (made / name).touch()
        raise OSError(errno.ENOSPC, "full")
    assert names(out) == ["file", "full"]


def test_pictures_of_an_older_run_do_not_mix_with_the_new_ones(tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "99.png").touch()
    (tmp_path / "mine.txt").touch()
    with staging(tmp_path) as folder:
        (folder / "frames").mkdir()
        (folder / "frames" / "00.png").touch()
    assert names(tmp_path / "frames") == ["00.png"]
    assert (tmp_path / "mine.txt").exists()


@pytest.mark.parametrize("ending", [ValueError, KeyboardInterrupt])
def test_an_older_file_stays_until_the_new_one_is_whole(tmp_path, ending):
    path = tmp_path / "clip.mp4"
    path.write_text("old")
    with pytest.raises(ending), replacing(path) as part:
        part.write_text("half")
        raise ending
    assert path.read_text() == "old" and names(tmp_path) == ["clip.mp4"]
    with replacing(path) as part:
        assert part.suffix == ".mp4", "writers go by the ending"
        part.write_text("whole")
    assert path.read_text() == "whole" and names(tmp_path) == ["clip.mp4"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("name", ["missing/clip.mp4", "folder"])
def test_unwritable_paths_are_refused(tmp_path, name):
    (tmp_path / "folder").mkdir()
    with (
        pytest.raises(InputError, match="no file can be written to this path"),
        replacing(tmp_path / name),
    ):
        pytest.fail("it began")
    assert names(tmp_path) == ["folder"]


def test_a_link_to_itself_is_no_output_folder(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="symbolic links"), staging(tmp_path / "loop"):
        pytest.fail("it began")


def test_a_folder_is_writable_if_the_nearest_that_exists_is(tmp_path):
    (tmp_path / "file").touch()
    assert writable(tmp_path) and writable(tmp_path / "a" / "b")
    assert not writable(tmp_path / "file") and not writable(tmp_path / "file" / "deeper")
    if os.geteuid() != 0:  # root may write anywhere
        tmp_path.chmod(0o500)
        assert not writable(tmp_path / "a")
        tmp_path.chmod(0o700)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EMFILE])
def test_a_machine_that_runs_short_is_no_bad_name(tmp_path, monkeypatch, code):
    """A disk without room for one more file, and too many open files."""

    def refuse(*_: object, **options: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(files, "create_temporary", refuse)
    monkeypatch.setattr(files.tempfile, "mkdtemp", refuse)
    for writes in (replacing(tmp_path / "a.json"), staging(tmp_path / "new")):
        with pytest.raises(OSError, match=f"Errno {code}") as refused, writes:
            pytest.fail("it began")
        assert failure(refused.value).status == 1
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    "problem",
    [
        OSError(errno.ENOSPC, "no room"),
        OSError(errno.ENOSPC, "no room", "x/out/.making-1/.a.part"),
        OSError(errno.ENOSPC, "no room", "/tmp/scratch", None, "x/out/.making-1/a"),
        RuntimeError("a library: No space left on device"),
    ],
    ids=["no name", "a temporary name", "two names", "no OSError"],
)
def test_a_full_disk_is_named_by_the_folder_of_the_results(tmp_path, monkeypatch, problem):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError) as refused, staging("x/out") as folder, replacing(folder / "a"):
        raise problem
    assert failure(refused.value).sentence.endswith(
        "No space left on device: 'x/out'). Free some space, or choose another folder."
    )
    assert names(tmp_path) == []


def test_a_full_disk_elsewhere_keeps_its_name(tmp_path):
    problem = OSError(errno.ENOSPC, "no room", "/elsewhere/a")
    with pytest.raises(OSError, match="elsewhere"), staging(tmp_path / "out"):
        raise problem


def test_a_folder_with_too_long_a_name_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"out = .*name too long"), staging(tmp_path / ("n" * 300)):
        pytest.fail("it began")
