"""Writes videos: MP4 for players, WebM, MOV and PNG for editing, GIF and animated WebP for chats.

Frames are streamed into the encoder while they are rendered. MP4 files have the pixel format
yuv420p, in ITU-R BT.709 with limited range, as stated in the tags of the file. Without tags,
players assume BT.709 only for HD videos. The index is at the front of the file, so that playback
can start before the whole file is downloaded.
"""

import errno
import itertools
import os
import subprocess
import tempfile
import threading
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import IO

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import DISK_WORDS, InputError
from phy124.io.files import replacing
from phy124.runtime.signals import without_signals

Picture = NDArray[np.uint8]
FPS_RANGE = (0.1, 240.0)
STUCK = 120.0
"""An encoder that accepts no frame, or does not finish, within this time [s] is killed."""
ENCODER = ("-preset", "veryfast", "-crf", "18", "-movflags", "+faststart", "-f", "mp4")
"""With CRF 18, losses are not visible; slower presets would hardly reduce the file size."""
BT709 = (
    "scale=in_range=full:out_range=limited:out_color_matrix=bt709"
    ":flags=accurate_rnd+full_chroma_int,"
    "setparams=range=limited:color_primaries=bt709:color_trc=bt709:colorspace=bt709"
)
"""Filters that convert RGB to BT.709 with limited range, and state this in the video's tags."""
CODEC = ("-vf", BT709, "-c:v", "libx264", "-pix_fmt", "yuv420p")
VP9 = "-c:v libvpx-vp9 -crf 20 -b:v 0 -deadline good -cpu-used 5 -auto-alt-ref 0 -f webm"
PRORES = "-c:v prores_ks -profile:v 4444 -vendor apl0 -f mov"
FILMS = {
    ".webm": ({3: "yuv420p", 4: "yuva420p"}, VP9),
    ".mov": ({3: "yuv444p10le", 4: "yuva444p10le"}, PRORES),
}
"""For each extension: the encoder's pixel formats for 3 and 4 channels, and its options."""
ANIMATIONS = {".gif": "GIF", ".webp": "WEBP"}
OPAQUE = 128
"""A GIF shows the pixels whose alpha is at least this value; it has no half-transparent pixels."""
SLOWED = 10
"""Browsers show a picture of an animation for 100 ms if its duration is at most this value [ms]."""
SMALLEST = 16
"""Smallest width or height to which an animation is reduced to limit the file size."""
CLEAR = 255
PNG_EFFORT = 3
"""Compression level of PNG files, 0 to 9; higher levels take twice as long and save little."""


def refuse_missing_encoder() -> None:
    """Check that the encoder works.

    Raises:
        InputError: If the encoder is missing or does not work.
    """
    if problem := encoder_problem():
        limit = f"the video encoder, ffmpeg, does not work here ({problem})."
        remedy = (
            "Install imageio-ffmpeg again, or set IMAGEIO_FFMPEG_EXE to an ffmpeg with libx264; "
            "--format png needs none."
        )
        raise InputError("format", "mp4", limit, remedy)


