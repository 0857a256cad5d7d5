"""The film of the object in the photograph that it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phy124.imaging.image import open_image
from phy124.io.clip import Clip
from phy124.progress import Progress
from phy124.rendering.compose import Photograph, compose
from phy124.scene import View

from .order import Order


def composed(
    clip: Clip, view: View, order: Order, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Write composed.mp4, no larger than the other videos; returns how well its start fits, in dB.

    Args:
        clip: The clip.
        view: How it is filmed.
        order: The order, with a photograph.
        folder: Where to write it.
        progress: Called as ("compose", pictures done, pictures in all); may raise Cancelled.
    """
    assert order.photograph is not None
    with order.picture() as cutout, open_image(order.photograph) as opened:
        opened.thumbnail(view.size)
        photograph = Photograph.of(opened, cutout)
    return compose(clip, view, photograph, folder, device=order.device, progress=progress)[1]
