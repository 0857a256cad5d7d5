"""Ctrl-C at any moment of the start: no traceback, and an exit status that says what happened.

What Python does before its first line of ours is its own: for some milliseconds, while it reads
its site-packages, it answers with a traceback that no program can prevent.
"""

import ast
import os
import runpy
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import setuptools

from bridge.__main__ import importing, main
from support.clips import random_clip

ROOT = Path(__file__).parents[1]
BRIDGE = ROOT / "bridge"
EXEC = "exec"
"""The moment at which the interpreter has only just been loaded."""


def interrupted(arguments, moment, **environment):
    """Exit status and last words of a Python that gets SIGINT when it has imported `moment`."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    command = [sys.executable, "-X", "importtime", *map(str, arguments)]
    with subprocess.Popen(
        command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        if moment != EXEC:
            imported = (line.rpartition("|")[2].strip() for line in process.stderr)
            assert moment in imported, "it has ended before"
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read().splitlines()
    return process.returncode, [line for line in rest if not line.startswith("import time:")]


@pytest.fixture
def clip(tmp_path):
    random_clip(frames=300).save(tmp_path / "clip.safetensors")
    return tmp_path / "clip.safetensors"


@pytest.mark.parametrize(
    ("command", "moment"),
    [
        ("doctor", EXEC),
        pytest.param("doctor", "phy124.runtime.signals", marks=pytest.mark.slow),
        ("doctor", "numpy"),
        pytest.param("doctor", "cyclonedds", marks=pytest.mark.slow),
        pytest.param("record CLIP", EXEC, marks=pytest.mark.slow),
        ("record CLIP", "phy124.runtime.signals"),
        pytest.param("record CLIP", "pydantic_core", marks=pytest.mark.slow),
        ("record CLIP", "mcap.writer"),
        pytest.param("play CLIP --backend dds", EXEC, marks=pytest.mark.slow),
        pytest.param("play CLIP --backend dds", "phy124.errors", marks=pytest.mark.slow),
        ("play CLIP --backend dds", "tyro"),
        pytest.param("play CLIP --backend dds", "cyclonedds.domain", marks=pytest.mark.slow),
        pytest.param(
            "play CLIP --backend foxglove --port 0", "foxglove.websocket", marks=pytest.mark.slow
        ),
    ],
)
def test_the_command_line(clip, command, moment):
    words = [str(clip) if word == "CLIP" else word for word in command.split()]
    status, said = interrupted(["-m", "bridge", *words], moment)
    check(status, said, moment, (130, ["bridge: stopped"]))


def test_an_interrupt_that_native_code_wraps_is_one(monkeypatch, capsys):
    def run(arguments, description):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("bridge.command_line._command", run)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "bridge: stopped\n"


def check(status, said, moment, expected):
    if moment == EXEC and status != expected[0]:
        # Nothing of ours had begun; an environment may be beside it, which Python itself reads.
        assert status in (-signal.SIGINT, 1)
        assert not [line for line in said if str(ROOT) in line.replace(f"{ROOT}/.venv", "")]
    else:
        # An interrupt that was caught, but passed through `exec` of a text (as in a data class that
        # was being made), Python repeats at its end. Shells call both 130.
        status = 130 if status == -signal.SIGINT else status
        # Foxglove says when its server starts and ends.
        assert (status, said[-1:]) == expected
        assert not [line for line in said if "Traceback" in line or "Error" in line]


@pytest.fixture
def executables(tmp_path, monkeypatch):
    """The scripts that setup.py installs, beside a ROS 2 that never ends being imported."""
    monkeypatch.setattr(setuptools, "setup", lambda **_: None)
    monkeypatch.chdir(BRIDGE)
    package = runpy.run_path("setup.py")

    class Written:
        def write_script(self, name, contents, *_):
            (tmp_path / name).write_text(contents)

    writer = package["quick"](Written)()
    for name in package["EXECUTABLES"]:
        writer.write_script(name, "#!/usr/bin/python\nas setuptools would have it\n", "t", ())
    (tmp_path / package["NAME"]).symlink_to(BRIDGE)
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "begun.py").touch()
    (tmp_path / "rclpy" / "__init__.py").write_text(
        "from . import begun\nimport time\ntime.sleep(99)"
    )
    return tmp_path


@pytest.mark.parametrize("moment", [EXEC, "phy124_bridge", "phy124_bridge.start", "rclpy.begun"])
@pytest.mark.parametrize("name", [pytest.param("player", marks=pytest.mark.slow), "simulate"])
def test_the_nodes(executables, name, moment):
    path = os.pathsep.join([str(executables), str(ROOT)])
    status, said = interrupted([executables / name], moment, PYTHONPATH=path)
    check(status, said, moment, (0, []))


def test_the_script_of_the_command_line_is_quick_as_well(executables):
    path = os.pathsep.join([str(executables), str(ROOT)])
    status, said = interrupted([executables / "bridge", "doctor"], "numpy", PYTHONPATH=path)
    assert (status, said) == (130, ["bridge: stopped"])


@pytest.mark.parametrize("module", ["__main__", "start", "__init__"])
def test_slow_imports_happen_where_ctrl_c_is_caught(module):
    imports = set()
    for node in ast.parse((BRIDGE / f"{module}.py").read_text()).body:
        if isinstance(node, ast.Import):
            imports |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imports.add((node.module or ".").split(".")[0])
    assert imports <= {"__future__", "os", "sys", "collections", "contextlib", "__main__"}


def test_ctrl_c_before_the_handler_stands(monkeypatch, capsys):
    def interrupt(name, *_, **__):
        raise KeyboardInterrupt

    for start in (
        lambda: main(["doctor"]),
        lambda: importing(130, "bridge: stopped\n").__enter__(),
    ):
        monkeypatch.setattr("builtins.__import__", interrupt)
        try:
            status = start()
        except SystemExit as ended:
            status = ended.code
        monkeypatch.undo()
        assert status == 130
        assert capsys.readouterr().err == "bridge: stopped\n"


def test_interrupt_during_import_is_quiet(capsys):
    with pytest.raises(SystemExit) as ended, importing(7, "over\n"):
        raise KeyboardInterrupt
    assert (ended.value.code, capsys.readouterr().err) == (7, "over\n")
