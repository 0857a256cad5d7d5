"""Drawing a finished run back into the photograph that it was made from."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.imaging.image import open_image
from phy124.io.clip import Clip
from phy124.progress import Progress, silent
from phy124.rendering.compose import Photograph, compose
from phy124.scene import View

CUTOUT = "cutout.png"
"""Name of the file beside a clip that says where in the photograph the object is."""


def photograph_of(picture: str | os.PathLike[str], beside: Path) -> Photograph:
    """The photograph that a clip was made from, with the place of the object in it.

    Args:
        picture: The photograph.
        beside: The folder of the clip's run, where its cut-out is.

    Raises:
        InputError: The photograph or its cut-out cannot be opened, or there is no cut-out.
    """
    opened = open_image(picture, field="compose")
    if not (beside / CUTOUT).is_file():
        limit = f"{beside} has no {CUTOUT}, which says where the object was."
        remedy = "Compose a clip that `phy124 generate` made, in its folder."
        raise InputError("compose", picture, limit, remedy)
    return Photograph.of(opened, open_image(beside / CUTOUT, field="compose"))


def into_photograph(
    clip: Clip,
    view: View,
    picture: str | os.PathLike[str],
    beside: Path,
    folder: Path,
    *,
    device: str = "cpu",
    progress: Progress = silent,
) -> tuple[Path, dict[str, Any]]:
    """Write composed.mp4: a clip in its photograph.

    Args:
        clip: The clip.
        view: The filter and the playback rate.
        picture: The photograph from which the clip was made.
        beside: The folder of the run, where its cut-out is.
        folder: Where to write it.
        device: Warp device.
        progress: Called as ("compose", pictures done, pictures in all).

    Returns:
        The file, and how well its first picture matches the photograph, see `compose`.

    Raises:
        InputError: As `photograph_of`.
    """
    photograph = photograph_of(picture, beside)
    return compose(clip, view, photograph, folder, device=device, progress=progress)
