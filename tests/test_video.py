"""Videos: read back frame by frame, colours and tags included; interrupted, they leave nothing."""

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.io import video
from phy124.io.video import write_animation, write_film, write_mp4
from phy124.rendering.frames import render_frames
from phy124.runtime.failures import Kind, failure
from support.processes import run_program
from support.videos import ffmpeg, read_video, stream


def plain(colour, size=(64, 48)) -> np.ndarray:
    return np.full((size[1], size[0], 3), colour, np.uint8)


@pytest.mark.parametrize("fps", [24, 29.97, 12.5])
def test_count_rate_and_format_read_back(tmp_path, fps):
    path = tmp_path / "a.mp4"
    assert write_mp4(path, (plain((10 * i, 0, 0)) for i in range(11)), fps=fps) == 11
    assert read_video(path).shape == (11, 48, 64, 3)
    about = stream(path)
    assert float(re.search(r"([\d.]+) fps", about)[1]) == fps
    assert "h264 (High)" in about and "yuv420p(tv, bt709, progressive)" in about
    data = path.read_bytes()
    assert 0 < data.find(b"moov") < data.find(b"mdat")  # plays before it has all arrived
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_colours_survive(tmp_path):
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255), (0, 0, 0), (200, 120, 40)]
    write_mp4(tmp_path / "a.mp4", [plain(c) for c in colours for _ in range(3)], fps=24)
    frames = read_video(tmp_path / "a.mp4")
    for i, colour in enumerate(colours):
        error = np.abs(frames[3 * i + 1].astype(int) - colour)
        assert error.max() <= 3
    # The reader above obeys the tags; decoded by hand from the stored bytes it is BT.709 too.
    stored = ("-f", "rawvideo", "-frames:v", "1", "-")
    raw = np.frombuffer(ffmpeg("-v", "error", "-i", tmp_path / "a.mp4", *stored).stdout, np.uint8)
    y, u, v = raw[0], raw[64 * 48], raw[64 * 48 * 5 // 4]
    expected = (16 + 219 * 0.2126, 128 - 224 * 0.2126 / 1.8556, 128 + 224 * 0.5)
    np.testing.assert_allclose([float(y), float(u), float(v)], expected, atol=1.5)


def test_odd_sizes_are_padded_with_the_edge(tmp_path, rng):
    picture = np.zeros((33, 47, 3), np.uint8)
    picture[:, -1], picture[-1] = (255, 255, 255), (255, 255, 255)
    write_mp4(tmp_path / "a.mp4", [picture] * 3, fps=24)
    frames = read_video(tmp_path / "a.mp4")
    assert frames.shape == (3, 34, 48, 3)
    assert frames[1][:, 46:].min() > 200 and frames[1][32:].min() > 200
    assert frames[1][:30, :44].max() < 40  # not rescaled: the white stays at the edge
    write_mp4(tmp_path / "b.mp4", [plain((255, 0, 0), (1, 1))], fps=24)
    assert read_video(tmp_path / "b.mp4").shape == (1, 2, 2, 3)


@pytest.fixture
def processes(monkeypatch) -> list[subprocess.Popen]:
    """Every child process started from here on."""
    started = []

    class Spy(subprocess.Popen):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Spy)
    return started


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, GeneratorExit])
@pytest.mark.parametrize("name", ["a.mp4", "a.gif"])
def test_an_interrupted_video_leaves_nothing_behind(tmp_path, processes, kind, name):
    closed = []

    def pictures():
        try:
            for i in range(5):
                yield plain((i, 0, 0))
            raise kind("stop")
        finally:
            closed.append(True)

    (tmp_path / name).write_bytes(b"older")
    write = write_mp4 if name == "a.mp4" else write_animation
    with pytest.raises(kind):
        write(tmp_path / name, pictures(), fps=24)
    assert closed
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"older"
    assert len(processes) == (name == "a.mp4")
    assert all(p.returncode is not None for p in processes)  # ended and waited for


