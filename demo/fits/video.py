"""Check visitors' videos, and decode them to small pictures."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from PIL import Image
from pydantic import Field

from phy124.errors import InputError
from phy124.io.files import staging
from phy124.runtime import isolated
from phy124.runtime.isolated import Deadline, Unfinished
from phy124.schema.refusals import shorten, validate
from phy124.schema.section import Section
from phy124.studies.fit.video import is_film, read_film

from ..settings import Settings

try:
    import resource
except ImportError:  # Windows
    resource = None

MEMORY = 3 << 30
"""Memory limit of the process that reads a video, including its decoder [bytes]."""
SHORTER = "Send a shorter or smaller video."
Side = Literal["front", "right", "back", "left"]


@dataclass(frozen=True)
class Seen:
    """A decoded video."""

    folder: Path
    """Folder of the pictures that fall within the scene's duration."""
    fps: float | None
    """Pictures per second of real time; None if the rate is unknown."""
    count: int
    whole: int
    """Number of pictures in the whole video."""


def check_video(path: Path, settings: Settings) -> None:
    """Check the file size and the header of a video.

    Raises:
        InputError: The file is too large, or is not a video.
    """
    if path.stat().st_size > settings.max_video_mb * 1e6:
        limit = f"The video is larger than {settings.max_video_mb:g} MB, the limit of this page."
        raise InputError("video", path.name, limit, SHORTER)
    if not is_film(path):
        limit = "It is not an MP4, MOV, WebM, MKV, AVI, GIF or animated WebP."
        raise InputError("video", path.name, limit, "Send a video.")


def read_video(path: Path, out: Path, seconds: float, speed: float, deadline: Deadline) -> Seen:
    """Decode a video in a separate process.

    Args:
        path: Path of the video.
        out: The folder for the decoded pictures.
        seconds: Duration of the scene [s]. Later pictures are ignored.
        speed: Playback speed of the video. 1 is real time.
        deadline: Time at which decoding is stopped.

    Raises:
        InputError: The video cannot be read, or has fewer than two pictures.
    """
    shutil.rmtree(out, ignore_errors=True)
    try:
        return isolated.run(
            _read_video,
            path,
            out,
            seconds,
            speed,
            deadline.seconds,
            deadline=deadline,
            memory=MEMORY,
        )
    except Unfinished as error:
        limit = f"Reading the video {str(error).partition(' (')[0]}."
    except MemoryError:
        limit = f"The video needs more than {MEMORY >> 30} GB of memory, the limit of this server."
    raise InputError("video", path.name, limit, SHORTER)


def _read_video(path: Path, out: Path, seconds: float, speed: float, processor: float) -> Seen:
    """Decode a video; a limit on CPU time ends the decoder even if this process is killed."""
    if resource is not None:
        most = math.ceil(processor) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (most, most))
    film = read_film(path)
    fps = film.fps and film.fps / speed
    whole = len(film.pictures)
    # The last picture must not be excluded by rounding errors.
    count = whole if fps is None else min(whole, math.floor(seconds * fps + 1e-3) + 1)
    if count < 2:
        limit = f"The scene lasts {seconds:.2f} s; the video has only {count} picture in this time."
        raise InputError("video", path.name, limit, "Choose more frames for the scene.")
    with staging(out) as folder:
        for number in range(count):
            Image.fromarray(film.pictures[number]).save(folder / f"{number:05d}.png")
    return Seen(out, fps, count, whole)


class FitOptions(Section):
    """Options of a fit to a video."""

    seconds: float = Field(default=180.0, ge=5, le=36_000)
    """Longest duration of the search [s]."""
    side: Side = "front"
    """Side of the object that the video shows."""
    speed: float = Field(default=1.0, ge=0.01, le=10)
    """Playback speed of the video: 1 is real time, 0.25 is slow motion."""


def fit_options_of(data: Any, settings: Settings) -> FitOptions:
    """Validate the options of a fit that a request contains.

    Raises:
        InputError: A value is invalid. The message names the value.
    """
    most = settings.max_fit_seconds
    values = {"seconds": min(FitOptions.model_fields["seconds"].default, most)}
    values |= {name: data[name] for name in FitOptions.model_fields if data.get(name) is not None}
    # The time limit of the server is checked before the declared bounds.
    if isinstance(values["seconds"], int | float) and values["seconds"] > most:
        limit = f"A fit may take at most {most:g} s on this page."
        raise InputError("seconds", shorten(values["seconds"]), limit, "Choose a shorter duration.")
    return validate(FitOptions, values, "fit")
