"""Describe a clip, a recording, or this machine's capabilities, in lines of plain text."""

from __future__ import annotations

import os
import sys
from collections import Counter
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from phy124.io.clip import Clip

from . import PROGRAM, bag
from .backends import AUTOMATIC, REQUIREMENTS, missing, sink_names
from .layout import FULL, SMALL, VIZ
from .recover import channels, records
from .sinks.mcap import require_mcap
from .topics import MAIN

WANTED_BUFFER = 4 << 20
"""Receive buffer that can store a frame of 65,536 points of 60 bytes each [bytes]."""
SHARED = (("NumPy", "numpy", 2), ("OpenCV", "cv2", 4))
"""Name, module and newest major version (for Lyrical) of the packages that phy124 and ROS 2 share.
"""
NUMPY_1 = ("humble", "jazzy", "kilted")
"""Distributions of ROS 2 whose packages are built for NumPy 1."""
OPTIONAL = {
    "simulation_interfaces": "`live` offers ~/step and ~/reset (std_srvs) instead of its services",
    "splat_interfaces": "rclpy cannot publish the profile `splats`",
    "point_cloud_interfaces": "rclpy cannot publish points compressed by Draco",
    "foxglove_msgs": "rclpy cannot publish the h264 pictures of cameras",
}
"""Features that are missing if a ROS 2 package is not installed, by package."""
BUFFERS = Path("/proc/sys/net/core")
SHORT = {
    "rmem_max": "too small for 65,536 points per frame",
    "rmem_default": "the limit for Fast DDS: too small for 32,768 points per frame on a "
    "busy machine",
}
"""For each setting of the receive buffer, the consequence of a value below `WANTED_BUFFER`."""


def describe(path: Path) -> list[str]:
    """Describe a clip or a recording.

    Raises:
        InputError: The path is neither a clip nor a recording.
    """
    if path.is_dir() or path.suffix in (bag.SUFFIX, bag.PART, bag.SQLITE):
        return describe_recording(path)
    return describe_clip(Clip.load(path))


def describe_clip(clip: Clip) -> list[str]:
    """Describe a clip: number of frames and points, error bound, and message sizes."""
    from phy124.accuracy.promises import Promise

    count = clip.means.shape[1]
    seconds = float(clip.times[-1] - clip.times[0])
    rate = (len(clip) - 1) / seconds if seconds else 0.0
    velocities = (
        "stored" if clip.velocities is not None else "computed from the positions in other frames"
    )
    lines = [
        f"clip: {len(clip)} frames of {count:,} Gaussians, {seconds:.3f} s at {rate:.4g} frames/s",
        f"velocities: {velocities if len(clip) > 1 else 'no (vx, vy, vz will be NaN)'}",
    ]
    if bound := clip.report.get("promise"):
        lines.append(Promise(**bound).brief)
    full = 4 * (len(FULL) + (clip.object_id is not None))
    for name, step in (("small", SMALL.itemsize), ("viz", 4 * len(VIZ)), ("full", full)):
        size = count * step / 1e6
        lines.append(f"profile {name}: {size:.2f} MB per frame, {size * rate:.1f} MB/s")
    return lines


def describe_recording(path: Path) -> list[str]:
    """Describe a recording: topics, numbers of messages, and whether the recording is complete.

    Raises:
        InputError: There is no recording at this path, or the package `mcap` is missing.
    """
    files = bag.recorded_files(path)
    require_mcap()
    from mcap.records import Footer, Message

    counts: Counter[str] = Counter()
    times: list[int] = []  # times of the frames [ns]
    whole = path.suffix == bag.SUFFIX or (path / bag.METADATA).is_file()
    missing = [file.name for file in files if not file.is_file()]
    lines = []
    for file in files:
        if not file.is_file():
            continue
        names, finished = channels(file), False
        counts.update(dict.fromkeys(names.values(), 0))
        for record in records(file):
            if isinstance(record, Message):
                counts[names[record.channel_id]] += 1
                if names[record.channel_id] in MAIN:
                    times.append(record.log_time)
            whole = whole and record is not None
            finished = finished or isinstance(record, Footer)
        whole = whole and finished
        lines.append(f"recording: {file}, {file.stat().st_size / 1e6:.1f} MB")
    for name, count in counts.items():
        lines.append(f"{name}: {count} messages")
        if name in MAIN and times:
            lines.append(f"duration: {np.ptp(times) / 1e9:.3f} s")
    state = "complete" if whole else f"not finished or damaged; run `{PROGRAM} recover {path}`"
    if missing:
        state = f"not complete; missing: {', '.join(missing)}"
    return [*lines, f"state: {state}"]


def diagnose() -> list[str]:
    """List the outlets that work on this machine, and the requirements of all other outlets."""
    lines = [f"python: {sys.version.split()[0]} on {sys.platform}"]
    for outlet in dict.fromkeys([*REQUIREMENTS, *sink_names()]):
        error = missing(outlet)
        lines.append(f"{outlet}: {'ready' if error is None else f'{error.limit} {error.remedy}'}")
    live = next((name for name in AUTOMATIC if missing(name) is None), None)
    lines.append(f"play --backend auto: {live or 'not possible, only recording'}")
    if missing("rclpy") is None:
        lines += [_optional(package, lacking) for package, lacking in OPTIONAL.items()]
    for name in ("ROS_DISTRO", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "CYCLONEDDS_URI"):
        lines.append(f"{name}: {os.environ.get(name) or 'not set'}")
    lines += [_beside_ros(name, module, newest) for name, module, newest in SHARED]
    return lines + [_buffer_advice(name) for name in SHORT if (BUFFERS / name).is_file()]


def _optional(package: str, lacking: str) -> str:
    if find_spec(package) is not None:
        return f"{package}: ready"
    distro = os.environ.get("ROS_DISTRO", "jazzy")
    name = f"ros-{distro}-{package.replace('_', '-')}"
    return f"{package}: not installed, so {lacking}; `sudo apt install {name}` installs it"


def _beside_ros(name: str, module: str, newest: int) -> str:
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return f"{name}: not installed"
    number = import_module(module).__version__
    text = f"{name}: {number} in {Path(spec.origin).parents[1]}"
    distro = os.environ.get("ROS_DISTRO")
    if name == "NumPy" and distro in NUMPY_1:
        newest = 1
    if distro is None or int(number.split(".")[0]) <= newest:
        return text
    return (
        f"{text}; ROS 2's packages are built for {name} {newest}: use a virtual environment "
        "made with constraints-ros.txt (docs/guide/ros2-package.md)"
    )


def _buffer_advice(name: str) -> str:
    size = int((BUFFERS / name).read_text())
    text = f"net.core.{name}: {size / 1024:.0f} KiB"
    if size >= WANTED_BUFFER:
        return text
    return (
        f"{text}, {SHORT[name]}; "
        f"run `sudo sysctl -w net.core.{name}={WANTED_BUFFER}` on the receiving machine"
    )
