"""Results of runs that cannot end normally: no disk space, no encoder, a film that fails."""

import errno
import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.io.clip import Clip
from phy124.io.growing import Growing
from phy124.io.ply import write_ply
from phy124.pipeline import run_folder
from phy124.runtime.failures import failure
from support.runs import RESULTS, SCENE, names
from support.shapes import ball

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="no locks, so nothing is recorded"),
    pytest.mark.usefixtures("coarse_solids"),
]


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A folder on a disk of its own in memory, of a size such as 600k; skips where none can be."""
    folder.mkdir()
    try:
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(folder)]
        made = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        made = False
    if not made:
        pytest.skip("this machine lets us mount nothing")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@contextmanager
def full(monkeypatch, *folders: Path, code: int = errno.ENOSPC):
    """Within this context no clip can be written below some folders; `code` is the reason."""

    def refuse(path) -> None:
        if any(Path(path).is_relative_to(folder) for folder in folders):
            raise OSError(code, os.strerror(code))

    def like(path, *arguments, **options):
        refuse(path)
        return begin(path, *arguments, **options)

    def save(clip, path, packed=None) -> None:
        refuse(path)
        saved(clip, path, packed)

    begin, saved = Growing.like, Clip.save
    with monkeypatch.context() as patch:
        patch.setattr(Growing, "like", like)
        patch.setattr(Clip, "save", save)
        yield


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), ValueError("a plugin")])
def test_frames_are_kept_if_filming_fails(tmp_path, monkeypatch, error, capsys):
    def fail(clip, view, folder, context):
        (folder / "front.mp4").touch()
        raise error

    write_ply(tmp_path / "ball.ply", ball(300))
    pipeline.simulate(ball(300), SCENE.replaced({"view.views": ["left"]}), tmp_path / "out")
    command = ["simulate", str(tmp_path / "ball.ply"), "--out", str(tmp_path / "out")]
    command += ["--frames", "2", "--set", "accuracy={cells=8}", "--views", "front", "--size", "32"]
    with monkeypatch.context() as patch:
        patch.setattr(run_folder, "film", fail)
        assert main(command) == 1
    said = capsys.readouterr().err
    assert f"phy124 render {tmp_path / 'out/clip.safetensors'}" in said and "front.mp4" in said
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report == Clip.load(tmp_path / "out/clip.safetensors").report
    assert set(report["files"]) == RESULTS
    assert {name for name in names(tmp_path / "out") if not name.startswith("pause")} == RESULTS
    assert main([*command, "--resume"]) == 0
    assert (tmp_path / "out/front.mp4").stat().st_size and names(tmp_path / "out") == RESULTS


@pytest.mark.parametrize("resumes", [False, True])
def test_a_missing_encoder_is_refused_before_work(tmp_path, monkeypatch, capsys, resumes):
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 3:
            raise Cancelled

    if resumes:
        pipeline.simulate(ball(300), SCENE, tmp_path, progress=stop, keep=True)
    else:
        write_ply(tmp_path / "ball.ply", ball(300))
    before = names(tmp_path)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nonexistent")
    with pytest.raises(InputError, match="the video encoder, ffmpeg, does not work here"):
        if resumes:
            pipeline.go_on(tmp_path)
        else:
            pipeline.simulate(ball(300), SCENE, tmp_path / "out")
    assert names(tmp_path) == before
    assert main(["doctor"]) == 1
    assert "ffmpeg, does not work here" in capsys.readouterr().out


def test_an_encoder_whose_program_is_gone_is_refused(tmp_path, monkeypatch):
    """The error of imageio-ffmpeg if its wheel contains no program."""

    def missing() -> str:
        raise RuntimeError("No ffmpeg exe could be found. Install ffmpeg on your system.\nOr so.")

    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", missing)
    with pytest.raises(InputError, match=r"does not work here \(No ffmpeg exe could be found"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "out")
    assert names(tmp_path) == set()


def test_a_missing_package_is_refused_before_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    scene = SCENE.replaced({"view.formats": ["mp4", "usd"]})
    with pytest.raises(InputError, match="this needs the package usd-core"):
        pipeline.simulate(ball(300), scene, tmp_path / "out")
    assert names(tmp_path) == set()


@pytest.mark.parametrize("command", ["render", "compare"])
def test_finished_sides_stay_if_a_later_one_fails(tmp_path, monkeypatch, capsys, command):
    def write(path, frames, *, fps):
        if path.name == "left.mp4":
            raise OSError(errno.EIO, "no disk")
        return written(path, frames, fps=fps)

    pipeline.simulate(ball(300), SCENE, tmp_path / "a", films=False)
    module = importlib.import_module(
        {"render": "phy124.rendering.film", "compare": "phy124.commands.compare"}[command]
    )
    written = module.write_mp4
    monkeypatch.setattr(module, "write_mp4", write)
    if command == "render":
        monkeypatch.setitem(module.ENCODERS, "mp4", module._encode("mp4", write))
    clip, out = str(tmp_path / "a/clip.safetensors"), tmp_path / "out"
    inputs = [clip] if command == "render" else [clip, clip]
    options = ["--views", "front", "left", "--size", "32", "--device", "cpu", "--out", str(out)]
    assert main([command, *inputs, *options]) == 1
    said = capsys.readouterr().err
    assert "no disk" in said and "Errno 5" in said
    if command == "render":
        assert f"kept in {out}: front.mp4" in said
        assert names(out) == {"front.mp4"}
    else:
        assert "views that were not filmed are missing" in said
        assert names(out) == {"front.mp4", "comparison.json"}


@pytest.mark.filterwarnings("ignore:the frames are kept in memory only")
@pytest.mark.parametrize("done", [3, None], ids=["interrupted", "whole"])
def test_results_go_where_there_is_room(tmp_path, monkeypatch, temporary, done):
    def stop(stage: str, now: int, total: int) -> None:
        if (stage, now) == ("simulate", done):
            raise Cancelled

    with full(monkeypatch, tmp_path / "out"), pytest.raises(Incomplete) as caught:
        pipeline.simulate(ball(300), SCENE, tmp_path / "out", progress=stop, keep=True)
    (kept,) = temporary.iterdir()
    assert failure(caught.value).status == (130 if done else 1)
    assert f"phy124 render {kept / 'clip.safetensors'}" in str(caught.value)
    assert len(Clip.load(kept / "clip.safetensors")) == (done or 6)
    assert not (tmp_path / "out").exists()
    if done:
        assert f"--out {kept} --resume" in str(caught.value)
        assert pipeline.go_on(kept, SCENE).report["complete"]
        assert names(kept) == RESULTS


@pytest.mark.filterwarnings("ignore:the frames are kept in memory only")
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EROFS])
def test_loss_of_all_frames_is_reported(tmp_path, monkeypatch, temporary, code):
    lost = rf"the frames could not be saved .*{os.strerror(code)}.*TMPDIR"
    with full(monkeypatch, tmp_path, code=code), pytest.raises(Incomplete, match=lost) as caught:
        pipeline.simulate(ball(300), SCENE, tmp_path / "out", keep=True)
    assert ("space" in str(caught.value)) == (code == errno.ENOSPC)
    assert list(temporary.iterdir()) == [] and not (tmp_path / "out").exists()


@pytest.mark.filterwarnings("ignore:the results need about")
@pytest.mark.filterwarnings("ignore:the state of the run cannot be written")
@pytest.mark.filterwarnings("ignore:the frames are kept in memory only")
def test_results_of_a_full_disk_are_kept_elsewhere(tmp_path, temporary, every_frame):
    with small_disk(tmp_path / "disk", "300k") as disk:
        with pytest.raises(Incomplete, match=r"clip\.safetensors` makes the videos") as caught:
            pipeline.simulate(ball(900), SCENE, disk / "out", keep=True)
        assert names(disk) == set(), "nothing half-written stays"
    (kept,) = temporary.glob("phy124-kept-*")
    assert str(kept) in str(caught.value)
    assert {"clip.safetensors", "report.json", "scene.toml"} <= names(kept) < RESULTS
    assert len(Clip.load(kept / "clip.safetensors")) == 6
    assert set(json.loads((kept / "report.json").read_text())["files"]) == names(kept)


def test_lack_of_disk_space_is_reported_before_work(tmp_path, monkeypatch):
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate":
            raise Cancelled

    usage = shutil.disk_usage(tmp_path)._replace(free=307_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with (
        pytest.warns(UserWarning, match=r"the results need about .*, but .* has only 307.0 kB"),
        pytest.raises(Cancelled),
    ):
        pipeline.simulate(ball(900), SCENE, tmp_path / "out", progress=stop)


@pytest.mark.filterwarnings("ignore:the results need about")
@pytest.mark.filterwarnings("ignore:the frames are kept in memory only")
def test_an_interruption_while_the_disk_is_full_keeps_the_frames(tmp_path, temporary):
    def stop(stage: str, done: int, total: int) -> None:
        if (stage, done) == ("simulate", 5):
            raise Cancelled

    with small_disk(tmp_path / "disk", "100k") as disk:
        with pytest.raises(Incomplete) as caught:
            pipeline.simulate(ball(900), SCENE, disk / "out", progress=stop, keep=True)
        assert names(disk) == set()
    (kept,) = temporary.iterdir()
    assert failure(caught.value).status == 130 and str(kept) in str(caught.value)
    assert len(Clip.load(kept / "clip.safetensors")) == 5


def test_a_folder_that_became_read_only_hides_no_sentence(tmp_path, every_frame, temporary):
    """The pause cannot be removed; where the results are must be said all the same."""
    with pytest.MonkeyPatch.context() as patch:

        def each(run, frame) -> None:
            if frame.index == SCENE.time.frames - 1:
                patch.setattr(Path, "unlink", refuse)
                patch.setattr(os, "link", refuse)
                patch.setattr(Clip, "save", only_in_temporary)

        def refuse(*_, **__) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        saved = Clip.save

        def only_in_temporary(clip, path, packed=None) -> None:
            saved(clip, path, packed) if Path(path).is_relative_to(temporary) else refuse()

        with pytest.raises(Incomplete, match=r"are kept in .*phy124-kept-"):
            pipeline.simulate(ball(300), SCENE, tmp_path / "out", each=each)
    assert list(temporary.glob("phy124-kept-*/clip.safetensors"))
