"""Videos read back with the ffmpeg that wrote them."""

import re
import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np


def ffmpeg(*arguments, check: bool = True) -> subprocess.CompletedProcess:
    command = [imageio_ffmpeg.get_ffmpeg_exe(), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, check=check)


def stream(path: Path) -> str:
    """Return ffmpeg's description of the video stream."""
    answer = ffmpeg("-i", path, check=False).stderr.decode()  # fails: no output file
    return next(line for line in answer.splitlines() if "Video:" in line)


def read_video(path: Path) -> np.ndarray:
    """Return all frames [T,H,W,3], decoded according to the file's tags."""
    width, height = map(int, re.search(r", (\d+)x(\d+)", stream(path)).groups())
    raw = ffmpeg("-v", "error", "-i", path, "-pix_fmt", "rgb24", "-f", "rawvideo", "-").stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)
