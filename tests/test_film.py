"""Filming: every format, from every side, of every size, is made and can be read back."""

import json
import re
import shutil
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from phy124.errors import InputError
from phy124.io.formats import usd
from phy124.io.ply import read_ply
from phy124.rendering import film as film_module
from phy124.rendering.film import (
    describe_playback,
    film,
    film_notes,
    playback,
    refuse_rate,
    refuse_unfilmable,
)
from phy124.scene import Scene, View
from support.clips import AWAY, flight
from support.videos import read_video

SIZE = (48, 32)


def view(**changes) -> View:
    chosen = {"views": ["front"], "azimuths": [22.5], "size": SIZE, "distance": 1.2} | changes
    return Scene.from_data({"view": chosen}).view


def frames(path) -> list[np.ndarray]:
    with Image.open(path) as opened:
        return [np.asarray(f.convert("RGBA")) for f in ImageSequence.Iterator(opened)]


def picture(path) -> np.ndarray:
    with Image.open(path) as opened:
        return np.asarray(opened)


@pytest.fixture(scope="module")
def clip():
    return flight(AWAY[:3])


def test_all_formats_at_once(tmp_path, clip):
    made = film(clip, view(formats=["mp4", "gif", "webp", "png", "ply"]), tmp_path, device="cpu")
    names = [
        f"{side}.{end}" for end in ("mp4", "gif", "webp") for side in ("front", "azimuth-22.5")
    ]
    assert [path.name for path in made] == [*names, "front-png", "azimuth-22.5-png", "clip-ply"]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(p.name for p in made)
    assert read_video(tmp_path / "front.mp4").shape == (3, 32, 48, 3)
    for name in names[2:]:
        assert [f.shape for f in frames(tmp_path / name)] == [(32, 48, 4)] * 3
    pictures = sorted((tmp_path / "front-png").iterdir())
    assert [p.name for p in pictures] == [f"front_{i:04}.png" for i in (1, 2, 3)]
    assert picture(pictures[0]).shape == (32, 48, 3)
    read = [read_ply(p).gaussians for p in sorted((tmp_path / "clip-ply").iterdir())]
    assert np.allclose([g.means for g in read], clip.means, atol=1e-6)


def test_usd(tmp_path, clip):
    pytest.importorskip("pxr.UsdVol")
    if not hasattr(__import__("pxr.UsdVol").UsdVol, usd.SCHEMA):
        pytest.skip("this usd-core is too old")
    made = film(clip, view(formats=["usd"]), tmp_path, device="cpu")
    assert [path.name for path in made] == ["clip.usdc"]
    assert made[0].stat().st_size > clip.means.nbytes


def test_transparent_pictures_look_alike_on_any_background(tmp_path, clip):
    """Laid over white they are what is filmed on white; a GIF draws a pixel or does not."""
    film(clip, view(formats=["png"]), tmp_path, device="cpu")
    clear = tmp_path / "clear"
    clear.mkdir()
    film(clip, view(formats=["png", "webp", "gif"], stage="transparent"), clear, device="cpu")
    for i in range(3):
        name = f"front-png/front_{i + 1:04}.png"
        over = picture(clear / name).astype(float)
        alpha = over[..., 3:] / 255
        laid = over[..., :3] * alpha + 255 * (1 - alpha)
        assert np.abs(laid - picture(tmp_path / name)).max() <= 2
        gif, webp = (frames(clear / f"front.{end}")[i] for end in ("gif", "webp"))
        assert set(np.unique(gif[..., 3])) == {0, 255}
        assert np.array_equal(gif[..., 3] == 255, over[..., 3] >= 128)
        assert np.array_equal(webp[..., 3], over[..., 3])
        drawn = over[..., 3] == 255
        assert np.abs(gif[drawn, :3] - over[drawn, :3]).mean() < 4
        assert np.abs(webp[drawn, :3] - over[drawn, :3]).mean() < 6


