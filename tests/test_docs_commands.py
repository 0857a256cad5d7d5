"""Every command of README and docs is one that a newcomer can type.

Commands stand in blocks ```sh. Each is parsed: its options, its files and the program exist. Those
without a second word on the fence are also run, in their order, in a clean clone (slow).
"""

import os
import re
import shlex
import signal
import subprocess
from pathlib import Path

import pytest
import tyro

from bridge.commands import COMMANDS as BRIDGE
from phy124.__main__ import _parse
from phy124.errors import InputError
from phy124.schema.arguments.words import join_repeats
from support.pages import BLOCK, PAGES, ROOT, blocks
from support.processes import run_program

NOT_RUN = {"ros2", "own", "network", "long", "server"}
"""Why a block is only parsed: it needs ROS 2, the reader's files, the network, hours, or Ctrl-C."""
INLINE = re.compile(r"`((?:\.venv/bin/[^\s`]+|phy124|phy124-bridge|python -m bridge|make) [^`]*)`")
FOREIGN = {"git", "blender", "docker", "pipx", "uv", "ros2", "rviz2", "colcon", "pip", "source"}
FOREIGN |= {"mkdir", "ln", "cd", "."}
"""Programs that are not of this repository."""


def commands(text: str) -> list[str]:
    """The lines of a block, without comments."""
    bare = (shlex.split(line, comments=True) for line in text.splitlines())
    return [shlex.join(words) for words in bare if words]


SHELL = [block for block in blocks() if block.words[:1] == ["sh"]]
COMMANDS = [(block, line) for block in SHELL for line in commands(block.text)]
PROSE = [
    (page, command)
    for page in PAGES
    for command in INLINE.findall(BLOCK.sub("", page.read_text("utf-8")))
]


def targets() -> set[str]:
    return set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))


def parse(words: list[str]) -> None:
    """Fails unless the program exists and takes these options."""
    program, rest = words[0], words[1:]
    if program in ("make",):
        assert set(rest) <= targets(), rest
    elif program in ("phy124", ".venv/bin/phy124"):
        parse_phy124(rest)
    elif rest[:2] == ["-m", "bridge"]:
        parse_bridge(rest[2:])
    elif program == "phy124-bridge":
        parse_bridge(rest)
    elif program == "python3" and rest[:2] == ["-m", "venv"]:
        assert "--system-site-packages" in rest, "our own is made by make"
    elif program in ("python", ".venv/bin/python"):
        assert (ROOT / rest[0]).is_file(), rest
    else:
        assert program in FOREIGN or program == ".venv/bin/pip", f"what is {program}?"


def parse_bridge(rest: list[str]) -> None:
    if rest != ["--help"]:
        tyro.extras.subcommand_cli_from_dict(BRIDGE, args=join_repeats(rest, BRIDGE))


def parse_phy124(rest: list[str]) -> None:
    rest = rest[: rest.index(">")] if ">" in rest else rest
    rest = [word for word in rest if word not in ("--quiet", "--verbose")]
    if rest[0] not in ("--version", "--help", "--tyro-print-completion"):
        _parse(rest)


@pytest.mark.parametrize("block", blocks(), ids=lambda b: f"{b.page.name}-{b.text[:30]!r}")
def test_every_block_says_what_it_is(block):
    assert block.words, f"{block.page.name}: name the language of the block: {block.text[:60]}"
    if block.words[0] == "sh":
        assert set(block.words[1:]) <= NOT_RUN


@pytest.mark.parametrize(("block", "line"), COMMANDS, ids=[line for _, line in COMMANDS])
def test_every_command_parses_and_names_files_that_exist(block, line):
    words = shlex.split(line)
    if "&&" in words:
        words = words[: words.index("&&")]
    parse(words)
    if not set(block.words) & {"own", "ros2"}:
        for word in words[1:]:
            if "/" in word and not word.startswith(("out/", "-")):
                assert (ROOT / word).exists(), word
        assert words[0].startswith((".venv/bin/", "make", "source")), "a clean clone has no other"


@pytest.mark.parametrize(("page", "command"), PROSE, ids=[command for _, command in PROSE])
def test_every_command_in_prose_parses(page, command):
    words = [word for word in shlex.split(command) if word not in ("...", "NAME", "COMMAND")]
    if words[-1].startswith("--tyro") or "..." in command or "NAME" in command:
        return
    try:
        parse(words)
    except InputError as refusal:
        # Only the rest of a command that prose leaves out may be missing.
        assert "it is required" in str(refusal), f"{page.name}: {refusal}"


def test_a_wrong_command_is_found():
    for wrong in ("make dance", ".venv/bin/phy124 render x --sise 3", "python3 -m bridge info x"):
        with pytest.raises((AssertionError, InputError)):
            parse([*shlex.split(wrong)][: 9 if "python3" not in wrong else 1])


@pytest.fixture(scope="module")
def clone(tmp_path_factory) -> Path:
    """Make a clone, with the packages of `make demo` and `make bridge`."""
    folder = tmp_path_factory.mktemp("newcomer") / "phy124"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
    typed(folder, "make demo\nmake bridge")
    return folder


def newcomer() -> dict[str, str]:
    """The environment of somebody who has nothing of this installed."""
    gone = ("PYTHONPATH", "VIRTUAL_ENV", "PYTEST_CURRENT_TEST", "MAKEFLAGS", "MAKELEVEL")
    kept = {name: value for name, value in os.environ.items() if name not in gone}
    bare = [p for p in kept["PATH"].split(os.pathsep) if ".venv" not in p]
    return {**kept, "PATH": os.pathsep.join(bare)}


def typed(folder: Path, text: str) -> None:
    run = run_program(["bash", "-e", "-c", text], cwd=folder, env=newcomer())
    assert run.returncode == 0, f"{text}\n{run.stdout[-2000:]}\n{run.stderr[-2000:]}"


RUN = [block for block in SHELL if not block.words[1:]]
READY = ("http://", "Sending ")
"""Output that shows that a server runs: the page's address, the bridge's topics."""


@pytest.mark.slow
@pytest.mark.parametrize("block", RUN, ids=lambda b: f"{b.page.name}-{b.text[:40]!r}")
def test_a_newcomer_can_type_it(clone, block):
    typed(clone, block.text)


@pytest.mark.slow
@pytest.mark.parametrize("block", [b for b in SHELL if "server" in b.words], ids=lambda b: b.text)
def test_a_newcomer_can_start_it_and_stop_it(clone, block):
    run = subprocess.Popen(
        ["bash", "-c", f"exec {commands(block.text)[0]}"],
        cwd=clone,
        env=newcomer(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    with run:
        assert run.stdout
        said = []
        for line in run.stdout:
            said.append(line)
            if any(sign in line for sign in READY):
                break
        started = run.poll() is None
        if started:
            os.killpg(run.pid, signal.SIGINT)
    assert started, "".join(said)
