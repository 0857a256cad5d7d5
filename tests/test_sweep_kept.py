"""A sweep that is killed, or fails, loses nothing that was computed, and leaves nothing else."""

import shutil
from pathlib import Path

import pytest

from phy124.errors import Cancelled, InputError
from phy124.io.clip import Clip
from phy124.io.files import MAKING
from phy124.io.ply import write_ply
from phy124.pipeline import PAUSE, recording
from phy124.simulation import Simulation
from phy124.studies.sweep import Plan, Sweep, run, running, work
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage
from support.processes import clips_of
from support.shapes import ball


@pytest.fixture
def plan(tmp_path) -> Plan:
    """Two clips, filmed."""
    write_ply(tmp_path / "ball.ply", ball(80))
    values = {"accuracy.cells": 8, "time.frames": 4, "material.E": [1e4, 1e5]}
    values |= {"view.size": 16}
    data = {"pictures": str(tmp_path / "ball.ply"), "scene": "drop", "films": True}
    return Plan(Sweep.from_data({**data, "set": values}))


def named(out: Path) -> list[str]:
    return sorted(str(path.relative_to(out)) for path in out.rglob("*"))


def test_a_worker_killed_within_a_clip_goes_on_with_it(tmp_path, plan, monkeypatch):
    """The sweep's folder is copied during a frame of the second clip, as a kill would leave it."""
    monkeypatch.setattr(recording, "COST", 1e9)
    whole, killed, begun, left = tmp_path / "whole", tmp_path / "killed", [], []
    step = Simulation._take_frame

    def copying(simulation):
        frame = step(simulation)
        begun.append(frame.index)
        if begun == [0, 1, 2, 3, 0, 1, 2]:
            shutil.copytree(whole, killed)
            left.extend(path.name for path in killed.rglob("pause*"))
        return frame

    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "_take_frame", copying)
        assert run(plan, str(whole), workers=0).ended == {"done": 2}
    assert PAUSE in left and len(left) == 2
    for folder in (killed, next((killed / "rows").iterdir())):
        (folder / ".x-01234567.part.json").touch()
    begun.clear()
    monkeypatch.setattr(Simulation, "_take_frame", lambda run: begun.append(run.count) or step(run))
    assert run(plan, str(killed), workers=0).ended == {"done": 1}
    assert begun == [2, 3]
    assert clips_of(whole) == clips_of(killed)
    assert named(whole) == named(killed)


def test_a_clip_stays_if_its_film_fails(tmp_path, plan, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("no film")

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(work, "film", fail)
        assert run(plan, str(out), workers=0).ended == {"failed": 2}
    assert len([Clip.load(path) for path in out.rglob("clip.safetensors")]) == 2
    assert run(plan, str(out), workers=0).ended == {"done": 2}
    assert not [name for name in named(out) if "pause" in name or "/." in name]


def test_a_missing_encoder_is_refused_before_the_first_clip(tmp_path, plan, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nonexistent")
    monkeypatch.setattr(Simulation, "_take_frame", lambda _: pytest.fail("it began"))
    with pytest.raises(InputError, match="the video encoder, ffmpeg, does not work here"):
        run(plan, str(tmp_path / "out"), workers=0)


def test_ctrl_c_on_a_full_disk_is_still_ctrl_c(tmp_path, plan, monkeypatch):
    """The manifest, which is written last, has no room; the next run makes it."""

    def fail(storage, clips):
        raise OSError(28, "No space left on device")

    def stop(stage, done, total):
        if done == 1:
            raise Cancelled

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(running, "write_manifest", fail)
        with pytest.raises(Cancelled):
            run(plan, str(out), workers=0, progress=stop)
    assert run(plan, str(out), workers=0).here == 1
    assert len(read_manifest(Storage(str(out)))) == 2


@pytest.mark.parametrize("saved", [False, True])
def test_files_of_a_killed_worker_are_removed(tmp_path, plan, saved):
    """A saved state stays, from which the clip can go on."""
    out = tmp_path / "out"
    orders = running._orders(plan, plan.share(1, 1), Storage(str(out)), running.Counts(), "cpu")
    order = next(orders)
    folder = out / order.folder
    (folder / f"{MAKING}a").mkdir(parents=True)
    (folder / "pause-1.frames").write_bytes(b"1")
    if saved:
        (folder / PAUSE).write_bytes(b"1")
    assert work.clean_up(order) and work.clean_up(order)
    files = [name for name in named(out) if (out / name).is_file()]
    assert files == ([f"{order.folder}/{PAUSE}"] if saved else [])
    assert folder.exists() == saved
