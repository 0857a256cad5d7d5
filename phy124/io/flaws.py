"""Finds and hides Gaussians with NaN or infinite values, which other programs cannot read."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.clip import Clip, select_moving


def describe_flaws(clip: Clip) -> list[str]:
    """Return a sentence for each frame in which Gaussians have NaN or infinite values."""
    text = "Frame {}: {} of {} Gaussians have NaN or infinite values and are not shown."
    counts = [np.count_nonzero(~clip.finite(index)) for index in range(len(clip))]
    return [text.format(i, n, len(clip.opacities)) for i, n in enumerate(counts) if n]


def hide_flaws(clip: Clip, frames: Iterable[int] | None = None) -> tuple[Clip, list[str]]:
    """Return a clip whose Gaussians have finite values, and notes.

    A Gaussian that has NaN or infinite values in any of these frames becomes an invisible copy of
    the next Gaussian in the clip, so the other Gaussians keep their indices.

    Args:
        clip: The clip.
        frames: Indices of the frames that are written; None: all frames.

    Raises:
        InputError: No Gaussian has finite values in all of these frames.
    """
    sound = np.ones(len(clip.opacities), bool)
    flawed = []
    for index in range(len(clip)) if frames is None else frames:
        finite = clip.finite(index)
        if not finite.all():
            flawed.append(index)
            sound &= finite
    if not flawed:
        return clip, []
    several = len(flawed) > 1
    where = f"{flawed[0]} to {flawed[-1]}" if several else str(flawed[0])
    if not sound.any():
        limit = "every Gaussian has NaN or infinite values."
        remedy = "Use earlier frames, or simulate again on a finer grid."
        raise InputError("frames", where, limit, remedy)
    note = (
        f"{np.count_nonzero(~sound)} of {len(sound)} Gaussians have NaN or infinite values in "
        f"{'frames' if several else 'frame'} {where}, and are invisible in the file."
    )
    return _hide(clip, sound), [note]


def _hide(clip: Clip, sound: NDArray[np.bool_]) -> Clip:
    """Replace each Gaussian outside a mask [N] by an invisible copy of the next one inside."""
    kept = np.flatnonzero(sound)
    source = kept[np.searchsorted(kept, np.arange(len(sound))).clip(max=len(kept) - 1)]
    opacities = np.where(sound, clip.opacities, 0)
    return replace(clip, **select_moving(clip, source), opacities=opacities, sh=clip.sh[source])