def encoder_problem() -> str:
    """Return the reason why the encoder does not work, or an empty text if it works."""
    try:
        return _problem_of(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        return str(error).partition("\n")[0]


@cache
def _problem_of(program: str) -> str:
    size = 16
    command = [program, *list_source_options(size, size, Fraction(24)), *CODEC, "-f", "null", "-"]
    try:
        with without_signals():
            done = subprocess.run(
                command,
                input=bytes(3 * size * size),
                capture_output=True,
                timeout=STUCK,
                check=False,
            )
    except (OSError, subprocess.SubprocessError) as error:
        return str(error)
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return (lines[0] if lines else f"exit status {done.returncode}") if done.returncode else ""


def write_mp4(path: str | os.PathLike[str], frames: Iterable[Picture], *, fps: float) -> int:
    """Write frames [H,W,3] uint8 as an MP4 file, and return the number of frames.

    H.264 needs an even width and height, so an odd last column or row is repeated. The file is
    written atomically. If `frames` is a generator, it is always closed.

    Raises:
        InputError: If there are no frames, `fps` is out of range, the file cannot be written, or
            the encoder did not finish.
        ValueError: A frame is not uint8 [H,W,3], or its size differs from the first frame's.
    """
    return write_film(path, frames, fps=fps)


def write_film(path: str | os.PathLike[str], frames: Iterable[Picture], *, fps: float) -> int:
    """Write frames as a video that may be transparent, and return the number of frames.

    Args:
        path: Name of the file, which ends in .webm (VP9) or .mov (ProRes 4444); a file of another
            name is an opaque MP4. The file appears only when it is complete.
        frames: RGB or RGBA frames, uint8 [H,W,3] or [H,W,4] with straight alpha; a generator is
            always closed. Odd sizes are padded in the same way as by `write_mp4`.
        fps: Number of frames per second.

    Raises:
        InputError: For the reasons listed at `write_mp4`.
        ValueError: If the type or size of a frame differs from that of the first frame.
    """
    ending = Path(path).suffix.lower()
    with _closing(frames), replacing(path) as temporary:
        _check_rate(fps)
        first, pictures = _peek(frames, (3, 4) if ending in FILMS else (3,))
        padding = [(0, first.shape[0] % 2), (0, first.shape[1] % 2), (0, 0)]
        even = (np.pad(picture, padding, "edge") for picture in pictures)
        codec = [*CODEC, *ENCODER]
        if ending in FILMS:
            formats, words = FILMS[ending]
            codec = ["-vf", BT709, "-pix_fmt", formats[first.shape[2]], *words.split()]
        written = _encode(temporary, path, even, fps, codec)
    return written


def write_animation(
    path: str | os.PathLike[str],
    frames: Iterable[Picture],
    *,
    fps: float,
    most: float | None = None,
) -> int:
    """Write frames (uint8, [H,W,3 or 4]) as a looping .gif or .webp; return how many it shows.

    Times are stored as multiples of 1 ms in WebP, and of 10 ms in GIF, without accumulated rounding
    errors. Above 90 frames per second in WebP, and above 50 in GIF, frames are left out, because
    browsers would slow the animation down. GIF has only 256 colours per frame and no
    half-transparent pixels. All frames are kept in memory.

    Args:
        path: The file, which is written atomically.
        frames: The frames; a generator is always closed.
        fps: Number of frames per second.
        most: Largest size of the file [bytes]; frames are reduced until the file is small enough.

    Raises:
        InputError: If the name ends neither in .gif nor in .webp, there are no frames, `fps` is out
            of range, or the file cannot be written.
        ValueError: A frame is not uint8 [H,W,3 or 4], or its size differs from the first frame's.
    """
    kind = ANIMATIONS.get(Path(path).suffix.lower())
    if kind is None:
        remedy = "Use a name that ends in .gif or .webp, or write an MP4."
        raise InputError("output", path, "animations are GIF or WebP files.", remedy)
    _check_rate(fps)
    with _closing(frames), replacing(path) as temporary:
        convert = _gif_frame if kind == "GIF" else Image.fromarray
        images = [convert(picture) for picture in _peek(frames, channels=(3, 4))[1]]
        clear = {"transparency": CLEAR, "disposal": 2} if images[0].mode == "P" else {}
        chosen, times = _schedule(len(images), fps, 10 if kind == "GIF" else 1)
        images = [images[k] for k in chosen]
        scale, shown = 1.0, images
        smallest = SMALLEST / min(images[0].size)
        while True:
            shown[0].save(
                temporary,
                kind,
                save_all=True,
                append_images=shown[1:],
                duration=times,
                loop=0,
                quality=85,
                **clear,
            )
            written = temporary.stat().st_size
            if most is None or written <= most:
                return len(images)
            if scale <= smallest:
                width, height = shown[0].size
                limit = f"{len(images)} pictures of {width} x {height} take {written / 1e6:g} MB."
                remedy = "Allow at least this size, or film fewer frames."
                raise InputError("megabytes", most / 1e6, limit, remedy)
            scale = max(scale * min((most / written) ** 0.5, 0.95), smallest)
            side = [round(scale * length) for length in images[0].size]
            shown = [image.resize(side) for image in images]


def write_pictures(
    folder: str | os.PathLike[str], frames: Iterable[Picture], *, name: str = "frame"
) -> int:
    """Write frames (uint8, [H,W,3 or 4]) as numbered PNG files, and return the number of frames.

    The files in the existing folder are called `name_0001.png` and so on.

    Raises:
        InputError: If there are no frames or a file cannot be written.
        ValueError: A frame is not uint8 [H,W,3 or 4], or its size differs from the first frame's.
    """
    count = 0
    with _closing(frames):
        for count, picture in enumerate(_peek(frames, channels=(3, 4))[1], 1):
            with replacing(Path(folder) / f"{name}_{count:04}.png") as temporary:
                Image.fromarray(picture).save(temporary, "PNG", compress_level=PNG_EFFORT)
    return count


def _gif_frame(picture: Picture) -> Image.Image:
    """A frame with alpha has 255 colours and a transparent colour."""
    if picture.shape[2] == 3:
        return Image.fromarray(picture)
    image = Image.fromarray(picture[..., :3]).quantize(CLEAR)
    image.paste(CLEAR, mask=Image.fromarray(picture[..., 3] < OPAQUE))
    return image


def _encode(
    temporary: Path, path: object, pictures: Iterator[Picture], fps: float, codec: list[str]
) -> int:
    """imageio's writer is not used: it returns neither the exit code nor the messages of ffmpeg."""
    first = next(pictures)
    height, width, channels = first.shape
    rate = Fraction(fps).limit_denominator(1001)
    program = imageio_ffmpeg.get_ffmpeg_exe()
    command = [program, "-y", *list_source_options(width, height, rate, channels), *codec]
    with tempfile.TemporaryFile() as log:
        with without_signals():
            encoder = subprocess.Popen(
                [*command, os.fspath(temporary)], stdin=subprocess.PIPE, stdout=log, stderr=log
            )
        try:
            sent = _feed(encoder, itertools.chain([first], pictures))
        except BaseException:
            encoder.kill()
            raise
        finally:
            with suppress(OSError):
                _pipe(encoder).close()
            encoder.wait()
        if encoder.returncode:
            log.seek(0)
            silent = f"no message, exit status {encoder.returncode}"
            raise _encoder_error(path, sent, log.read().decode(errors="replace").strip() or silent)
    return sent


def list_source_options(width: int, height: int, rate: Fraction, channels: int = 3) -> list[str]:
    """Return the options that make ffmpeg read raw frames from standard input.

    Args:
        width: Width of the frames, pixels.
        height: Height of the frames, pixels.
        rate: Frames per second.
        channels: Number of colour channels: 3 for RGB, 4 for RGBA.
    """
    kind = "rgba" if channels == 4 else "rgb24"
    return f"-v error -f rawvideo -pix_fmt {kind} -s {width}x{height} -r {rate} -i -".split()


def _feed(encoder: subprocess.Popen[bytes], pictures: Iterator[Picture]) -> int:
    sent = 0
    for picture in pictures:
        try:
            with _ended_if_stuck(encoder):
                _pipe(encoder).write(np.ascontiguousarray(picture).data)
        except OSError:  # the encoder stopped; its exit code and messages show the cause
            break
        sent += 1
    with _ended_if_stuck(encoder):
        with suppress(OSError):
            _pipe(encoder).close()
        encoder.wait()
    return sent


@contextmanager
def _ended_if_stuck(encoder: subprocess.Popen[bytes]) -> Iterator[None]:
    timer = threading.Timer(STUCK, encoder.kill)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _pipe(encoder: subprocess.Popen[bytes]) -> IO[bytes]:
    assert encoder.stdin is not None  # the encoder was started with a pipe
    return encoder.stdin


def _encoder_error(path: object, sent: int, message: str) -> Exception:
    if any(words in message.lower() for words in DISK_WORDS):
        return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    message = " ".join(message.split())
    limit = f"the video encoder stopped after {sent} pictures: {message[:300]}."
    remedy = "The disk may be full: delete some files or choose another folder."
    return InputError("output", path, limit, remedy)


@contextmanager
def _closing(frames: Iterable[Picture]) -> Iterator[None]:
    """Close a generator of frames after the `with` block, so that its threads also end."""
    try:
        yield
    finally:
        if isinstance(frames, Generator):
            frames.close()


def _peek(
    frames: Iterable[Picture], channels: tuple[int, ...] = (3,)
) -> tuple[Picture, Iterator[Picture]]:
    """Return the first frame, and an iterator that checks and yields all frames."""
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        limit = "a video needs at least one frame."
        raise InputError("frames", 0, limit, "Simulate one frame or more.")
    every = itertools.chain([first], pictures)
    return first, (_check_picture(picture, first.shape, channels) for picture in every)


def _check_picture(picture: Picture, shape: tuple[int, ...], channels: tuple[int, ...]) -> Picture:
    fits = picture.shape == shape and len(shape) == 3 and shape[2] in channels
    if picture.dtype != np.uint8 or not fits:
        wanted = " or ".join(map(str, channels))
        raise ValueError(
            f"a picture is {picture.dtype} {picture.shape}, but must be uint8 {shape[:2]} x "
            f"{wanted}"
        )
    return picture


def _check_rate(fps: float) -> None:
    low, high = FPS_RANGE
    # The rate of a clip is computed from its times, and therefore has rounding errors.
    if not low <= round(fps, 6) <= high:  # also refuses NaN
        limit = f"the frame rate of a video must be from {low:g} to {high:g} frames per second."
        raise InputError("fps", fps, limit, "Choose 24.")


def _schedule(count: int, fps: float, unit: int) -> tuple[list[int], list[int]]:
    """Return the indices of the frames that an animation shows, and their durations [ms].

    The durations are multiples of `unit` [ms], as file formats require, and exceed `SLOWED`.
    """
    step = max(1.0, (SLOWED + unit) * fps / 1000)
    shown = max(1, round(count / step))
    ends = np.rint(np.arange(shown + 1) * step * 1000 / fps / unit).astype(int) * unit
    return (np.arange(shown) * step).astype(int).tolist(), np.diff(ends).tolist()
