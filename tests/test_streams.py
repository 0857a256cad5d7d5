"""Standard streams never end a program: closed, full, without a reader, in a poor encoding."""

import io
import os
import subprocess
import sys

import pytest

from bridge.__main__ import main as bridge
from phy124.runtime.streams import steady_streams
from support.clips import random_clip

pytestmark = pytest.mark.usefixtures("coarse_solids")

FOREIGN = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
PHY124 = f"{sys.executable} -m phy124"
BRIDGE = f"{sys.executable} -m bridge"


def shell(command: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        ["bash", "-c", command],
        check=False,
        env={**os.environ, **environment},
        capture_output=True,
        timeout=120,
    )


@pytest.mark.parametrize(
    ("program", "encoding"),
    [(PHY124, "ascii"), (PHY124, "cp1252"), pytest.param(BRIDGE, "ascii", marks=pytest.mark.slow)],
)
def test_help_is_written_in_any_encoding(program, encoding):
    run = shell(f"{program} --help", **FOREIGN, PYTHONIOENCODING=f"{encoding}:strict")
    assert (run.returncode, run.stderr) == (0, b"")
    assert "• ".encode(encoding, "replace").replace(b"?", b"*") in run.stdout


def test_quiet_is_quiet_in_any_encoding(tmp_path):
    """Although a file with such a name is printed."""
    name = os.fsencode(tmp_path) + "/日.png".encode()
    out = os.fsdecode(name)
    run = shell(f"{PHY124} cutout demo/examples/duck.png --quiet --out '{out}'", **FOREIGN)
    assert (run.returncode, run.stdout, run.stderr) == (0, b"", b"") and os.path.exists(name)


@pytest.mark.parametrize(
    ("command", "closed", "status"),
    [
        (f"{PHY124} --version", ">&-", 0),
        (f"{PHY124} scenes press", "2>&-", 0),
        (f"{PHY124} scenes none", "<&- >&- 2>&-", 2),
        pytest.param(f"{BRIDGE} info none", "<&- >&- 2>&-", 2, marks=pytest.mark.slow),
    ],
)
def test_closed_streams_change_no_status(command, closed, status):
    assert shell(f"{command} {closed}").returncode == status


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
@pytest.mark.parametrize(
    "command",
    [
        f"{PHY124} --version",
        f"{PHY124} --help",
        pytest.param(f"{BRIDGE} info {{bag}}", marks=pytest.mark.slow),
    ],
)
def test_lost_results_are_an_error_and_lost_messages_are_none(command, tmp_path):
    if "{bag}" in command:
        random_clip(2).save(tmp_path / "clip.safetensors")
        assert bridge(["record", str(tmp_path / "clip.safetensors"), str(tmp_path / "bag")]) == 0
        command = command.format(bag=tmp_path / "bag")
    run = shell(f"{command} > /dev/full")
    assert run.returncode == 1
    assert b": the disk is full" in run.stderr and run.stderr.count(b"\n") == 1
    assert b"'standard output'" in run.stderr
    assert shell(f"{command} 2> /dev/full").returncode == 0


@pytest.mark.parametrize(
    ("text", "written"),
    [("• 2 × 日 é", rb"* 2 x \u65e5 \xe9"), (os.fsdecode(b"name-\xff"), b"name-\xff")],
)
def test_characters_missing_in_an_encoding_are_spelled(text, written, tmp_path, monkeypatch):
    """The bytes of a file's name that are no text are kept."""
    with open(tmp_path / "out", "w", encoding="ascii", errors="strict") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        with steady_streams():
            sys.stdout.write(text)
    assert (tmp_path / "out").read_bytes() == written


def test_no_later_file_gets_the_number_of_a_closed_stream():
    code = (
        "import os; from phy124.runtime.streams import steady_streams\n"
        "with steady_streams():\n"
        "    raise SystemExit(min(3, os.open(os.devnull, os.O_RDONLY)))"
    )
    assert shell(f"{sys.executable} -c '{code}' <&- >&- 2>&-").returncode == 3


def test_a_pipe_that_does_not_block_is_waited_for(tmp_path, monkeypatch):
    read, write = os.pipe()
    os.set_blocking(write, False)
    text = "x" * 500_000  # more than a pipe holds
    with (
        (tmp_path / "out").open("w") as out,
        subprocess.Popen(["cat"], stdin=read, stdout=out) as cat,
    ):
        os.close(read)
        with open(write, "w", encoding="utf-8") as stream:
            monkeypatch.setattr(sys, "stdout", stream)
            with steady_streams() as lost:
                sys.stdout.write(text)
        cat.wait(timeout=60)
    assert lost == [] and (tmp_path / "out").read_text() == text


def test_a_stream_of_another_program_stays_as_it_is(monkeypatch):
    monkeypatch.setattr(sys, "stdout", kept := io.StringIO())
    with steady_streams():
        assert sys.stdout is kept
