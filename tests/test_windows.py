"""Windows: without fcntl and resource, commands run and the page starts."""

import json
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from demo.folder import LOCK
from phy124.io.ply import write_ply
from support.processes import run_program
from support.served import ROOT, serving
from support.shapes import ball

AS_ON_WINDOWS = """
import os, runpy, signal, sys
for name in ("fcntl", "resource"):
    sys.modules[name] = None
for module, names in {
    os: ("getuid", "O_NOFOLLOW", "killpg", "sched_getaffinity", "sched_yield"),
    signal: ("SIGHUP", "SIGKILL"),
}.items():
    for name in names:
        delattr(module, name)
sys.argv[:] = sys.argv[1:]
"""


def write_script(folder: Path, code: str) -> Path:
    """A script that runs code without what Windows lacks."""
    path = folder / "windows.py"
    path.write_text(f"{AS_ON_WINDOWS}sys.path.insert(0, {str(ROOT)!r})\n{code}")
    return path


def test_run_is_simulated_and_filmed(tmp_path):
    write_ply(tmp_path / "ball.ply", ball(300))
    code = "from phy124.__main__ import main\nsys.exit(main(sys.argv))"
    options = "--frames 2 --size 32 --views front --device cpu --json --set accuracy.cells=8"
    command = [sys.executable, write_script(tmp_path, code), "simulate", "ball.ply"]
    done = run_program([*command, *options.split()], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["complete"]
    assert (tmp_path / "out/ball-press/front.mp4").is_file()


def test_folder_of_the_page_needs_no_locks(tmp_path):
    code = """
from demo.connections import allow_connections
from demo.fits import video
from demo.folder import LOCK, lock_folder
with lock_folder() as root:
    assert (root / LOCK).exists()
assert not root.exists() and allow_connections() == 256 and video.resource is None
"""
    subprocess.run([sys.executable, write_script(tmp_path, code), "page"], check=True)


@pytest.mark.slow
def test_page_starts_and_ends(tmp_path):
    script = write_script(tmp_path, "from demo.__main__ import main\nsys.exit(main([]))")
    with serving(tmp_path, (sys.executable, script), warm=False) as server:
        with urllib.request.urlopen(f"{server.url}/") as answer:
            assert b"phy124" in answer.read()
        assert (server.folder / LOCK).exists()
    assert not list(server.folder.glob("visitors/*"))
