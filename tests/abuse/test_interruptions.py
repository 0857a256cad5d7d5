"""Runs that are ended at random moments (pytest -m slow): files are valid, and the run can
continue.

Prints how many of how many were survived. PHY124_INTERRUPTIONS sets their number, PHY124_SEED their
moments.
"""

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bridge.recover import recover
from phy124.io.clip import Clip
from phy124.io.ply import write_ply
from phy124.pipeline import PAUSE
from support.processes import limited, run_program
from support.shapes import ball

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name == "nt", reason="no kill -9, no small disks"),
]
RUNS = int(os.environ.get("PHY124_INTERRUPTIONS", "60"))
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
FAST = ["--set", "accuracy=draft", "--set", "time.sleep=false", "--size", "48", "--threads", "1"]
FAST += ["--frames", "40", "--views", "front", "left", "--device", "cpu", "--scene", "drop"]
SWEEP = """
pictures = "{ball}"
scene = "drop"
films = true
[set]
"accuracy.cells" = 10
"time.frames" = 40
"time.sleep" = false
"view.size" = 32
"material.E" = [1e4, 1e5, 1e6]
"""
VARIES = {"report.json", "manifest.parquet", "sweep.json"}
"""Files that hold durations or paths."""
MB = 1_000_000


class Kind:
    """A command that is ended early."""

    def __init__(self, folder: Path, name: str, *command: object) -> None:
        self.name, self.command = name, [*map(str, command)]
        self.whole = folder / f"whole-{name}"
        begun = time.monotonic()
        done = run_program(self.at(self.whole))
        assert done.returncode == 0, done.stderr
        self.seconds = time.monotonic() - begun

    def at(self, out: Path, *more: str) -> list[str]:
        """The command with a place for its results."""
        if self.name == "record":
            return [sys.executable, "-m", *self.command[:3], str(out), *self.command[3:], *more]
        return [sys.executable, "-m", *self.command, "--out", str(out), *more]

    def finish(self, out: Path) -> None:
        """Go on with what an ended run has left."""
        if self.name == "record":
            unfinished = out.exists() and not (out / "metadata.yaml").exists()
            if unfinished and any(path.stat().st_size > MB for path in out.glob("*.mcap")):
                recover(out)
            more = ["--overwrite"] if out.exists() else []
        else:
            more = ["--resume"] if (out / PAUSE).exists() else []
        done = run_program(self.at(out, *more))
        assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def kinds(tmp_path_factory) -> list[Kind]:
    folder = tmp_path_factory.mktemp("interruptions")
    write_ply(folder / "ball.ply", ball(900))
    (folder / "sweep.toml").write_text(SWEEP.format(ball=folder / "ball.ply"))
    generate = Kind(folder, "generate", "phy124", "generate", DUCK, "--gaussians", 900, *FAST)
    clip = generate.whole / "clip.safetensors"
    return [
        generate,
        Kind(folder, "simulate", "phy124", "simulate", folder / "ball.ply", *FAST),
        Kind(folder, "sweep", "phy124", "sweep", folder / "sweep.toml", "--workers", 0),
        Kind(folder, "record", "bridge", "record", clip, "--epoch", 1_700_000_000),
    ]


def started(command: list[str], **options) -> subprocess.Popen:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, **quiet, **options)


def ended_by(number: int, kind: Kind, out: Path, chance: random.Random) -> str:
    """Start a command and send it a signal; returns what it said."""
    process = started(kind.at(out))
    try:
        said = process.communicate(timeout=chance.uniform(0.2, 1) * kind.seconds)[1]
    except subprocess.TimeoutExpired:
        process.send_signal(number)
        said = process.communicate()[1]
    assert process.returncode in (0, 130, -number), said
    return said


def full_disk(kind: Kind, out: Path, chance: random.Random) -> str:
    """Run a command on a disk that gets full; returns what it said."""
    size = sum(path.stat().st_size for path in kind.whole.rglob("*") if path.is_file())
    resize(out.parent, int(chance.uniform(0, 1.2) * size) + 4096)
    process = started(kind.at(out))
    said = process.communicate()[1]
    assert process.returncode in (0, 1, 2), said
    resize(out.parent, 1 << 30)
    return said


