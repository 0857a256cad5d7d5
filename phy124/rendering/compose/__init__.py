"""Composing: the moving object drawn back into the photograph that it was made from.

The photograph's camera is the one that generators assume, straight in front of the object; how
large and where it shows the object follows from the photograph itself. The place where the object
was is filled in, and the object with its shadow is drawn over it.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from phy124.io.clip import Clip
from phy124.io.video import write_mp4
from phy124.progress import Progress, silent
from phy124.rendering.compose.colours import matched
from phy124.rendering.compose.matching import match
from phy124.rendering.compose.photograph import Photograph as Photograph
from phy124.rendering.film import playback, rate
from phy124.rendering.frames import render_frames
from phy124.rendering.render import BLACK
from phy124.rendering.stage.build import Stage, stage_of
from phy124.rendering.stage.frame import Backdrop
from phy124.scene import View


def compose(
    clip: Clip,
    view: View,
    photograph: Photograph,
    folder: str | os.PathLike[str],
    *,
    device: str = "cpu",
    progress: Progress = silent,
) -> tuple[Path, dict[str, Any]]:
    """Write composed.mp4: the clip in the photograph.

    Args:
        clip: The clip of the object made from the photograph.
        view: The filter and the playback rate.
        photograph: The photograph.
        folder: An existing folder.
        device: Warp's name of the device that draws.
        progress: Called as ("compose", pictures done, pictures in all); may raise Cancelled.

    Returns:
        The file, and how well its first picture matches the photograph inside the object, in dB:
        `psnr`, and `psnr_before` its colours and sizes were matched.
    """

    def each() -> None:
        progress("compose", 0, len(clip))

    first = clip.frame(0).gaussians
    camera, before = match(first, photograph, device=device, each=each)
    better = matched(first, camera, photograph, device=device, each=each)
    stage = _surroundings(clip, view, photograph, device)
    clip = replace(clip, sh=better.sh, scales=clip.scales * better.sizes[:, None])
    images = render_frames(
        clip.frames(), [camera] * len(clip), stage=stage.at, device=device, filter=view.filter,
        progress=lambda _, done, total: progress("compose", done, total),
    )  # fmt: skip
    path = Path(folder) / "composed.mp4"
    write_mp4(path, images, fps=playback(rate(clip), view))
    return path, {"psnr": round(better.psnr, 2), "psnr_before": round(before, 2)}


def _surroundings(clip: Clip, view: View, photograph: Photograph, device: str) -> Stage:
    """Floor, shadow and boundaries before the photograph without its object."""
    around = view.model_copy(update={"stage": "studio", "picture": None, "gradient": None})
    stage = stage_of(clip, around, device=device)
    assert stage is not None
    return replace(stage, backdrop=Backdrop(BLACK, BLACK, photograph.without()), pool=0.0)
