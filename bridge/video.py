"""H.264 video as Foxglove expects it: Annex B, one access unit per picture, no B frames.

ffmpeg encodes without look-ahead. The chunks of ffmpeg's AVI stream state their length. The reader
therefore knows that a picture is complete before the next picture is sent.
"""

from __future__ import annotations

import struct
import subprocess
from fractions import Fraction
from types import TracebackType
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.runtime.signals import without_signals

if TYPE_CHECKING:
    from typing_extensions import Self

PRESET = "-preset ultrafast -tune zerolatency -crf 20"
STREAM = "-bf 0 -fps_mode passthrough -x264-params aud=1:repeat-headers=1 -flush_packets 1 -f avi -"
PROBE = "-probesize 32 -analyzeduration 0"
"""Options that make ffmpeg encode without waiting for further pictures."""
CHUNK = struct.Struct("<4sI")
"""Header of a chunk in the AVI stream of ffmpeg: the chunk's name and length."""
LISTS = (b"RIFF", b"LIST")


class H264Encoder:
    """Encodes pictures one by one; every `fps`-th picture is a key frame with parameter sets."""

    def __init__(self, width: int, height: int, fps: float) -> None:
        import imageio_ffmpeg

        from phy124.io.video import CODEC, list_source_options

        rate = Fraction(fps).limit_denominator(1001)
        even = width + width % 2, height + height % 2
        self._padding = [(0, even[1] - height), (0, even[0] - width), (0, 0)]
        command = [
            imageio_ffmpeg.get_ffmpeg_exe(),
            *PROBE.split(),
            *list_source_options(*even, rate),
            *CODEC,
            *PRESET.split(),
            *("-g", str(max(round(fps), 1))),
            *STREAM.split(),
        ]
        with without_signals():
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            _open(pipe).close()
        self._process.wait()

    def encode(self, picture: NDArray[np.uint8]) -> bytes:
        """Return the access unit of the next picture [H,W,3].

        Raises:
            InputError: The encoder has stopped.
        """
        data = np.ascontiguousarray(np.pad(picture, self._padding, "edge"))
        try:
            _open(self._process.stdin).write(data.data)
            _open(self._process.stdin).flush()
            return self._read_picture()
        except (OSError, EOFError) as error:
            limit = f"the video encoder stopped (exit status {self._process.wait()})."
            raise InputError("images", "h264", limit, "Remove h264.") from error

    def _read_picture(self) -> bytes:
        while True:
            name, size = CHUNK.unpack(self._read(CHUNK.size))
            if name in LISTS:
                self._read(4)  # the chunks of the list follow
                continue
            data = self._read(size + size % 2)[:size]
            if name == b"00dc":
                return data

    def _read(self, size: int) -> bytes:
        data = _open(self._process.stdout).read(size)
        if len(data) < size:
            raise EOFError
        return data


def _open(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None  # the process was started with pipes
    return pipe