def little_memory(kind: Kind, out: Path, chance: random.Random) -> str:
    """Run a command in a group of little memory, or under a limit of addresses; what it said."""
    most = int(chance.uniform(120, 330)) * MB
    try:
        with limited("memory", {"memory.max": most, "memory.limit_in_bytes": most}) as group:
            enter = f'echo $$ > {group}/cgroup.procs && exec "$0" "$@"'
            process = started(["sh", "-c", enter, *kind.at(out)])
            said = process.communicate()[1]
    except pytest.skip.Exception:
        space = (8 * most, 8 * most)
        limit = partial(resource.setrlimit, resource.RLIMIT_AS, space)
        process = started(kind.at(out), preexec_fn=limit)
        said = process.communicate()[1]
        assert process.returncode in (0, 1, 2, -signal.SIGABRT, -signal.SIGSEGV), said
        return said
    assert process.returncode in (0, 1, 2, 3, -signal.SIGKILL), said
    return said


WAYS: dict[str, Callable[[Kind, Path, random.Random], str]] = {
    "TERM": partial(ended_by, signal.SIGTERM),
    "KILL": partial(ended_by, signal.SIGKILL),
    "full disk": full_disk,
    "little memory": little_memory,
}


@contextmanager
def disk(folder: Path) -> Iterator[Path]:
    """A disk of its own, or else a usual folder."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1g", "none", str(folder)]
    mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    try:
        yield folder
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)
        shutil.rmtree(folder)


def resize(folder: Path, size: int) -> None:
    command = ["mount", "-o", f"remount,size={size}", str(folder)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("this machine lets us mount nothing")


def is_good(folder: Path) -> None:
    """Assert that every file is whole that does not say it is not."""
    for path in folder.rglob("*"):
        if path.is_dir() or any(part.startswith((".", "pause-")) for part in path.parts):
            continue
        if path.name == "clip.safetensors":
            assert np.isfinite(Clip.load(path).means).all(), path
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix in (".mp4", ".webp", ".png", ".ply", ".toml"):
            assert path.stat().st_size > 0, path


def same(whole: Path, other: Path) -> None:
    """Assert that two folders hold the same, apart from durations."""
    names = {str(path.relative_to(whole)) for path in whole.rglob("*")}
    assert names == {str(path.relative_to(other)) for path in other.rglob("*")}
    for name in names:
        single, two = whole / name, other / name
        if single.is_dir() or single.name in VARIES or single.parent.parent.name == "rows":
            continue
        if single.name == "clip.safetensors":
            a, b = Clip.load(single).tensors(), Clip.load(two).tensors()
            assert a.keys() == b.keys() and all(np.array_equal(a[n], b[n]) for n in a), name
        else:
            assert single.read_bytes() == two.read_bytes(), name


def test_runs_that_are_ended_at_random_go_on(kinds, tmp_path, monkeypatch, capsys):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    chance = random.Random(int(os.environ.get("PHY124_SEED", "0")))
    survived, tried, problems = Counter(), Counter(), []
    for number in range(RUNS):
        kind = kinds[number % len(kinds)]
        name = list(WAYS)[number // len(kinds) % len(WAYS)]
        tried[name] += 1
        with disk(tmp_path / "disk") as folder:
            out, said = folder / kind.whole.name, ""
            try:
                said = WAYS[name](kind, out, chance)
                assert "Traceback" not in said
                is_good(folder)
                kind.finish(out)
                same(kind.whole, out)
                survived[name] += 1
            except Exception as problem:
                problems.append(f"{number} {kind.name}, {name}: {problem!r}\n{said[-2000:]}")
        for kept in temporary.glob("phy124-kept-*"):
            assert f"{kept}" in said
            is_good(kept)
            shutil.rmtree(kept)
    options = [f"{name}: {survived[name]} of {count} survived" for name, count in tried.items()]
    with capsys.disabled():
        sys.stdout.write("\n".join(["", *options, f"{survived.total()} of {tried.total()}", ""]))
    assert not problems, "\n\n".join(problems)
    assert list(temporary.iterdir()) == []