def test_a_transparent_gif_leaves_no_trail(tmp_path):
    """The place where the object was is transparent again in the next frame."""
    clip = flight([(0, -0.4, 0), (0, 0.4, 0)], count=300)
    film(clip, view(formats=["gif"], stage="transparent", azimuths=[]), tmp_path, device="cpu")
    first, last = frames(tmp_path / "front.gif")
    assert first[16, 24 - 8, 3] == 255 and last[16, 24 - 8 - 6, 3] == 0


def test_an_mp4_cannot_be_transparent():
    sentence = "view.stage = transparent: an MP4 cannot be transparent. Choose the format webm"
    with pytest.raises(InputError, match=re.escape(sentence)):
        view(stage="transparent")


@pytest.mark.parametrize(
    ("size", "meant"),
    [(64, (64, 64)), ("64", (64, 64)), ("64x32", (64, 32)), ("64X32", (64, 32)), ([64, 32],) * 2],
)
def test_sizes_are_one_number_or_two(size, meant):
    scene = Scene.from_data({"view": {"size": size}})
    assert scene.view.size == tuple(meant)
    assert Scene.from_data(scene.data()) == scene
    assert scene.data()["view"]["size"] == (meant[0] if meant[0] == meant[1] else list(meant))


@pytest.mark.parametrize(
    "size", [8, "8x512", "big", "1x2x3", [512, 8192], None, {}, True, 64.5, ""]
)
def test_other_sizes_are_refused(size):
    with pytest.raises(InputError, match=r"^view\.size.* = .*([Ww]idth|WIDTH)"):
        Scene.from_data({"view": {"size": size}})


def test_slow_motion_plays_the_same_pictures_longer(tmp_path, clip):
    slow = view(formats=["webp"], azimuths=[], speed=0.25)
    assert playback(24, slow) == 6 and playback(24, view(fps=12)) == 12
    assert describe_playback(clip, slow) == pytest.approx({"fps": 6, "speed": 0.25, "seconds": 0.5})
    film(clip, slow, tmp_path, device="cpu")
    with Image.open(tmp_path / "front.webp") as opened:
        shown = [f.info["duration"] for f in ImageSequence.Iterator(opened) if f.load() or True]
    assert sum(shown) == 500 and len(shown) == 3


def test_choppy_slow_motion_is_noted(clip):
    (warning,) = film_notes(clip, view(speed=0.25))
    assert warning is not None and "6 frames per second" in warning and "--fps 96" in warning
    assert film_notes(clip, view(speed=0.5)) == film_notes(clip, view(fps=2)) == []


@pytest.mark.parametrize(
    ("time", "chosen", "field"), [(1000, {}, "time.fps"), (24, {"speed": 0.002}, "view.speed")]
)
def test_a_rate_that_no_video_has_is_refused_at_once(time, chosen, field):
    scene = Scene.from_data({"time": {"fps": time}, "view": chosen})
    with pytest.raises(InputError, match=f"^{field}") as refused:
        refuse_unfilmable(scene)
    remedy = float(str(refused.value).rpartition("= ")[2].rstrip("."))
    refuse_unfilmable(scene.replaced({"view.speed": remedy}))
    refuse_unfilmable(scene.replaced({"view.formats": ["png"]}))


