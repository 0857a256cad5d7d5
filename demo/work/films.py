"""Render a clip as videos, player data, an animated picture and a video in the photograph."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from phy124 import pipeline
from phy124.imaging.image import open_image
from phy124.io.clip import Clip
from phy124.io.html import pack
from phy124.io.video import write_animation
from phy124.rendering.compose import Photograph, compose
from phy124.rendering.frames import render_frames
from phy124.rendering.framing import still_camera
from phy124.rendering.shine import add_gloss
from phy124.rendering.stage.build import make_stage, pack_stage
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene, View

from ..course import FILMING
from ..progress import Step
from .limits import Limits
from .order import Order, hide_uploads

MOVING = 320
"""Width and height of the animated WebP [pixels]."""


def film(order: Order, clips: Path, out: Path, limits: Limits) -> None:
    """Write a folder with the videos, the player's pack, an animated picture, scene and report.

    Args:
        order: The order (the request for a run).
        clips: Folder that contains the clip.
        out: The folder to write.
        limits: Stops the job at its time limit, and passes events on.
    """
    clip, watch = Clip.load(clips / "clip.safetensors"), Stopwatch()
    # The page shows MP4 files; other formats are made on demand (demo/exports.py).
    view = order.scene.view
    stage = "plain" if view.stage == "transparent" else view.stage
    view = view.model_copy(update={"formats": ("mp4",), "outputs": (), "stage": stage})
    tell = limits.tell
    tell(Step("render", 0, len(clip) * len(view.sides)))
    with pipeline.staging(out) as folder:
        left_out = _videos(clip, view, order, folder, limits, watch)
        about = _in_photograph(clip, view, order, folder, limits, watch)
        tell(Step("save", 0, 2))
        with watch.stage("pack"):
            first = still_camera(clip, view, "front")
            around = make_stage(clip, view, device=order.device)
            shown, gloss = add_gloss(clip, view)
            staged = pack_stage(around, shown, gloss)
            data = pack(shown, first, background=view.background, stage=staged, shine=gloss)
            (folder / "clip.pack").write_bytes(data)
            tell(Step("save", 1, 2))
            turning = pipeline.cameras(clip, view, "orbit")
            images = render_frames(
                clip.frames(),
                turning,
                size=MOVING,
                background=view.background,
                stage=around and around.at,
                device=order.device,
                progress=lambda *_: tell(Step("save", 1, 2)),
            )
            fps = pipeline.playback(order.scene.time.fps, view)
            write_animation(folder / "orbit.webp", images, fps=fps)
        viewed = Scene.from_data({**clip.scene, "view": order.scene.data()["view"]})
        (folder / "scene.toml").write_text(hide_uploads(order, viewed.to_toml()), "utf-8")
        _keep_view(clip, viewed, order, folder)
        report = json.loads((clips / "report.json").read_text("utf-8"))
        report["stages"] = _add_stages(report["stages"], watch.data())
        report["seconds"] += watch.total
        report |= pipeline.view_report(clip, view) | about
        if order.photograph and not about:
            left_out.append("the photograph")
        if left_out:
            names = " and ".join(left_out)
            report["notes"] = [
                *report.get("notes", []),
                f"The time limit was reached before these videos were made: {names}.",
            ]
        pipeline.write_json(folder / "report.json", report)


def _keep_view(clip: Clip, scene: Scene, order: Order, folder: Path) -> None:
    """Write a copy of the clip with the view of the videos, if the clip has another view."""
    named = json.loads(hide_uploads(order, json.dumps(scene.data())))
    if Scene.from_data(named).view != Scene.of_clip(clip.scene).view:
        replace(clip, scene=named).save(folder / "clip.safetensors")


def _add_stages(stages: list[dict[str, Any]], others: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Merge the stages of two reports; add the times of stages that are in both."""
    joined = {stage["name"]: stage for stage in stages}
    for stage in others:
        before = joined.get(stage["name"], {"seconds": 0.0})["seconds"]
        joined[stage["name"]] = {**stage, "seconds": before + stage["seconds"]}
    return list(joined.values())


def _videos(
    clip: Clip, view: View, order: Order, folder: Path, limits: Limits, watch: Stopwatch
) -> list[str]:
    left_out = []
    for number, side in enumerate(view.sides):
        if number and limits.spent > FILMING:
            left_out.append(side)
            continue

        def progress(_: str, done: int, of: int, number: int = number, side: str = side) -> None:
            limits.tell(Step("render", number * of + done, len(view.sides) * of, side))

        pipeline.film(
            clip,
            view.only(side),
            folder,
            device=order.device,
            threads=order.threads,
            progress=progress,
            watch=watch,
        )
    return left_out


def _in_photograph(
    clip: Clip, view: View, order: Order, folder: Path, limits: Limits, watch: Stopwatch
) -> dict[str, Any]:
    """Return the report's entry about the video; empty if no video was made."""
    if order.photograph is None or limits.spent > FILMING:
        return {}

    def progress(_: str, done: int, total: int) -> None:
        limits.tell(Step("render", done, total, "composed"))

    with watch.stage("compose"):
        # This video must not be larger than the other videos.
        with order.picture() as cutout, open_image(order.photograph) as opened:
            opened.thumbnail(view.size)
            photograph = Photograph.of(opened, cutout)
        made = compose(
            clip,
            view,
            photograph,
            folder,
            device=order.device,
            threads=order.threads,
            progress=progress,
        )
        return {"compose": made[1]}
