"""Broken files through the command line: one sentence and a status, never a traceback or debris."""

import io
import json
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.io.ply import write_ply
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.hostile import cut, flip
from support.processes import run_program
from support.shapes import ball
from support.solids import coarse

pytestmark = pytest.mark.usefixtures("coarse_solids")

STATUSES = {0, 1, 2, 3}
"""Done, refused by the machine, refused by us, stopped early."""
QUICK = ["--set", "accuracy={cells=6}", "--frames", "2", "--size", "16", "--views", "front"]


def flip_head(data: bytes, rng: random.Random) -> bytes:
    """A byte of the beginning is another."""
    damaged = bytearray(data)
    damaged[rng.randrange(min(400, len(damaged)))] = rng.randrange(256)
    return bytes(damaged)


def insert(data: bytes, rng: random.Random) -> bytes:
    """Foreign bytes in between."""
    at = rng.randrange(min(600, len(data)))
    return data[:at] + rng.randbytes(rng.choice([1, 7, 100])) + data[at:]


def number(data: bytes, rng: random.Random) -> bytes:
    """A digit of the beginning is many nines, a minus, NaN or infinity."""
    digits = [i for i, byte in enumerate(data[:600]) if chr(byte).isdigit()]
    if not digits:
        return b""
    at = rng.choice(digits)
    return data[:at] + rng.choice([b"9" * 30, b"-1", b"nan", b"inf", b"1e999"]) + data[at + 1 :]


def noise(data: bytes, rng: random.Random) -> bytes:
    """Anything at all."""
    return rng.randbytes(rng.choice([0, 1, 100, 5000]))


DAMAGES = (cut, noise, flip_head, insert, number, flip)


@pytest.fixture(scope="module")
def samples(tmp_path_factory) -> dict[str, bytes]:
    """One good file of each kind."""
    folder = tmp_path_factory.mktemp("samples")
    write_ply(folder / "object.ply", ball(150))
    scene = Scene().replaced({"accuracy": {"cells": 6}, "time.frames": 2})
    with coarse():
        run = Simulation(prepare(ball(150), scene))
    run.run().save(folder / "clip.safetensors")
    y, x = np.mgrid[:48, :48]
    disc = (((x - 24) ** 2 + (y - 24) ** 2) < 300)[..., None] * np.uint8([200, 90, 40, 255])
    png, jpeg = io.BytesIO(), io.BytesIO()
    Image.fromarray(disc.astype(np.uint8)).save(png, "png")
    Image.fromarray(disc.astype(np.uint8)[..., :3]).save(jpeg, "jpeg")
    return {
        "object.ply": (folder / "object.ply").read_bytes(),
        "scene.toml": Scene.named("press").to_toml().encode(),
        "picture.png": png.getvalue(),
        "picture.jpg": jpeg.getvalue(),
        "clip.safetensors": (folder / "clip.safetensors").read_bytes(),
    }


def arguments_for(name: str, folder: Path) -> list[str]:
    """Return the command with which a user passes such a file to the program."""
    path, out = str(folder / name), ["--out", str(folder / "out"), "--device", "cpu", "--json"]
    if name.endswith(".ply"):
        return ["simulate", path, *QUICK, *out]
    if name.endswith(".toml"):
        return ["effects", path, "--json"]
    if name.endswith(".safetensors"):
        return ["render", path, "--views", "front", "--size", "16", *out]
    method = ["--foreground", "grabcut"] if name.endswith(".jpg") else []  # loads no network
    return ["generate", path, "--gaussians", "500", *QUICK, *method, *out]


def damaged(name: str, samples: dict[str, bytes], folder: Path, seed: int) -> list[str]:
    """Write a damaged file; the command that takes it."""
    rng = random.Random(f"{name} {seed}")
    folder.mkdir()
    data = DAMAGES[seed % len(DAMAGES)](samples[name], rng)
    (folder / name).write_bytes(data)
    return arguments_for(name, folder)


def sound(folder: Path, name: str, status: int, printed: str) -> None:
    """One JSON text, no traceback, nothing half-written."""
    assert status in STATUSES, printed
    answer = json.loads(printed)
    if status in (1, 2):
        assert len(answer["error"]) > 20
    left = {path.name for path in folder.rglob("*") if path.is_file()} - {name}
    whole = not left or {"front.mp4"} <= left
    assert whole, left
    assert not [n for n in left if n.startswith(".") or ".part" in n or "making" in n], left


def test_undamaged_files_are_accepted(samples, tmp_path, capsys):
    """The control: if the command itself were wrong, every file would be refused."""
    for name, data in samples.items():
        folder = tmp_path / Path(name).suffix[1:]
        folder.mkdir()
        (folder / name).write_bytes(data)
        assert main(arguments_for(name, folder)) == 0, capsys.readouterr()
        sound(folder, name, 0, capsys.readouterr().out)
        assert name == "scene.toml" or (folder / "out/front.mp4").is_file()


@pytest.mark.filterwarnings("ignore:.* may be a file of ")  # a guess about what is not broken
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("object.ply", 6),
        ("scene.toml", 12),
        ("picture.png", 4),
        ("picture.jpg", 3),
        ("clip.safetensors", 6),
    ],
)
def test_broken_files_are_refused_in_a_sentence(name, count, samples, tmp_path, capsys):
    for seed in range(count):
        folder = tmp_path / str(seed)
        status = main(damaged(name, samples, folder, seed))
        sound(folder, name, status, capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* may be a file of ")
@pytest.mark.parametrize("name", ["object.ply", "scene.toml", "picture.png", "clip.safetensors"])
def test_many_broken_files(name, samples, tmp_path, capsys):
    """300 of each kind in one process, and 12 in processes of their own for the exit status."""
    for seed in range(1000, 1300):
        folder = tmp_path / str(seed)
        status = main(damaged(name, samples, folder, seed))
        sound(folder, name, status, capsys.readouterr().out)
    for seed in range(2000, 2012):
        folder = tmp_path / str(seed)
        arguments = damaged(name, samples, folder, seed)
        run = run_program([sys.executable, "-m", "phy124", *arguments])
        assert "Traceback" not in run.stderr, run.stderr
        sound(folder, name, run.returncode, run.stdout)
