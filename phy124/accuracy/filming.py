"""Measures rendering and encoding of a few frames in one view, to forecast the times of videos."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from phy124.accuracy.probe import TRIES, measure_time
from phy124.io.clip import Clip
from phy124.rendering.film import cameras, film
from phy124.rendering.shine import make_shine
from phy124.runtime.context import RunContext
from phy124.scene import View
from phy124.simulation.report import report_clip
from phy124.simulation.setup import Setup

FILMED = 2, 6
"""Numbers of frames of two test videos, which separate the costs per video and per frame."""


def time_film(setup: Setup, context: RunContext) -> dict[str, float]:
    """Predict the times of rendering, encoding and saving [s] from a few frames in one view.

    A seamless video is assumed to run forwards and backwards.
    """
    scene = setup.scene
    front = scene.view.model_copy(update={"views": ("front",), "seamless": False}).only("front")
    views, frames = len(scene.view.sides), scene.time.frames
    pictures = views * scene.view.count_pictures(frames)
    few, more = FILMED
    seconds: dict[int, list[dict[str, float]]] = {few: [], more: []}
    # The first video takes longer, because it also loads the kernels.
    for count in (few, *TRIES * FILMED):
        probe_context = context.aside()
        with tempfile.TemporaryDirectory() as folder:
            clip = _make_moving_clip(setup, count)
            film(clip, front, folder, probe_context)
        seconds[count].append(probe_context.watch.seconds)
    with tempfile.TemporaryDirectory() as folder:
        clip = _make_moving_clip(setup, more)
        saving = measure_time(lambda: clip.save(Path(folder) / "clip.safetensors")) * frames / more
    shortest = {n: min(seconds[n], key=lambda s: sum(s.values())) for n in FILMED}
    predicted = {"save": saving, "render": pictures * shortest[more]["render"] / more}
    if "shine" in shortest[more]:
        common = _fraction_of_surfaces(clip, front)
        often = common * frames + (1 - common) * pictures
        predicted["shine"] = often * shortest[more]["shine"] / more
    if "encode" in shortest[more]:
        each = max(shortest[more]["encode"] - shortest[few]["encode"], 0.0) / (more - few)
        first = max(shortest[few]["encode"] - each * few, 0.0)
        predicted["encode"] = views * first + each * pictures
    if "outputs" in shortest[more]:
        predicted["outputs"] = views * frames * shortest[more]["outputs"] / more
    if "export" in shortest[more]:
        predicted["export"] = frames * shortest[more]["export"] / more
    return predicted


def _fraction_of_surfaces(clip: Clip, view: View) -> float:
    """Return the fraction of the time for highlights and reflections that is spent only once for
    all views: the materials' surfaces do not depend on the view.
    """
    shine = make_shine(clip, view)
    if shine is None:
        return 0.0
    frame = clip.frame(0, velocities=shine.needs_velocities)
    light = partial(shine.illuminate, frame, cameras(clip, view, view.sides[0])[0])
    both, lighting = measure_time(light), measure_time(light)
    return max(1 - lighting / both, 0.0)


def _make_moving_clip(setup: Setup, count: int) -> Clip:
    """Return a clip in which the object moves by 1 % of its size per frame, as is typical."""
    gaussians, scene, n = setup.shown, setup.scene, len(setup.shown)
    shift = np.arange(count, dtype=np.float32)[:, None, None] * np.float32(scene.object.size / 100)
    clip = Clip(
        np.asarray(gaussians.means)[None] + (shift * np.array([0, 1, 0])).astype(np.float32),
        np.broadcast_to(gaussians.quats, (count, n, 4)),
        np.broadcast_to(gaussians.scales, (count, n, 3)),
        gaussians.opacities,
        gaussians.sh,
        np.arange(count) / scene.time.fps,
        scene=scene.data(),
        contacts=np.zeros((count, n, 3), np.float32) if scene.keeps_contacts else None,
    )
    return clip.with_report({**report_clip(setup, clip), "grid": {"dx": scene.dx}})
