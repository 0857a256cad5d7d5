"""Renders the videos and pictures of a clip, and writes files for other programs."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from queue import SimpleQueue
from threading import Semaphore
from typing import TYPE_CHECKING, Any

import numpy as np

from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.io.files import staging
from phy124.io.flaws import hide_flaws
from phy124.io.formats.usd import load_usd, write_usd
from phy124.io.html import write_html
from phy124.io.sequence import write_sequence
from phy124.io.video import (
    FPS_RANGE,
    Picture,
    refuse_missing_encoder,
    write_animation,
    write_film,
    write_mp4,
    write_pictures,
)
from phy124.progress import Progress
from phy124.rendering.frames import render_frames
from phy124.rendering.framing import cameras as cameras
from phy124.rendering.framing import still_camera
from phy124.rendering.outputs import refuse_outputs, refuse_unkept, write_outputs
from phy124.rendering.shine import Shine, add_gloss, drawn_frames, make_shine
from phy124.rendering.stage.build import Stage, make_stage, pack_stage
from phy124.runtime.context import RunContext
from phy124.runtime.cores import cores
from phy124.scene import Scene, View

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from phy124.runtime.context import ContextOptions

PathLike = str | os.PathLike[str]
Encoder = Callable[[Path, str, Iterator[Picture], float, View], Path]
Exporter = Callable[[Clip, View, Path, Progress], Path]
MOST_PIXELS = 1 << 23
"""Largest number of pixels that are encoded at the same time, about four full HD pictures."""
WAITING = 4
"""Largest number of pictures that wait in the queue of an encoder."""
NEAR = 0.05
"""A video's end fades into its start if the RMS distance between the positions in the first and in
the last frame is at most this value [object sizes].
"""


def film(
    clip: Clip,
    view: View,
    folder: PathLike,
    context: RunContext | None = None,
    **fields: Unpack[ContextOptions],
) -> list[Path]:
    """Write the files of a view: every format and every output, from each side.

    An encoder keeps several pictures in memory, so only some sides are drawn at the same time if
    pictures are large (`MOST_PIXELS`).

    Args:
        clip: The clip.
        view: Sides, size, background, formats and outputs.
        folder: The folder to write. The folder is created if it does not exist.
        context: Device, number of threads, stopwatch, and a progress function, which is called as
            ("render", pictures done, total pictures), and as ("outputs SIDE", ...).
        **fields: `device`, `threads` and `progress`, if no context is passed.

    Returns:
        The files and folders that were written.

    Raises:
        InputError: The clip lacks the data of an output, a package is missing, or no video can play
            the clip at the view's speed.
    """
    folder, context = Path(folder), RunContext.of(context, **fields)
    watch = context.watch
    refuse_unkept(clip, view)
    if set(view.formats) & PLAYED:
        refuse_rate(clip.fps, view)
    folder.mkdir(parents=True, exist_ok=True)
    with watch.stage("render"):
        stage, shine = make_stage(clip, view, device=context.device), make_shine(clip, view)
    made: dict[tuple[str, str], Path] = {}
    loop = Loop.of(clip, view)
    formats = [name for name in view.formats if name in ENCODERS]
    at_once = max(1, MOST_PIXELS // math.prod((*view.size, max(len(formats), 1))))
    for first in range(0, len(view.sides) if formats else 0, at_once):
        sides = view.sides[first : first + at_once]
        with closing(_images(clip, view, loop, sides, stage, shine, context)) as images:
            made |= _encode_sides(clip, view, loop, first, sides, formats, folder, images, context)
    paths: list[Path] = []
    for name in view.formats:
        if name in EXPORTS:
            with watch.stage("export"):
                paths.append(EXPORTS[name](clip, view, folder, context.progress))
        else:
            paths += [made[name, side] for side in view.sides]
    if shine is not None and shine.seconds:
        # The threads compute gloss at the same time, so the sum of their times is divided.
        seconds = min(shine.seconds / (context.threads or cores()), watch.seconds["render"])
        watch.seconds["shine"] = watch.seconds.get("shine", 0.0) + seconds
        watch.seconds["render"] -= seconds
    if view.outputs:
        with watch.stage("outputs"):
            paths += [write_outputs(clip, view, side, folder, context) for side in view.sides]
    return paths


def _encode_sides(
    clip: Clip,
    view: View,
    loop: Loop,
    first: int,
    sides: Sequence[str],
    formats: Sequence[str],
    folder: Path,
    images: Iterator[Picture],
    context: RunContext,
) -> dict[tuple[str, str], Path]:
    """Encode the videos of some sides; return their paths by format and side. If an encoder fails,
    its exception is raised after the other videos are complete. Pictures are ordered by frame, then
    by side; `first` is the index of `sides[0]` in the view.
    """
    watch, fps = context.watch, playback(clip.fps, view)
    before, total = first * len(loop.order), len(view.sides) * len(loop.order)
    films = {(name, side): Feed() for name in formats for side in sides}
    with watch.stage("encode"), ThreadPoolExecutor(len(films), "encode") as pool:
        for (name, side), feed in films.items():
            feed.task = pool.submit(ENCODERS[name], folder, side, loop.fade_ends(feed), fps, view)
        try:
            for done, image in enumerate(watch.each("render", images)):
                if all(feed.task.done() for feed in films.values()):
                    break  # every encoder failed
                for name in formats:
                    films[name, sides[done % len(sides)]].put(image)
                context.progress("render", before + done + 1, total)
        except BaseException as error:
            for feed in films.values():
                feed.close(error)
            raise
        for feed in films.values():
            feed.close()
        made = {key: feed.task.result() for key, feed in films.items()}
    return made


@dataclass(frozen=True)
class Loop:
    """The order of a video's frames, and the number of last pictures that fade into the start."""

    order: Sequence[int]
    fading: int = 0

    @classmethod
    def of(cls, clip: Clip, view: View) -> Loop:
        """Choose how the video of a view repeats.

        If the cameras stand still and the object nearly returns to its first pose, the end of the
        video fades into its start. If not, the video also runs backwards.
        """
        count = len(clip)
        if not view.seamless or count < 3:
            return cls(range(count))
        away = np.linalg.norm(clip.means[-1] - clip.means[0], axis=1)[clip.object_mask]
        size = float(np.ptp(clip.means[0][clip.object_mask], axis=0).max())
        still = all(len({*cameras(clip, view, side)}) == 1 for side in view.sides)
        if still and float(np.sqrt(np.mean(away**2))) <= NEAR * size:
            return cls(range(count), max(count // 4, 1))
        return cls([*range(count), *range(count - 2, 0, -1)])

    @property
    def pictures(self) -> int:
        """Number of pictures of a video."""
        return len(self.order) - self.fading

    def note(self, view: View) -> list[str]:
        """Return a note that states how a seamless video repeats."""
        if not view.seamless:
            return []
        if self.fading:
            how = f"the last {self.fading} fade into the first"
        else:
            how = "the motion runs forwards and backwards"
        return [f"Seamless videos of {self.pictures} pictures: {how}."]

    def fade_ends(self, images: Iterator[Picture]) -> Iterator[Picture]:
        """Yield the pictures of a video; its last pictures fade into its first pictures."""
        first = list(islice(images, self.fading))
        for index, image in enumerate(islice(images, len(self.order) - self.fading)):
            done = index - (len(self.order) - 2 * self.fading)
            if done >= 0:
                share = (done + 1) / (self.fading + 1)
                mixed = (1 - share) * image + share * first[done]
                image = np.rint(mixed).astype(np.uint8)
            yield image


class Feed(Iterator[Picture]):
    """A queue of the pictures of one video; a thread encodes the pictures."""

    task: Future[Path]

    def __init__(self) -> None:
        self._queue: SimpleQueue[Picture | BaseException] = SimpleQueue()
        self._room = Semaphore(WAITING)

    def put(self, picture: Picture) -> None:
        """Pass a picture to the encoder; wait while `WAITING` pictures are queued."""
        while not self._room.acquire(timeout=0.2):
            if self.task.done():
                return
        self._queue.put(picture)

    def close(self, error: BaseException | None = None) -> None:
        """End the video; if `error` is set, the encoder removes the unfinished video."""
        self._queue.put(error or StopIteration())

    def __next__(self) -> Picture:
        picture = self._queue.get()
        if isinstance(picture, BaseException):
            raise picture
        self._room.release()
        return picture


def _images(
    clip: Clip,
    view: View,
    loop: Loop,
    sides: Sequence[str],
    stage: Stage | None,
    shine: Shine | None,
    context: RunContext,
) -> Generator[Picture, None, None]:
    seen = list(zip(*(cameras(clip, view, side) for side in sides), strict=True))
    moving = shine is not None and shine.needs_velocities
    read = (clip.frame(k, velocities=moving) for k in loop.order)
    frames = context.watch.each("deform", read)
    shown = (frame for frame in frames for _ in sides)
    return render_frames(
        shown,
        chain.from_iterable(seen[k] for k in loop.order),
        background=None if view.stage == "transparent" else view.background,
        light=shine and shine.illuminate,
        stage=stage and stage.at,
        filter=view.filter,
        device=context.device,
        threads=context.threads,
    )


def _encode(ending: str, write: Callable[..., object]) -> Encoder:
    def encode(folder: Path, side: str, images: Iterator[Picture], fps: float, view: View) -> Path:
        path = folder / f"{side}.{ending}"
        small = write is write_animation and view.megabytes
        write(path, images, fps=fps, **({"most": 1e6 * small} if small else {}))
        return path

    return encode


def _png(folder: Path, side: str, images: Iterator[Picture], fps: float, view: View) -> Path:
    del fps, view
    path = folder / f"{side}-png"
    with staging(path) as temporary:
        write_pictures(temporary, images, name=side)
    return path


def _html(clip: Clip, view: View, folder: Path, progress: Progress) -> Path:
    del progress
    write_player(folder / "clip.html", clip, view, view.sides[0])
    return folder / "clip.html"


def write_player(path: PathLike, clip: Clip, view: View, side: str) -> None:
    """Write one HTML file that plays a clip on the stage of a view.

    Args:
        path: The file.
        clip: The clip.
        view: Size, colours and stage of the picture.
        side: Name of the side from which the clip is seen when the player starts.

    Raises:
        InputError: The clip is empty, or the file cannot be written.
    """
    first = still_camera(clip, view, side)
    shown, gloss = add_gloss(clip, view)
    around = pack_stage(make_stage(clip, view), shown, gloss)
    write_html(path, shown, first, background=view.background, stage=around, shine=gloss)


def _export(name: str, write: Callable[..., object]) -> Exporter:
    def export(clip: Clip, view: View, folder: Path, progress: Progress) -> Path:
        clip, _ = hide_flaws(clip)
        write(folder / name, clip, frames=drawn_frames(clip, view), progress=progress)
        return folder / name

    return export


ENCODERS: dict[str, Encoder] = {
    "mp4": _encode("mp4", write_mp4),
    "webm": _encode("webm", write_film),
    "mov": _encode("mov", write_film),
    "webp": _encode("webp", write_animation),
    "gif": _encode("gif", write_animation),
    "png": _png,
}
"""Functions that write the pictures from one side, and return the path of the file or folder."""
PLAYED = {"mp4", "webm", "mov", "webp", "gif"}
"""Formats that have a frame rate: videos and animations."""
SMOOTH = 12.0
"""Frame rate below which slow motion looks choppy [1/s]."""
EXPORTS: dict[str, Exporter] = {
    "usd": _export("clip.usdc", write_usd),
    "ply": _export("clip-ply", write_sequence),
    "html": _html,
}
"""Functions that write the whole clip, and return the path of the file or folder."""


def name_files(view: View) -> set[str]:
    """Return the names of the files, without the folders, that `film` writes."""
    exports = {"usd": "clip.usdc", "html": "clip.html"}
    videos = {f"{side}.{name}" for name in PLAYED.intersection(view.formats) for side in view.sides}
    return videos | {exports[name] for name in view.formats if name in exports}


def playback(fps: float, view: View) -> float:
    """Return the frame rate [1/s] of the video of a clip that has `fps` frames per second."""
    return view.fps or fps * view.speed


def describe_playback(clip: Clip, view: View) -> dict[str, Any]:
    """Return the frame rate [1/s], the speed and the duration [s] of the videos, for the report."""
    shown = playback(clip.fps, view)
    pictures = Loop.of(clip, view).pictures
    return {"fps": shown, "speed": shown / clip.fps, "seconds": pictures / shown}


def film_notes(clip: Clip, view: View) -> list[str]:
    """Return notes on seamless videos, and on slow motion that has too few frames per second."""
    shown, notes = playback(clip.fps, view), Loop.of(clip, view).note(view)
    if view.speed >= 1 or shown >= SMOOTH:
        return notes
    smooth = f"simulate with --fps {min(24 / view.speed, 1000):g} for smooth motion"
    return [*notes, f"Slow motion shows {shown:.3g} frames per second; {smooth}."]


def refuse_unfilmable(scene: Scene) -> None:
    """Refuse a scene whose videos or outputs cannot be made on this machine.

    Raises:
        InputError: No video format has this playback rate, an output is impossible, or a program is
            missing.
    """
    refuse_outputs(scene.view, scene.time.frames)
    refuse_missing_writers(scene.view)
    if set(scene.view.formats) & PLAYED:
        refuse_rate(scene.time.fps, scene.view)


def refuse_rate(fps: float, view: View) -> None:
    """Refuse a view if no video can play a clip of `fps` frames per second at its speed.

    Raises:
        InputError: The frame rate of the video would be outside `FPS_RANGE`.
    """
    shown, (low, high) = playback(fps, view), FPS_RANGE
    if low <= shown <= high:
        return
    limit = f"videos have {low:g} to {high:g} frames per second, not {shown:g}"
    slowest, fastest = math.ceil(1e4 * low / fps) / 1e4, math.floor(1e4 * high / fps) / 1e4
    speeds = f"{max(slowest, 1e-3):g} to {min(fastest, 100.0):g}"
    limit = f"{limit}: with {fps:g} frames per second of motion, view.speed must be from {speeds}."
    field, value = ("view.speed", view.speed) if view.speed != 1 else ("time.fps", fps)
    raise InputError(field, value, limit, f"Set view.speed = {24 / fps:.3g}.")


def refuse_missing_writers(view: View) -> None:
    """Refuse a view whose formats need an encoder or a package that is not installed.

    Raises:
        InputError: The encoder or package is not installed.
    """
    if {"mp4", "webm", "mov"} & {*view.formats}:
        refuse_missing_encoder()
    if "usd" in view.formats:
        load_usd()
