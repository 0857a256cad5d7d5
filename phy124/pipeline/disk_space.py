"""Estimates the size of a run's results, and warns if the disk has less free space."""

import math
import shutil
import warnings
from pathlib import Path

from phy124.budget.cost import BYTES_PER_GAUSSIAN
from phy124.simulation import Simulation

PLY = 4 * 17
"""Size of a Gaussian in a PLY file [bytes]; each further colour coefficient adds 12 bytes."""
PARTICLE = 48
"""Size of a particle in one frame [bytes]."""
EXPORTED = {"usd": BYTES_PER_GAUSSIAN, "ply": PLY, "html": 8}
"""Size of a Gaussian in one frame [bytes], by file format."""
PIXEL = {"png": 1.0, "gif": 0.5, "webp": 0.1, "mp4": 0.05, "webm": 0.05, "mov": 2.0}
"""Approximate size of a pixel [bytes], by video format."""
OUTPUT = 6
"""Approximate size of a pixel [bytes] in a further output, such as depth."""


def warn_of_disk_space(run: Simulation, out: Path, *, films: bool) -> None:
    """Warn if the disk has less free space than the estimated size of a run's results."""
    then = "files that do not fit are written to another folder if possible"
    warn_if_full(estimate_size(run, films=films), out, then)


def warn_if_full(needed: float, out: Path, then: str) -> None:
    """Warn if the disk of a folder, which need not exist, has less free space than is needed.

    Args:
        needed: Estimated size of the results [bytes].
        out: The folder of the results.
        then: What happens to results that do not fit, or what the user can do.
    """
    try:
        folder = next(path for path in (out, *out.absolute().parents) if path.exists())
        free = shutil.disk_usage(folder).free
    except OSError:
        return
    if needed > free:
        warnings.warn(
            f"the results need about {size(needed)}, but the disk of {out} has only "
            f"{size(free)} of free space; {then}",
            stacklevel=3,
        )


def estimate_size(run: Simulation, *, films: bool) -> float:
    """Estimate the total size of a run's files [bytes], including the temporary file of frames; the
    estimate is rough for videos.
    """
    scene, count, frames = run.scene, len(run.setup.shown), run.scene.time.frames
    colours = 12 * (run.setup.shown.sh.shape[1] - 1)
    kept = 12 * (scene.velocities + scene.keeps_contacts) + 16 * (colours > 0)
    moving = 0 if run.light else count * (BYTES_PER_GAUSSIAN + kept)
    moving += PARTICLE * len(run.deformer.carriers) if run.setup.shapes else 0
    files = frames * moving + count * (2 * PLY + 2 * colours)
    if not films:
        return files
    view = scene.view
    pixels = frames * len(view.sides) * math.prod(view.size)
    drawn = sum(pixels * PIXEL.get(name, 0.0) for name in view.formats)
    exported = sum(frames * count * EXPORTED.get(name, 0) for name in view.formats)
    return files + drawn + exported + OUTPUT * pixels * len(view.outputs)


def size(count: float) -> str:
    """Format a number of bytes with a unit."""
    for unit, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= unit:
            return f"{count / unit:.1f} {name}"
    return f"{count:.0f} bytes"
