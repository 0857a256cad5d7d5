"""Filming: a clip and a view in, one MP4 per side out."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from phy124.camera import VIEWS, Camera
from phy124.clip import Clip
from phy124.progress import Progress, silent
from phy124.render import render_frames
from phy124.scene import View
from phy124.stopwatch import Stopwatch
from phy124.video import write_mp4

PathLike = str | os.PathLike[str]


def film(
    clip: Clip,
    view: View,
    folder: PathLike,
    *,
    device: str = "cpu",
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> list[Path]:
    """One MP4 per view of a clip, written into a folder that exists."""
    watch = watch or Stopwatch()
    made = []
    for name in view.views:
        path = Path(folder) / f"{name}.mp4"
        images = render_frames(
            clip.frames(),
            cameras(clip, view, name),
            background=view.background,
            device=device,
            progress=lambda _, done, total, name=name: progress(f"render {name}", done, total),
        )
        before = watch.seconds.get("render", 0.0)
        with watch.stage("encode"):
            write_mp4(path, watch.each("render", images), fps=view.fps or _rate(clip))
        watch.seconds["encode"] -= watch.seconds.get("render", 0.0) - before
        made.append(path)
    return made


def cameras(clip: Clip, view: View, name: str) -> list[Camera]:
    """The camera of each frame: still, or once around the object for "orbit"."""
    low, high = _stage_box(clip)
    reach = float((high - low).max())
    middle = (low + high) / 2
    turns = np.arange(len(clip)) * 360 / max(len(clip), 1)
    azimuths = turns if name == "orbit" else np.full(len(clip), VIEWS[name])
    x, y, z = middle.tolist()
    return [
        Camera.orbit(azimuth, view.elevation, view.distance * reach, view.size, (x, y, z), view.fov)
        for azimuth in azimuths.tolist()
    ]


def _stage_box(clip: Clip) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the object at rest, and of the ground under it if it will fall there."""
    low, high = clip.means[0].min(axis=0), clip.means[0].max(axis=0)
    floors = [b["height"] for b in clip.scene.get("boundaries", []) if b["kind"] == "ground"]
    if floors:
        low = np.minimum(low, [np.inf, np.inf, max(floors)])
    return low, high


def _rate(clip: Clip) -> float:
    """Frames per second at which a clip plays in real time."""
    return float((len(clip) - 1) / (clip.times[-1] - clip.times[0])) if len(clip) > 1 else 24.0
