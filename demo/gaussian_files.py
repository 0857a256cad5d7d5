"""Files of Gaussians that visitors send: read, reduced, and drawn in every orientation.

All of this is done in a process of its own, which has a limit of memory and can be killed: a file
may be made to do harm.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile, normalised
from phy124.io import ply
from phy124.io.dialect import likely_axes
from phy124.io.files import replacing, staging
from phy124.io.formats import recognise
from phy124.particles.thinning import thin
from phy124.rendering.orienting import ENOUGH, UNTURNED, candidates, draw_oriented
from phy124.rendering.render import Renderer
from phy124.runtime import isolated
from phy124.runtime.isolated import Deadline, Unfinished

from .settings import Settings
from .source import GaussianFile, way

MEMORY = 3 << 30
"""Memory that the process may take [bytes]."""
SIZE = 192
"""Side of the pictures [pixels]."""
SMALLER = "Reduce the file in a splat editor, for example SuperSplat."


def check_file(path: Path, settings: Settings) -> None:
    """Check the size of a file of Gaussians.

    Raises:
        InputError: It is too large.
    """
    most = max(settings.max_file_mb, settings.max_upload_mb)
    if path.stat().st_size > most * 1e6:
        limit = f"The file is larger than the {most:g} MB that this page takes."
        raise InputError("image", path.name, limit, SMALLER)


def opened(path: Path, out: Path, count: int, deadline: Deadline) -> GaussianFile:
    """Read a file in a process of its own.

    Args:
        path: The file.
        out: The folder to make, with the Gaussians that are kept and pictures of them.
        count: Largest number of Gaussians to keep.
        deadline: When to give up.

    Raises:
        InputError: It cannot be read.
    """
    try:
        return isolated.run(_opened, path, out, count, deadline=deadline, memory=MEMORY)
    except Unfinished as error:
        limit = f"Reading it {str(error).partition(' (')[0]}."
        raise InputError("image", path.name, limit, SMALLER) from None
    except MemoryError:
        limit = f"It takes more than the {MEMORY >> 30} GB of memory that one file may take here."
        raise InputError("image", path.name, limit, SMALLER) from None


def _opened(path: Path, out: Path, count: int) -> GaussianFile:
    """What `opened` does, in this process."""
    found = PlyFile(str(path), UNTURNED).open()
    kept = thin(found.gaussians, count)
    notes = [*found.notes, *found.cleaning]
    if len(kept) < len(found.gaussians):
        there = f"The file has {len(found.gaussians):,} Gaussians; fewer and larger ones cover"
        notes.append(f"{there} the same here, where {count:,} are the most.")
    few = normalised(thin(kept, ENOUGH), path.name)
    with staging(out) as folder:
        _draw(few, folder)
        with replacing(folder / "gaussians.ply") as temporary:
            temporary.write_bytes(ply.encode(kept))
    axes = likely_axes(path, found.axes)
    made = str(out / "gaussians.ply")
    # Several versions of a format are read alike.
    title = recognise(path).title.rstrip(" 0123456789")
    return GaussianFile(made, title, len(kept), axes, tuple(notes))


def _draw(gaussians: Gaussians, folder: Path) -> None:
    """Draw all ways up and all fronts of each."""
    renderer = Renderer(device="cpu")  # Not on a GPU, which a run may be using.
    for up in candidates(None):
        for reading in candidates(up.up):
            assert reading.up is not None and reading.front is not None
            picture = Image.fromarray(draw_oriented(renderer, gaussians, reading, SIZE))
            picture.save(folder / way(reading.up, reading.front), "WEBP", quality=85)
