"""Generators that are commands of the user's: what they get, what they write, and how they end."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phy124.errors import Cancelled, InputError
from phy124.generators import make
from phy124.generators.ply_file import Reading
from phy124.io.ply import write_ply
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

PICTURE = Image.fromarray(np.full((40, 30, 4), 200, np.uint8))


def program(folder: Path, *lines: str) -> str:
    """A command that runs these lines, with the places it is given as `image` and `out`."""
    head = ["import shutil, subprocess, sys, time", "image, out = sys.argv[1:3]"]
    file = folder / "their program.py"
    file.write_text("\n".join([*head, *lines]), "utf-8")
    return f"{sys.executable} '{file}' {{image}} {{out}}"


@pytest.fixture
def copies(tmp_path) -> str:
    """A command that writes 100 Gaussians; it leaves a copy of what it got."""
    write_ply(tmp_path / "made.ply", ball(100))
    return program(
        tmp_path,
        f"shutil.copy(image, {str(tmp_path / 'got.png')!r})",
        f"shutil.copy({str(tmp_path / 'made.ply')!r}, out)",
    )


def test_the_picture_goes_in_and_gaussians_come_out(tmp_path, copies):
    result = make(f"cmd: {copies}")(PICTURE, seed=0, progress=lambda *_: None)
    assert len(result) == 100 and np.ptp(result.means, axis=0).max() == pytest.approx(1)
    with Image.open(tmp_path / "got.png") as got:
        assert got.mode == "RGBA" and got.size == (30, 40)
    turned = make(f"cmd 60: {copies}", Reading(up="x"))(PICTURE, seed=0, progress=lambda *_: None)
    assert not np.allclose(turned.means, result.means)


def test_files_next_to_the_named_file_are_ignored(tmp_path):
    write_ply(tmp_path / "made.ply", ball(100))
    beside = "open(out.removesuffix('.ply') + '.bin', 'w').write('0')"
    copy = f"shutil.copy({str(tmp_path / 'made.ply')!r}, out)"
    command = f"cmd: {program(tmp_path, beside, copy)}.ply"
    assert len(make(command)(PICTURE, seed=0, progress=lambda *_: None)) == 100


def test_materials_next_to_an_extended_name_are_ignored(tmp_path):
    write_ply(tmp_path / "made.ply", ball(100))
    beside = "open(out + '.mtl', 'w').write('newmtl m')"
    copy = f"shutil.copy({str(tmp_path / 'made.ply')!r}, out + '.ply')"
    command = f"cmd: {program(tmp_path, beside, copy)}"
    assert len(make(command)(PICTURE, seed=0, progress=lambda *_: None)) == 100


@pytest.mark.parametrize(
    ("line", "limit"),
    [
        ("sys.exit('no CUDA here')", r"exit status 1: no CUDA here"),
        ("sys.exit(3)", r"exit status 3 and printed nothing\. Run it"),
        ("pass", "did not write a file"),
        ("open(out, 'w').write('ply of nothing')", "not a PLY"),
    ],
)
def test_failures_of_the_command_are_reported(tmp_path, line, limit):
    with pytest.raises(InputError, match=limit):
        make(f"cmd: {program(tmp_path, line)}")(PICTURE, seed=0, progress=lambda *_: None)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as file:
        return file.read().split()[2] != "Z"


def ends(pid: int) -> None:
    """Wait until a process has ended, which init must notice, too."""
    deadline = time.monotonic() + 60
    while alive(pid):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def started(tmp_path: Path) -> str:
    """A command that starts another one, writes its number, and never ends."""
    return program(
        tmp_path,
        "other = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])",
        f"open({str(tmp_path / 'number')!r}, 'w').write(str(other.pid))",
        "time.sleep(600)",
    )


def test_a_command_that_never_ends_is_ended_with_all_it_started(tmp_path):
    with pytest.raises(InputError, match="longer than 3 s and was stopped"):
        make(f"cmd 3: {started(tmp_path)}")(PICTURE, seed=0, progress=lambda *_: None)
    ends(int((tmp_path / "number").read_text()))


def test_a_cancelled_run_ends_it_at_once(tmp_path):
    number = tmp_path / "number"

    def cancel(*_: object) -> None:
        if number.exists() and number.read_text():
            raise Cancelled

    with pytest.raises(Cancelled):
        make(f"cmd: {started(tmp_path)}")(PICTURE, seed=0, progress=cancel)
    ends(int(number.read_text()))


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("cmd: nothing-of-that-name {image} {out}", "cannot be started"),
        ("cmd: copy {image}", r"does not contain \{out\}"),
        ("cmd: copy {out}", r"does not contain \{image\}"),
        ("cmd: 'copy {image} {out}", "cannot be parsed"),
        ("cmd 0: copy {image} {out}", "not a valid command"),
        ("cmd x: copy {image} {out}", "not a valid command"),
    ],
)
def test_commands_that_are_none_are_refused(text, limit):
    with pytest.raises(InputError, match=limit):
        make(text)(PICTURE, seed=0, progress=lambda *_: None)


def test_the_whole_chain_takes_a_command(tmp_path, copies, capsys):
    from phy124.__main__ import main

    duck = Path(__file__).parents[1] / "demo/examples/duck.png"
    few = ["accuracy.cells=8", "time.frames=2", "view.size=32", 'view.views=["front"]']
    out = tmp_path / "out"
    arguments = ["generate", str(duck), "--generator", f"cmd: {copies}", "--out", str(out)]
    assert main([*arguments, "--set", *few]) == 0, capsys.readouterr().err
    assert (out / "front.mp4").exists()