@pytest.mark.parametrize(("speed", "allowed"), [(100.0, 10.0), (0.004, 0.0042)])
def test_a_speed_that_no_video_of_a_clip_has_is_refused(tmp_path, clip, speed, allowed):
    with pytest.raises(InputError, match=rf"^view\.speed = {speed:g}.*0\.0042 to 10\."):
        film(clip, view(speed=speed), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    refuse_rate(clip.fps, view(speed=allowed))
    film(clip, view(speed=speed, formats=["png"]), tmp_path / "out")


def test_film_makes_its_folder(tmp_path, clip):
    view = Scene().view.model_copy(update={"views": ("front",), "size": (16, 16)})
    (path,) = film(clip, view, tmp_path / "out/new")
    assert path == tmp_path / "out/new/front.mp4" and path.is_file()


@pytest.mark.parametrize(("formats", "left"), [(["mp4", "gif"], 2), (["gif"], 0)])
def test_other_films_stay_if_an_encoder_fails(tmp_path, clip, monkeypatch, formats, left):
    def fail(folder, side, images, fps, view):
        next(images)
        raise InputError("output", side, "it failed.", "Try again.")

    monkeypatch.setitem(film_module.ENCODERS, "gif", fail)
    monkeypatch.setattr(film_module, "WAITING", 1)
    with pytest.raises(InputError, match="it failed"):
        film(clip, view(formats=formats), tmp_path, device="cpu")
    assert len(list(tmp_path.glob("*.mp4"))) == len(list(tmp_path.iterdir())) == left


def _probe(path) -> dict:
    """Return the properties of a film, read by ffprobe, or by ffmpeg if only ffmpeg is
    installed."""
    command = [shutil.which("ffprobe") or "", "-v", "error", "-of", "json", "-show_streams"]
    if command[0]:
        done = subprocess.run([*command, str(path)], capture_output=True, check=True)
        return json.loads(done.stdout)["streams"][0]
    done = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path)], capture_output=True, check=False
    )
    kind, width, height = re.search(
        r"Video: (\w+).*?, (\d+)x(\d+)", done.stderr.decode(errors="replace")
    ).groups()
    return {"codec_name": kind, "width": int(width), "height": int(height)}


@pytest.mark.parametrize("size", [(36, 64), (48, 48)], ids=["vertical", "square"])
def test_ffmpeg_opens_every_film_and_gif_fits(tmp_path, clip, size):
    codecs = {"mp4": "h264", "webm": "vp9", "mov": "prores", "gif": "gif"}
    chosen = view(formats=[*codecs, "webp"], azimuths=[], size=size, megabytes=0.004)
    for path in film(clip, chosen, tmp_path, device="cpu"):
        if (kind := path.suffix[1:]) == "webp":
            assert path.stat().st_size <= 4000 and len(frames(path)) == len(clip)
            continue
        result = _probe(path)
        assert result["codec_name"] == codecs[kind]
        if kind == "gif":
            assert path.stat().st_size <= 4000
        else:
            assert (result["width"], result["height"]) == size


def test_animation_too_small_for_its_frames_is_refused(tmp_path, clip):
    with pytest.raises(InputError) as refused:
        film(clip, view(formats=["webp"], megabytes=1e-9), tmp_path, device="cpu")
    assert refused.value.value == pytest.approx(1e-9) and "24 x 16" in refused.value.limit
    assert not list(tmp_path.iterdir())
    least = float(refused.value.limit.split()[-2])
    film(clip, view(formats=["webp"], megabytes=least), tmp_path, device="cpu")
    assert (tmp_path / "front.webp").stat().st_size <= 1e6 * least


@pytest.mark.parametrize("returns", [False, True], ids=["reversed", "faded"])
def test_seamless_film_ends_as_it_begins(tmp_path, clip, returns):
    """The step from the last picture to the first one is no larger than the others."""
    away = np.sin(np.linspace(0, 1.97 * np.pi, 12)) if returns else np.linspace(0, 1, 12)
    moved = flight([[0, 0.3 * y, 0] for y in away])
    chosen = view(formats=["png"], azimuths=[], seamless=True, follow=False)
    film(moved, chosen, tmp_path, device="cpu")
    shown = [picture(p).astype(float) for p in sorted((tmp_path / "front-png").iterdir())]
    assert len(shown) == (9 if returns else 22)
    steps = [np.abs(a - b).mean() for a, b in zip(shown, [*shown[1:], shown[0]], strict=True)]
    assert steps[-1] <= 1.1 * max(steps[:-1])
    (note,) = film_notes(moved, chosen)
    assert ("fade into" if returns else "forwards and backwards") in note
    assert describe_playback(moved, chosen)["seconds"] == pytest.approx(
        len(shown) / describe_playback(moved, chosen)["fps"]
    )
