"""Filming: turns a clip and a view into videos, pictures and files for other programs."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from itertools import chain, islice
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.io.export import refuse_missing_usd, write_ply_sequence, write_usd
from phy124.io.files import staged
from phy124.io.video import (
    FPS_RANGE,
    Picture,
    refuse_missing_encoder,
    write_animation,
    write_mp4,
    write_pictures,
)
from phy124.progress import Progress, silent
from phy124.rendering.frames import render_frames
from phy124.rendering.framing import cameras as cameras
from phy124.rendering.outputs import refuse_outputs, refuse_unkept, write_outputs
from phy124.rendering.shine import Shine, shine_of
from phy124.rendering.stage.build import Stage, stage_of
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene, View

PathLike = str | os.PathLike[str]


def film(
    clip: Clip,
    view: View,
    folder: PathLike,
    *,
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> list[Path]:
    """Write every format and every output of a view, from each of its sides.

    Each format draws its own pictures, so that none has to wait in memory for another's encoder.

    Args:
        clip: What to film.
        view: Sides, size, background, formats and outputs.
        folder: An existing folder.
        device: Warp's name of the device that draws.
        threads: CPU threads that draw videos and pictures; None: as many as there are cores.
        progress: Called as ("render SIDE", pictures done, pictures in all) for each side, and as
            ("outputs SIDE", ...) where there are any.
        watch: A stopwatch that counts drawing and encoding.

    Returns:
        The files and folders written.

    Raises:
        InputError: The clip has not what an output shows, or a package is missing.
    """
    folder, watch = Path(folder), watch or Stopwatch()
    refuse_unkept(clip, view)
    made, stage, shine = [], stage_of(clip, view, device=device), shine_of(clip, view)
    for name in view.formats:
        if name in EXPORTS:
            with watch.stage("export"):
                made.append(EXPORTS[name](clip, folder, progress))
            continue
        with closing(_images(clip, view, stage, shine, device, threads)) as images:
            for side in view.sides:
                before = watch.seconds.get("render", 0.0)
                with watch.stage("encode"):
                    drawn = watch.each("render", _of_side(images, side, len(clip), progress))
                    made.append(ENCODERS[name](folder, side, drawn, playback(rate(clip), view)))
                watch.seconds["encode"] -= watch.seconds.get("render", 0.0) - before
    if shine is not None and shine.seconds:
        watch.seconds["shine"] = watch.seconds.get("shine", 0.0) + shine.seconds
        watch.seconds["render"] -= shine.seconds
    if view.outputs:
        options: dict[str, Any] = {"device": device, "progress": progress}
        with watch.stage("outputs"):
            made += [write_outputs(clip, view, side, folder, **options) for side in view.sides]
    return made


def _images(
    clip: Clip,
    view: View,
    stage: Stage | None,
    shine: Shine | None,
    device: str,
    threads: int | None,
) -> Generator[Picture, None, None]:
    """The pictures of all sides, one side after the other.

    The first ones of a side are drawn while the encoder still ends the video of the one before.
    """
    seen = [cameras(clip, view, side) for side in view.sides]
    shown = (clip.frames() if shine is None else shine.frames(clip.frames(), one) for one in seen)
    return render_frames(
        chain.from_iterable(shown),
        chain.from_iterable(seen),
        background=None if view.stage == "transparent" else view.background,
        stage=stage and stage.at,
        filter=view.filter,
        device=device,
        threads=threads,
    )


def _of_side(
    images: Iterator[Picture], side: str, count: int, progress: Progress
) -> Iterator[Picture]:
    """The next so many pictures, which are those of a side."""
    for done, image in enumerate(islice(images, count), 1):
        progress(f"render {side}", done, count)
        yield image


def _mp4(folder: Path, side: str, images: Iterator[Picture], fps: float) -> Path:
    path = folder / f"{side}.mp4"
    write_mp4(path, images, fps=fps)
    return path


def _animation(ending: str) -> Encoder:
    def write(folder: Path, side: str, images: Iterator[Picture], fps: float) -> Path:
        path = folder / f"{side}.{ending}"
        write_animation(path, images, fps=fps)
        return path

    return write


def _png(folder: Path, side: str, images: Iterator[Picture], fps: float) -> Path:
    del fps
    path = folder / f"{side}-png"
    with staged(path) as made:
        write_pictures(made, images, name=side)
    return path


def _usd(clip: Clip, folder: Path, progress: Progress) -> Path:
    write_usd(folder / "clip.usdc", clip, progress=progress)
    return folder / "clip.usdc"


def _ply(clip: Clip, folder: Path, progress: Progress) -> Path:
    write_ply_sequence(folder / "clip-ply", clip, progress=progress)
    return folder / "clip-ply"


Encoder = Callable[[Path, str, Iterator[Picture], float], Path]
ENCODERS: dict[str, Encoder] = {
    "mp4": _mp4, "webp": _animation("webp"), "gif": _animation("gif"), "png": _png,
}  # fmt: skip
"""Formats made from the pictures of one side; each returns the file or folder it made."""
PLAYED = {"mp4", "webp", "gif"}
"""Formats that have a playback rate."""
SMOOTH = 12.0
"""Pictures per second from which a motion is seen as one."""
EXPORTS: dict[str, Callable[[Clip, Path, Progress], Path]] = {"usd": _usd, "ply": _ply}
"""Formats made from the whole clip; each returns the file or folder it made."""


def playback(fps: float, view: View) -> float:
    """Pictures per second at which a view shows a motion of so many frames per second."""
    return view.fps or fps * view.speed


def played(clip: Clip, view: View) -> dict[str, Any]:
    """What a report says about the videos: pictures per second, speed, and how long they are."""
    real = rate(clip)
    shown = playback(real, view)
    return {"fps": shown, "speed": shown / real, "seconds": len(clip) / shown}


def choppy(clip: Clip, view: View) -> str | None:
    """A sentence if slow motion shows too few pictures per second, or None."""
    real = rate(clip)
    shown = playback(real, view)
    if view.speed >= 1 or shown >= SMOOTH:
        return None
    smooth = f"simulate with --fps {min(24 / view.speed, 1000):g} for a smooth one"
    return f"Slow motion shows {shown:.3g} pictures per second; {smooth}."


def refuse_unfilmable(scene: Scene) -> None:
    """Make sure that videos can have the rate of a scene, that its outputs can be made, and that
    what writes them is there.

    Raises:
        InputError: They cannot, or something is missing.
    """
    refuse_outputs(scene.view, scene.time.frames)
    refuse_missing_writers(scene.view)
    shown, (low, high) = playback(scene.time.fps, scene.view), FPS_RANGE
    if not low <= shown <= high and set(scene.view.formats) & PLAYED:
        limit = f"at {shown:g} pictures per second no video plays, only at {low:g} to {high:g}."
        field, value = ("view.speed", scene.view.speed)
        if scene.view.speed == 1:
            field, value = ("time.fps", scene.time.fps)
        raise InputError(field, value, limit, f"Set view.speed = {24 / scene.time.fps:.3g}.")


def refuse_missing_writers(view: View) -> None:
    """Make sure that the encoder and the packages that write a view's formats work.

    Raises:
        InputError: One is missing.
    """
    if "mp4" in view.formats:
        refuse_missing_encoder()
    if "usd" in view.formats:
        refuse_missing_usd()


def rate(clip: Clip) -> float:
    """Frames per second at which a clip plays in real time."""
    return float((len(clip) - 1) / (clip.times[-1] - clip.times[0])) if len(clip) > 1 else 24.0
