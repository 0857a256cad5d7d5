"""Videos of visitors: checked, then decoded in a process with limits, kept as small pictures."""

from __future__ import annotations

import math
import resource
import shutil
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from phy124.errors import InputError
from phy124.io.files import staging
from phy124.runtime import isolated
from phy124.runtime.isolated import Deadline, Unfinished
from phy124.studies.fit.video import is_film, read_film

from ..settings import Settings

MEMORY = 3 << 30
"""Memory that the process and its decoder may take each [bytes]."""
SHORTER = "Send a shorter or smaller one."


@dataclass(frozen=True)
class Seen:
    """A video as it is fitted to."""

    folder: Path
    """Its pictures, as far as the scene goes."""
    fps: float | None
    """Pictures per second of what was filmed; None if the file does not say."""
    count: int
    whole: int
    """Number of pictures of the whole video."""


def check_video(path: Path, settings: Settings) -> None:
    """Check the size of a video, and that it begins as one does.

    Raises:
        InputError: It is too large, or something else.
    """
    if path.stat().st_size > settings.max_video_mb * 1e6:
        limit = f"The video is larger than the {settings.max_video_mb:g} MB that this page takes."
        raise InputError("video", path.name, limit, SHORTER)
    if not is_film(path):
        limit = "It is not an MP4, MOV, WebM, MKV, AVI, GIF or animated WebP."
        raise InputError("video", path.name, limit, "Send a video.")


def opened(path: Path, out: Path, seconds: float, speed: float, deadline: Deadline) -> Seen:
    """Decode a video in a process of its own.

    Args:
        path: The video.
        out: The folder to fill with its pictures.
        seconds: How long the scene is [s]; what comes later is left out.
        speed: How fast the video plays; 1 is real time.
        deadline: When to give up.

    Raises:
        InputError: It cannot be read, or shows too little.
    """
    shutil.rmtree(out, ignore_errors=True)
    try:
        return isolated.run(
            _opened, path, out, seconds, speed, deadline.seconds, deadline=deadline, memory=MEMORY
        )
    except Unfinished as error:
        limit = f"Reading the video {str(error).partition(' (')[0]}."
    except MemoryError:
        limit = f"It takes more than the {MEMORY >> 30} GB of memory that a video may take here."
    raise InputError("video", path.name, limit, SHORTER)


def _opened(path: Path, out: Path, seconds: float, speed: float, processor: float) -> Seen:
    """What `opened` does, in this process, whose time it limits for good.

    The decoder inherits the limits of memory and time: it ends even if this process is killed
    before it.
    """
    most = math.ceil(processor) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (most, most))
    film = read_film(path)
    fps = film.fps and film.fps / speed
    whole = len(film.pictures)
    # One picture at the very end of the scene may be late by a rounding error.
    count = whole if fps is None else min(whole, math.floor(seconds * fps + 1e-3) + 1)
    if count < 2:
        limit = f"The scene lasts {seconds:.2f} s, in which the video shows {count} picture."
        raise InputError("video", path.name, limit, "Choose more frames for the scene.")
    with staging(out) as folder:
        for number in range(count):
            Image.fromarray(film.pictures[number]).save(folder / f"{number:05d}.png")
    return Seen(out, fps, count, whole)
