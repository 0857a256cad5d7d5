"""Writes `.4dgs` files: all frames in one file, as keyframes and the changes between them.

This is the open container of 4dgs.dev, version 1, model `keyframe-delta`, written by its official
library (package fourdgs, Apache-2.0, needs only numpy). The file declares an error bound for each
value: 2 % of the median scale for positions, 0.5 % for scales, 0.0005 for rotations, 0.5 / 255 for
colours and opacities. Every Gaussian keeps its index in all frames, and readers can seek. Colours
are constant and of degree 0. The axes are those of glTF: y up, z to the front, metres.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from phy124.io.content import Y_UP
from phy124.io.files import replacing
from phy124.progress import Progress, silent
from phy124.runtime.installation import install_command

PROFILE = "fine"
"""The library's profile with the smallest error bounds."""
KEYFRAME = 8
"""Frames per keyframe, which is the largest number of frames read to show any frame."""
STILL = 1 / 24
"""Duration of a clip with one frame [s]."""
FOREVER = 1e6
"""Temporal standard deviation of a Gaussian that does not fade [s]; it must be finite."""


def write_fourdgs(path: str | os.PathLike[str], clip: Clip, *, progress: Progress = silent) -> None:
    """Write a clip as one .4dgs file; needs the extra `fourdgs`.

    The file appears whole or not at all.

    Raises:
        InputError: If fourdgs is not installed, the clip is empty, or the file cannot be written.
    """
    library = _library()
    if not len(clip):
        raise InputError("clip", "empty", "it has no frames.", "Simulate one frame or more.")
    times = clip.times - clip.times[0]
    duration = float(times[-1] + (times[-1] / (len(clip) - 1) if len(clip) > 1 else STILL))
    rotation = orientation(*Y_UP).T
    samples = []
    for index, frame in enumerate(clip.frames()):
        gaussians = rotate_gaussians(frame.gaussians, rotation)
        samples.append(_sample(library, gaussians, float(times[index]), duration))
        progress("export", index, len(clip))
    options = library.KeyframeDeltaOptions(keyframe_every=KEYFRAME)
    data = library.write_sequence(samples, duration, kd=options, profile=PROFILE, library="phy124")
    with replacing(path) as temporary:
        Path(temporary).write_bytes(data)
    progress("export", len(clip), len(clip))


def _library() -> Any:
    """Import the functions and classes of fourdgs that this module uses."""
    try:
        from fourdgs import GaussianSet
        from fourdgs.keyframe_delta_file import write_sequence
        from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions, Sample
    except ImportError as error:
        limit, remedy = (
            "this needs the package fourdgs, 0.6.",
            f"Run `{install_command('fourdgs')}`.",
        )
        raise InputError("format", "4dgs", limit, remedy) from error
    return SimpleNamespace(
        GaussianSet=GaussianSet,
        Sample=Sample,
        KeyframeDeltaOptions=KeyframeDeltaOptions,
        write_sequence=write_sequence,
    )


def _sample(library: Any, gaussians: Gaussians, time: float, duration: float) -> Any:
    """Convert all Gaussians of one frame to the library's sample class."""
    count = len(gaussians)

    def each(value: float) -> NDArray[np.float32]:
        return np.full(count, value, np.float32)

    rgba = np.concatenate([gaussians.rgb, gaussians.opacities[:, None]], axis=1)
    gaussian_set = library.GaussianSet(
        positions=gaussians.means,
        scales=gaussians.scales,
        rotations=np.roll(gaussians.quats, -1, axis=1),
        colors=rgba.astype(np.float32),
        motions=np.zeros((count, 3), np.float32),
        mu_t=each(time),
        sigma_t=each(FOREVER),
        win_lo=each(0),
        win_hi=each(duration),
    )
    return library.Sample(t0=time, ids=np.arange(count), gaussians=gaussian_set)
