"""Reads a video or a folder of images, and separates the object from its background."""

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.decoding import turn_upright
from phy124.runtime.signals import without_signals
from phy124.studies.fit.observation import Values

FILMS = (".mp4", ".webm", ".mov", ".mkv", ".avi", ".gif", ".webp")
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
DIFFERS = 20.0
"""Smallest distance between the colours of object and background in RGB; the maximum is 442."""
MOST = 2000
SIDE = 256
"""Longest side of frames in memory [pixels]; 2,000 frames then take 400 MB."""
LONGEST = 600
"""Maximum time for reading a video [s]."""
FIRST = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
"""Bytes 5 to 8 of MP4 and MOV files."""
SAFE = ("-protocol_whitelist", "file,pipe", "-format_whitelist", "mov,matroska,avi")
"""Options that prevent ffmpeg from reading playlists, which may refer to other addresses."""
PPM = re.compile(rb"P6\s(\d+)\s(\d+)\s255\s")
FPS = re.compile(rb"Video: .* ([\d.]+) fps")


class Film(NamedTuple):
    """Frames of a video, and a mask that shows the object in each frame."""

    masks: NDArray[np.bool_]
    pictures: NDArray[np.uint8]
    """Frames composited over white [T,H,W,3]."""
    fps: float | None
    """Frame rate in the file [frames/s], if any."""


def read_film(path: Path) -> Film:
    """Read a video, or a folder of images in the order of their names.

    Raises:
        InputError: The video or folder cannot be read, its frames differ in size, or a frame shows
            no object.
    """
    drawn, fps = (list(_folder(path)), None) if path.is_dir() else _frames(path)
    if len(drawn) < 2:
        limit = f"it has {len(drawn)} readable frames."
        raise InputError("target", path, limit, "Give a video, or a folder of PNG files.")
    if len({picture.shape[:2] for picture in drawn}) > 1:
        raise InputError(
            "target", path, "its pictures have different sizes.", "Give pictures of the same size."
        )
    masks = np.stack([_mask(picture) for picture in drawn])
    empty = np.flatnonzero(~masks.any(axis=(1, 2)))
    if len(empty):
        limit = f"picture {empty[0]} shows no object in front of its background."
        remedy = (
            "Film the object in front of a plain colour, or give a folder of PNG files with "
            "transparency."
        )
        raise InputError("target", path, limit, remedy)
    return Film(masks, np.stack([_on_white(picture) for picture in drawn]), fps)


def _frames(path: Path) -> tuple[list[NDArray], float | None]:
    if path.suffix.lower() in (".gif", ".webp"):
        return _read_animation(path)
    if not is_film(path):
        raise _unreadable(path)
    import imageio_ffmpeg

    program = imageio_ffmpeg.get_ffmpeg_exe()
    command = [program, "-v", "error", *SAFE, "-i", str(path), "-frames:v", str(MOST + 1)]
    fitting = f"scale=w='min({SIDE},iw)':h='min({SIDE},ih)':force_original_aspect_ratio=decrease"
    command += ["-vf", fitting, "-fps_mode", "passthrough", "-f", "image2pipe", "-c:v", "ppm", "-"]
    try:
        # Without an output file, ffmpeg prints a description of the video and exits with an error.
        with without_signals():
            description = subprocess.run(
                [program, *SAFE, "-i", str(path)], check=False, capture_output=True, timeout=LONGEST
            )
            made = subprocess.run(command, capture_output=True, check=True, timeout=LONGEST)
    except (OSError, RuntimeError, subprocess.SubprocessError):
        raise _unreadable(path) from None
    pictures = list(_pictures(made.stdout))
    _refuse_endless(path, len(pictures))
    fps = FPS.search(description.stderr)
    return pictures, float(fps[1]) if fps else None


def _pictures(stream: bytes) -> Iterator[NDArray]:
    place = 0
    while match := PPM.match(stream, place):
        width, height = int(match[1]), int(match[2])
        place = match.end() + 3 * width * height
        flat = np.frombuffer(stream[match.end() : place], np.uint8)
        yield flat.reshape(height, width, 3)


def _read_animation(path: Path) -> tuple[list[NDArray], float | None]:
    from PIL import ImageSequence

    try:
        with Image.open(path) as file:
            _refuse_endless(path, getattr(file, "n_frames", 1))
            pictures, seconds = [], []
            for frame in ImageSequence.Iterator(file):
                pictures.append(_shrink(frame))
                # Pillow reads the duration of a WebP frame when the frame is decoded.
                seconds.append(frame.info.get("duration", 0) / 1000)
    except InputError:
        raise
    except Exception:  # Pillow raises exceptions of many types.
        raise _unreadable(path) from None
    return pictures, len(seconds) / sum(seconds) if sum(seconds) else None


def is_film(path: Path) -> bool:
    """Return whether a file begins with the bytes of a video or animation."""
    with open(path, "rb") as file:
        head = file.read(12)
    within = (head[:4], head[8:12])
    inside = within in ((b"RIFF", b"AVI "), (b"RIFF", b"WEBP"))
    return inside or head[4:8] in FIRST or head[:4] in (b"\x1a\x45\xdf\xa3", b"GIF8")


def _unreadable(path: Path) -> InputError:
    return InputError("target", path, "it is not a readable video.", "Give an MP4 file.")


def _folder(path: Path) -> Iterator[NDArray]:
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES)
    _refuse_endless(path, len(files))
    for file in files:
        try:
            with Image.open(file) as image:
                image.load()
                picture = _shrink(turn_upright(image))
        except Exception:  # Pillow raises exceptions of many types.
            limit = "it is not a readable picture."
            raise InputError("target", file, limit, "Remove this file.") from None
        yield picture


def _shrink(image: Image.Image) -> NDArray[np.uint8]:
    small = image.convert("RGBA")
    small.thumbnail((SIDE, SIDE), reducing_gap=None)
    return np.asarray(small)


def _refuse_endless(path: Path, count: int) -> None:
    if count > MOST:
        raise InputError("target", path, f"it has more than {MOST} frames.", "Shorten the video.")


def _mask(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the mask of the object: pixels that are opaque or, if the whole frame is opaque,
    differ from the median colour of the border.
    """
    if picture.shape[2] == 4 and picture[..., 3].min() < 255:
        return picture[..., 3] > 127
    colour = picture[..., :3].astype(np.float32)
    border = np.concatenate([colour[0], colour[-1], colour[:, 0], colour[:, -1]])
    apart = np.linalg.norm(colour - np.median(border, axis=0), axis=2) > DIFFERS
    from scipy.ndimage import binary_fill_holes

    return np.asarray(binary_fill_holes(apart))


def _on_white(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if picture.shape[2] == 3:
        return picture
    part = picture[..., 3:].astype(np.float32) / 255
    return (picture[..., :3] * part + 255 * (1 - part)).round().astype(np.uint8)


def shrunk(masks: NDArray[np.bool_], size: tuple[int, int]) -> Values:
    """Reduce masks to a size (w, h): return the covered fraction of each pixel [T,h,w]."""
    small = [cv2.resize(m.astype(np.float32), size, interpolation=cv2.INTER_AREA) for m in masks]
    return np.stack(small).astype(np.float64)
