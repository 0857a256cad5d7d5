"""Warp starts without a word, and keeps its kernels where they can be kept."""

import os
import stat
import sys
from pathlib import Path

import pytest
import warp as wp

from phy124.io.files import writable
from phy124.runtime import startup
from support.processes import run_program

NAMED = ("WARP_CACHE_PATH", "XDG_CACHE_HOME", "PYTHONWARNINGS")


@pytest.fixture
def fresh(monkeypatch):
    """Warp as it is before anybody has started it."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", None)
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    monkeypatch.delenv("WARP_CACHE_PATH", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)


def test_no_message_goes_to_standard_output(fresh):
    startup.prepare()
    assert wp.config.log_level == wp.LOG_WARNING


def test_user_choice_is_kept(fresh, monkeypatch):
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_DEBUG)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", "/dev/null/mine")
    startup.prepare()
    assert (wp.config.log_level, wp.config.kernel_cache_dir) == (wp.LOG_DEBUG, "/dev/null/mine")


def test_read_only_home_uses_a_temporary_folder(fresh, monkeypatch, tmp_path):
    monkeypatch.setattr(startup.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(startup, "kernel_folder", lambda: Path("/dev/null/.cache/warp"))
    with pytest.warns(UserWarning, match="/dev/null/.cache/warp cannot be written"):
        startup.prepare()
    folder = Path(str(wp.config.kernel_cache_dir))
    assert folder.parent == tmp_path
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert startup.temporary_folder() == folder


@pytest.mark.parametrize("named", ["~/kernels", ""])
def test_a_folder_may_be_named_by_the_home(named, fresh, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("WARP_CACHE_PATH", named)
    startup.prepare()
    assert os.environ["WARP_CACHE_PATH"] == (str(tmp_path / "kernels") if named else "")
    assert not (tmp_path / "~").exists()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="no /proc")
def test_folder_that_only_seems_writable_is_detected(fresh, monkeypatch, tmp_path):
    """As /proc is for root."""
    monkeypatch.setenv("HOME", "/proc")
    monkeypatch.setattr(startup.tempfile, "gettempdir", lambda: str(tmp_path))
    with pytest.warns(UserWarning, match=r"/proc/\.cache/warp/.* cannot be written"):
        startup.prepare()


def test_a_temporary_folder_that_others_may_write_to_is_not_used(monkeypatch, tmp_path):
    monkeypatch.setattr(startup.tempfile, "gettempdir", lambda: str(tmp_path))
    shared = startup.temporary_folder()
    shared.chmod(0o777)
    assert startup.temporary_folder() != shared


def test_folders_that_can_be_written_or_made(tmp_path):
    assert writable(tmp_path)
    assert writable(tmp_path / "new" / "deeper")
    assert not writable(Path("/dev/null/x"))
    (tmp_path / "file").touch()
    assert not writable(tmp_path / "file")


def test_only_the_missing_driver_line_is_filtered(capfd):
    with startup._without_line(startup.NO_DRIVER):
        os.write(2, b"Warp CUDA warning: " + startup.NO_DRIVER + b". GPU execution will not\n")
        os.write(2, b"something else\n")
    assert capfd.readouterr().err == "something else\n"


def test_command_prints_one_line_about_the_cache():
    run = run_program(
        [sys.executable, "-m", "phy124", "effects", "press"],
        env={k: v for k, v in os.environ.items() if k not in NAMED} | {"HOME": "/dev/null"},
        check=True,
    )
    assert "CUDA" not in run.stderr
    (line,) = run.stderr.splitlines()
    assert line.startswith("phy124: ")
    assert "compiled kernels are kept in" in line