CTRL_C = """
import os, signal, sys
import numpy as np
from phy124.io.video import write_mp4
signal.signal(signal.SIGINT, lambda *_: os.write(1, b"Ctrl-C "))

def pictures():
    for grey in range(30):
        os.killpg(0, signal.SIGINT)
        yield np.full((64, 64, 3), grey, np.uint8)

print(write_mp4("a.mp4", pictures(), fps=24))
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no signals of process groups")
def test_ctrl_c_of_a_terminal_does_not_end_the_encoder(tmp_path):
    """A terminal sends Ctrl-C also to ffmpeg, but the command decides what it still needs."""
    done = run_program([sys.executable, "-c", CTRL_C], cwd=tmp_path, start_new_session=True)
    assert done.stdout.endswith(" 30\n"), done.stderr
    assert len(read_video(tmp_path / "a.mp4")) == 30


def test_a_wrong_picture_stops_the_renderer_too(tmp_path, three_gaussians):
    frames = [Frame(i, 0.0, three_gaussians) for i in range(50)]
    cameras = [Camera.orbit(0, 0, 1.5, 32 if i < 4 else 34) for i in range(50)]
    images = render_frames(frames, cameras, device="cpu")
    with pytest.raises(ValueError, match=r"\(34, 34, 3\), but must be uint8 \(32, 32\)"):
        write_mp4(tmp_path / "a.mp4", images, fps=24)
    assert not any(t.name.startswith("render") for t in threading.enumerate())
    assert not list(tmp_path.iterdir())


def test_pictures_are_taken_one_by_one(tmp_path, monkeypatch):
    taken, seen = [], []
    monkeypatch.setattr(video, "_check_picture", lambda p, *_: seen.append(len(taken)) or p)

    def pictures():
        for i in range(20):
            taken.append(i)
            yield plain((i, i, i))

    write_mp4(tmp_path / "a.mp4", pictures(), fps=24)
    assert seen == list(range(1, 21))


def test_the_largest_rate_may_have_rounding_errors(tmp_path):
    """The rate of 12 frames at 240 frames per second, computed from their times."""
    fps = 11 / (11 / 240)
    assert fps > video.FPS_RANGE[1]
    assert write_mp4(tmp_path / "a.mp4", [plain(0)], fps=fps) == 1


@pytest.mark.parametrize("write", [write_mp4, write_animation])
def test_refusals(tmp_path, write):
    name = "a.mp4" if write is write_mp4 else "a.webp"
    with pytest.raises(InputError, match="existing folder"):
        write(tmp_path / "missing" / name, [plain(0)], fps=24)
    (tmp_path / f"folder{name}").mkdir()
    with pytest.raises(InputError, match="name of a folder"):
        write(tmp_path / f"folder{name}", [plain(0)], fps=24)
    for fps in (0, -1, 1e-5, float("nan"), float("inf"), 1000):
        with pytest.raises(InputError, match="frames per second"):
            write(tmp_path / name, [plain(0)], fps=fps)
    with pytest.raises(InputError, match="at least one frame"):
        write(tmp_path / name, iter([]), fps=24)
    for wrong in (plain(0).astype(np.float32), plain(0)[..., :2], plain(0)[..., 0]):
        with pytest.raises(ValueError, match="must be uint8"):
            write(tmp_path / name, [wrong], fps=24)
    assert [p.name for p in tmp_path.iterdir()] == [f"folder{name}"]


def test_an_encoder_that_fails_is_noticed(tmp_path, monkeypatch, processes):
    monkeypatch.setattr(video, "ENCODER", ("-preset", "no such preset", "-f", "mp4"))
    pictures = [np.zeros((256, 256, 3), np.uint8)] * 20
    with pytest.raises(InputError, match="no such preset"):
        write_mp4(tmp_path / "a.mp4", pictures, fps=24)
    assert processes[0].returncode
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/bin/sh").exists(), reason="no shell here")
def test_an_encoder_that_stands_still_is_ended(tmp_path, monkeypatch, processes):
    stuck = tmp_path / "stuck"
    stuck.write_text("#!/bin/sh\nexec sleep 600\n")
    stuck.chmod(0o755)
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(stuck))
    monkeypatch.setattr(video, "STUCK", 0.3)
    with pytest.raises(InputError, match=r"encoder stopped after \d+ pictures: no message"):
        write_mp4(tmp_path / "a.mp4", (plain(0) for _ in range(100)), fps=24)
    assert [path.name for path in tmp_path.iterdir()] == ["stuck"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "ENCODER", ("-f", "rawvideo", "/dev/full", *video.ENCODER))
    with pytest.raises(OSError, match="No space left") as full:
        write_mp4(tmp_path / "a.mp4", [plain((9, 9, 9))] * 5, fps=24)
    assert (failure(full.value).kind, failure(full.value).status) == (Kind.DISK, 1)


@pytest.mark.parametrize(("suffix", "unit"), [(".gif", 10), (".webp", 1)])
def test_animations_read_back(tmp_path, suffix, unit):
    path = tmp_path / f"a{suffix}"
    pictures = [plain((250, 10 * i, 5)) for i in range(12)]
    assert write_animation(path, iter(pictures), fps=24) == 12
    with Image.open(path) as image:
        assert image.n_frames == 12 and image.size == (64, 48)
        assert image.info["loop"] == 0
        total = 0
        for i in range(12):
            image.seek(i)
            shown = np.asarray(image.convert("RGB")).astype(int)
            assert np.abs(shown - pictures[i]).max() <= 8
            total += image.info["duration"]
    assert abs(total - 500) <= unit


def test_animation_endings(tmp_path):
    with pytest.raises(InputError, match=r"\.gif or \.webp"):
        write_animation(tmp_path / "a.avi", [plain(0)], fps=24)


@pytest.mark.parametrize("fps", [24, 30, 29.97, 7, 49, 50, 60, 100, 240])
@pytest.mark.parametrize("unit", [1, 10])
def test_durations_add_up_and_browsers_respect_them(fps, unit):
    chosen, durations = video._schedule(100, fps, unit)
    rounding = unit if len(chosen) == 100 else durations[0]
    assert abs(sum(durations) - 100_000 / fps) <= rounding / 2
    assert all(d % unit == 0 and d > 10 for d in durations)
    assert len(chosen) == len(durations) and max(np.diff(chosen), default=1) <= 5
    assert (len(chosen) == 100) == (fps <= (50 if unit == 10 else 90))


def test_a_fast_gif_leaves_out_frames(tmp_path):
    pictures = [plain((250, 10 * k, 5)) for k in range(24)]
    assert write_animation(tmp_path / "a.gif", pictures, fps=100) == 12
    with Image.open(tmp_path / "a.gif") as image:
        for k in range(image.n_frames):
            image.seek(k)
            assert image.info["duration"] == 20
            shown = np.asarray(image.convert("RGB")).astype(int)
            assert np.abs(shown - pictures[2 * k]).max() <= 8
        assert image.n_frames == 12


@pytest.mark.parametrize(
    ("ending", "codec", "decoder"),
    [(".webm", "vp9", ["-c:v", "libvpx-vp9"]), (".mov", "prores (4444)", [])],
)
def test_transparent_films_are_decoded_with_their_alpha(tmp_path, ending, codec, decoder):
    """By ffmpeg: a red square that moves over nothing, half of it half transparent."""
    path, pictures = tmp_path / f"a{ending}", []
    for index in range(4):
        picture = np.zeros((32, 48, 4), np.uint8)
        picture[8:24, 8 * index : 8 * index + 16] = (200, 30, 30, 255)
        picture[16:24, 8 * index : 8 * index + 16, 3] = 128
        pictures.append(picture)
    assert write_film(path, iter(pictures), fps=12) == 4
    program = imageio_ffmpeg.get_ffmpeg_exe()
    shown = run_program([program, "-i", path])
    assert codec in shown.stderr and "12 fps" in shown.stderr and "48x32" in shown.stderr
    command = [
        program,
        "-v",
        "error",
        *decoder,
        "-i",
        path,
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgba",
        "-",
    ]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    decoded = np.frombuffer(raw, np.uint8).reshape(4, 32, 48, 4).astype(int)
    for wanted, result in zip(pictures, decoded, strict=True):
        assert np.abs(result[..., 3] - wanted[..., 3]).mean() < 3
        inside = wanted[..., 3] == 255
        assert np.abs(result[inside][:, :3] - wanted[inside][:, :3]).mean() < 20
