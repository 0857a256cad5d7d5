"""A sequence of 3DGS PLY files, one per frame.

SuperSplat plays files whose names differ only by a running number (`name_0001.ply`, ...) when they
are dropped into it together; brush plays a zip of them. `phy124.io.ply` converts the axes to the
y-down world of these programs.
"""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.io.files import replacing
from phy124.io.ply import write_ply
from phy124.progress import Progress, silent


def write_ply_sequence(
    path: str | os.PathLike[str], clip: Clip, *, name: str = "frame", progress: Progress = silent
) -> list[str]:
    """Write one PLY per frame, numbered from 1, and return the file names.

    The folder or archive appears whole or not at all.

    Args:
        path: A new or empty folder, or a name ending in .zip for one archive (stored, not
            compressed, since floats hardly shrink).
        clip: What to write.
        name: What the file names start with.
        progress: Called as ("export", frames done, frames in all).

    Raises:
        InputError: If the clip is empty, the name is unusable or the files cannot be written.
    """
    path = Path(path)
    if not len(clip):
        raise InputError("clip", "empty", "it has no frames.", "Simulate one frame or more.")
    if not name or Path(name).name != name:
        raise InputError("name", name, "it cannot start a file's name.", "Use a word: frame.")
    if path.suffix.lower() != ".zip":
        with _new_folder(path) as folder:
            return [file.name for file in _numbered(folder, clip, name, progress)]
    names = []
    with (
        replacing(path) as temporary,
        zipfile.ZipFile(temporary, "w") as archive,
        tempfile.TemporaryDirectory() as scratch,
    ):
        for file in _numbered(Path(scratch), clip, name, progress):
            archive.write(file, file.name)
            file.unlink()
            names.append(file.name)
    return names


def _numbered(folder: Path, clip: Clip, name: str, progress: Progress) -> Iterator[Path]:
    """Write the frames one by one and yield each file once it is complete."""
    # As many digits for all: players sort the names as text.
    digits = max(4, len(str(len(clip))))
    for done, frame in enumerate(clip.frames(), 1):
        file = folder / f"{name}_{done:0{digits}}.ply"
        write_ply(file, frame.gaussians)
        yield file
        progress("export", done, len(clip))


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """A temporary folder that becomes `path` if all goes well."""
    try:
        if path.exists() and any(path.iterdir()):
            # Older frames would play among the new ones.
            raise FileExistsError(0, "it exists and is not empty")
        scratch = tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent)
    except OSError as error:
        raise InputError(
            "output",
            path,
            f"the folder cannot be made ({error.strerror}).",
            "Give a new name in a folder that exists and that you may write to.",
        ) from error
    with scratch:
        folder = Path(scratch.name) / "frames"
        folder.mkdir()
        yield folder
        if path.exists():
            path.rmdir()
        os.replace(folder, path)
