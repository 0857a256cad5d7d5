"""Writes a sequence of files, one per frame, into a folder or a zip archive.

SuperSplat plays numbered files (`name_0001.ply`, ...) that are dropped into its window together.
Brush plays a zip of PLY files.
"""

import os
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from phy124.errors import SHORT_CODES, InputError
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.io.files import replacing, resolve_links
from phy124.io.ply import write_ply
from phy124.progress import Progress, silent


def write_sequence(
    path: str | os.PathLike[str],
    clip: Clip,
    *,
    write: Callable[[Path, Gaussians], object] = write_ply,
    suffix: str = ".ply",
    name: str = "frame",
    frames: Iterable[Frame] | None = None,
    progress: Progress = silent,
) -> list[str]:
    """Write one file per frame (by default a 3DGS PLY), numbered from 1; return the file names.

    The folder or archive appears only when it is complete.

    Args:
        path: A new or empty folder, or a name that ends in .zip for an uncompressed archive.
        clip: The clip whose frames are written.
        write: Function that writes the Gaussians of one frame to a path.
        suffix: Extension of the file names, including the dot.
        name: Text with which all file names begin.
        frames: The frames as they are rendered; if None, the clip's own frames.
        progress: Function that is called as progress("export", frames done, total frames).

    Raises:
        InputError: If the clip is empty, the name is not usable, or a file cannot be written.
    """
    path = resolve_links(Path(path))
    clip.refuse_empty()
    if not name or Path(name).name != name:
        raise InputError(
            "name", name, "a file name cannot begin with this text.", "Use a word such as frame."
        )

    def write_numbered(folder: Path) -> Iterator[Path]:
        # All numbers have the same number of digits, because players sort the names as text.
        digits = max(4, len(str(len(clip))))
        for done, frame in enumerate(clip.frames() if frames is None else frames, 1):
            file = folder / f"{name}_{done:0{digits}}{suffix}"
            write(file, frame.gaussians)
            yield file
            progress("export", done, len(clip))

    if path.suffix.lower() != ".zip":
        with _new_folder(path) as folder:
            return [file.name for file in write_numbered(folder)]
    names = []
    with (
        replacing(path) as temporary,
        zipfile.ZipFile(temporary, "w") as archive,
        tempfile.TemporaryDirectory() as scratch,
    ):
        for file in write_numbered(Path(scratch)):
            archive.write(file, file.name)
            file.unlink()
            names.append(file.name)
    return names


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Provide a temporary folder that becomes `path` if the block succeeds."""
    try:
        if path.exists() and any(path.iterdir()):
            # A player would show files of an older sequence together with the new frames.
            raise FileExistsError(0, "the folder exists and is not empty")
        scratch = tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent)
    except OSError as error:
        if error.errno in SHORT_CODES:
            raise
        limit = f"the folder cannot be created ({error.strerror})."
        remedy = "Give a new name in an existing folder to which you may write."
        raise InputError("output", path, limit, remedy) from error
    with scratch:
        folder = Path(scratch.name) / "frames"
        folder.mkdir()
        yield folder
        if path.exists():
            path.rmdir()
        os.replace(folder, path)
