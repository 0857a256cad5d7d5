"""Renders the moving object inside the photograph from which the object was made.

The camera is assumed to be in front of the object. The camera's elevation, zoom and shift are
matched to the photograph. The object in the photograph is replaced by inpainting.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phy124.io.clip import Clip
from phy124.io.video import write_mp4
from phy124.rendering.compose.colours import match_colours
from phy124.rendering.compose.photograph import Photograph as Photograph
from phy124.rendering.compose.photograph import match
from phy124.rendering.compose.photograph import photograph_of as photograph_of
from phy124.rendering.film import playback, refuse_rate
from phy124.rendering.frames import render_frames
from phy124.rendering.render import BLACK
from phy124.rendering.stage.build import make_stage
from phy124.rendering.stage.frame import Backdrop
from phy124.runtime.context import RunContext
from phy124.scene import View

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from phy124.runtime.context import ContextOptions


def compose(
    clip: Clip,
    view: View,
    photograph: Photograph,
    folder: str | os.PathLike[str],
    context: RunContext | None = None,
    **fields: Unpack[ContextOptions],
) -> tuple[Path, dict[str, Any]]:
    """Write composed.mp4, which shows the moving object of a clip in the photograph.

    Args:
        clip: The clip of the object made from the photograph.
        view: View that defines the anti-aliasing filter and the playback rate.
        photograph: The photograph from which the object was made.
        folder: An existing folder.
        context: Device, number of threads that render, and a progress function, called as
            ("compose", pictures done, total).
        **fields: `device`, `threads` and `progress`, if no context is passed.

    Returns:
        The file, and two PSNR values [dB] of the first picture inside the object: `psnr`, and
        `psnr_before`, which is the value before colours and sizes were matched.
    """
    context = RunContext.of(context, **fields)
    device, progress = context.device, context.progress
    refuse_rate(clip.fps, view)

    def each() -> None:
        progress("compose", 0, len(clip))

    first = clip.frame(0).gaussians
    camera, before = match(first, photograph, device=device, each=each)
    better = match_colours(first, camera, photograph, device=device, each=each)
    studio = view.model_copy(update={"stage": "studio", "picture": None, "gradient": None})
    stage = make_stage(clip, studio, device=device)
    assert stage is not None
    backdrop = Backdrop(BLACK, BLACK, photograph.erase_object())
    stage = replace(stage, backdrop=backdrop, pool=0.0)
    clip = replace(clip, sh=better.sh, scales=clip.scales * better.sizes[:, None], motion=None)
    images = render_frames(
        clip.frames(),
        [camera] * len(clip),
        stage=stage.at,
        device=device,
        filter=view.filter,
        threads=context.threads,
        progress=lambda _, done, total: progress("compose", done, total),
    )
    path = Path(folder) / "composed.mp4"
    write_mp4(path, images, fps=playback(clip.fps, view))
    return path, {"psnr": round(better.psnr, 2), "psnr_before": round(before, 2)}
