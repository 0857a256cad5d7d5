"""The source of a visitor's object: a picture, or a file of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.mesh import is_mesh
from phy124.generators.ply_file import PlyFile, normalise_size
from phy124.imaging.objects import Point
from phy124.io import ply
from phy124.io.axes import FRONTS
from phy124.io.content import for_run
from phy124.io.dialect import Axes, likely_axes
from phy124.io.files import replacing, staging
from phy124.io.formats import recognise
from phy124.particles.thinning import thin
from phy124.rendering.orienting import ENOUGH, UNTURNED, candidates, draw_oriented
from phy124.rendering.render import Renderer
from phy124.runtime import isolated
from phy124.runtime.isolated import Deadline, Unfinished

from .settings import Settings

MEMORY = 3 << 30
"""Memory limit of the process that reads a file [bytes]."""
EACH = 250
"""Largest size of a Gaussian in a file that was read [bytes]."""
SIZE = 192
"""Width and height of the pictures of the possible orientations [pixels]."""
SMALLER = "Reduce the file in a splat editor, for example SuperSplat."


@dataclass(frozen=True)
class Cutout:
    """A picture whose object has been cut out."""

    path: str
    picture: str
    """The uploaded picture in a format that browsers can show."""
    doubts: tuple[str, ...] = ()
    """Reasons why the cut-out may be wrong, which are shown only once."""
    by: str = ""
    """Title of the method that made the cut-out."""
    pick: Point | None = None
    """Point on the object that the visitor clicked."""

    @property
    def stored(self) -> tuple[Path, ...]:
        """Files and folders of the visitor that the source needs."""
        return Path(self.path), Path(self.picture)


@dataclass(frozen=True)
class GaussianFile:
    """A file of Gaussians that has been read."""

    path: str
    """PLY file of the Gaussians that were kept, with the axes of the uploaded file."""
    format: str
    """Title of the file's format."""
    count: int
    axes: Axes
    """The axes of the file that most likely point up and to the front."""
    notes: tuple[str, ...] = ()
    """Sentences about the Gaussians that were removed."""

    @property
    def stored(self) -> tuple[Path, ...]:
        """Files and folders of the visitor that the source needs."""
        return (self.pictures,)

    @property
    def pictures(self) -> Path:
        """Folder that contains a picture of each orientation; `way` returns the file names."""
        return Path(self.path).parent

    @property
    def picture(self) -> str:
        """Picture of the object in the most likely orientation."""
        return str(self.pictures / way(self.axes.up, self.axes.front))


def way(up: str, front: str) -> str:
    """Return the file name of the picture that shows an orientation."""
    return f"{up}_{front}.webp"


Source = Cutout | GaussianFile


@dataclass(frozen=True)
class Choice:
    """A visitor's inputs for a run."""

    name: str
    source: Source | None
    """The source of the object; None if it no longer exists."""
    data: Any
    """The scene as plain data."""
    extras: Any = None
    """Optional inputs in addition to the front picture, with option names as keys."""
    limits: Settings | None = None
    """Limits of the scene; None: the limits of the page."""


def is_there(source: Source | None) -> bool:
    """Return whether a source is set and its file still exists."""
    return source is not None and Path(source.path).exists()


def missing(source: Source | None) -> InputError:
    """Return the error for a request whose picture is missing or was deleted."""
    if source is None:
        return InputError("image", "none", "There is no picture yet.", "Choose one first.")
    limit = "The server no longer has your picture."
    return InputError("image", "gone", limit, "Choose it again.")


def check_file(path: Path, settings: Settings) -> None:
    """Check the size of a file of Gaussians.

    Raises:
        InputError: The file is too large.
    """
    most = max(settings.max_file_mb, settings.max_upload_mb)
    if path.stat().st_size > most * 1e6:
        limit = f"The file is larger than {most:g} MB, the limit of this page."
        raise InputError("image", path.name, limit, SMALLER)


def open_gaussians(path: Path, out: Path, count: int, deadline: Deadline) -> GaussianFile:
    """Read a file, which may be malicious, in a separate process with limits of time and memory.

    Args:
        path: The file to read.
        out: The folder to create for the kept Gaussians and for the pictures of the orientations.
        count: Largest number of Gaussians to keep.
        deadline: Time at which reading is stopped.

    Raises:
        InputError: The file cannot be read within the limits.
    """
    try:
        return isolated.run(_open_gaussians, path, out, count, deadline=deadline, memory=MEMORY)
    except Unfinished as error:
        limit = f"Reading the file {str(error).partition(' (')[0]}."
        raise InputError("image", path.name, limit, SMALLER) from None
    except MemoryError:
        limit = f"The file needs more than {MEMORY >> 30} GB of memory, the limit of this server."
        raise InputError("image", path.name, limit, SMALLER) from None


def _open_gaussians(path: Path, out: Path, count: int) -> GaussianFile:
    with for_run(count):
        file = PlyFile(str(path), UNTURNED).open()
    kept = thin(file.gaussians, count)
    notes = [*file.notes, *file.cleaning]
    if len(kept) < len(file.gaussians):
        text = f"Its {len(file.gaussians):,} Gaussians were reduced to {count:,} larger ones"
        notes.append(f"{text}, the most that this page takes.")
    few = normalise_size(thin(kept, ENOUGH), path.name)
    with staging(out) as folder:
        _draw(few, folder)
        with replacing(folder / "gaussians.ply") as temporary:
            temporary.write_bytes(ply.encode(kept))
    up, front = file.axes
    axes = Axes(up, front or FRONTS[up], True) if is_mesh(path) else likely_axes(path, file.axes)
    stored = str(out / "gaussians.ply")
    # The title of a format does not distinguish its versions.
    title = "Mesh" if is_mesh(path) else recognise(path).title.rstrip(" 0123456789")
    return GaussianFile(stored, title, len(kept), axes, tuple(notes))


def _draw(gaussians: Gaussians, folder: Path) -> None:
    renderer = Renderer(device="cpu")  # not on the GPU, which a run may be using
    for up in candidates(None):
        for reading in candidates(up.up):
            assert reading.up is not None and reading.front is not None
            drawn = draw_oriented(renderer, gaussians, reading, SIZE, alpha=True)
            picture = Image.fromarray(drawn)
            picture.save(folder / way(reading.up, reading.front), "WEBP", quality=85)
