"""Writes a clip for another program, and notes the data that the format cannot store."""

from pathlib import Path
from typing import NamedTuple

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.mesh import load_pieces
from phy124.io.clip import Clip
from phy124.io.flaws import hide_flaws
from phy124.io.formats import Format
from phy124.io.formats.losses import describe_losses, note_lost
from phy124.io.formats.moving_mesh import fit_to_clip, note_separation, write_moved
from phy124.io.sequence import write_sequence
from phy124.particles.merging import merge_clip_to
from phy124.progress import Progress, silent
from phy124.rendering.shine import drawn_frames, make_shine


class Exported(NamedTuple):
    """The files of an exported clip."""

    files: list[Path]
    gaussians: int
    """Number of Gaussians of a frame."""
    notes: list[str]
    """Sentences about what the files change or leave out."""


def export_clip(
    path: Path,
    clip: Clip,
    format: Format,
    *,
    frame: int | None = None,
    every: bool = False,
    merge: int | None = None,
    surface: Path | None = None,
    name: str = "frame",
    progress: Progress = silent,
) -> Exported:
    """Write a clip, or one of its frames, in a format.

    Args:
        path: The file; for one file per frame, a folder or a name that ends in .zip.
        clip: The clip.
        format: The format.
        frame: Index of the frame to write; None: all frames if the format can store motion in a
            file, else the first frame.
        every: Whether to write all frames, as one file per frame if the format stores no motion.
        merge: Largest number of Gaussians; more Gaussians are merged.
        surface: Mesh from which the object was made, for moving meshes.
        name: Text with which the names of numbered files begin.
        progress: Function that is called as progress("export", frames done, total frames).

    Raises:
        InputError: A frame has no finite Gaussians, the mesh does not fit, or a file cannot be
            written.
    """
    moves = frame is None and format.write_clip is not None
    whole = moves or every or merge is not None  # merging compares the Gaussians of all frames
    clip, notes = hide_flaws(clip, None if whole else [frame or 0])
    notes += _note_look(clip, format, moves=moves, merges=merge is not None)
    if merge is not None:
        clip = merge_clip_to(clip, merge)
    shine, first = make_shine(clip), clip.frame(frame or 0)
    drawn = (first if shine is None else shine.shape(first)).gaussians
    files = [path]
    if moves and surface is not None:
        try:
            pieces, axes = load_pieces(surface)
        except InputError as error:
            raise InputError("surface", surface, error.limit, error.remedy) from error
        write_moved(path, clip, fit_to_clip(pieces, clip, axes), progress=progress)
        notes += note_separation(clip)
    elif moves:
        notes += format.write_motion(path, clip, drawn_frames(clip), progress=progress)
    elif every:
        losses = _Losses(format)
        names = write_sequence(
            path,
            clip,
            write=losses.write,
            suffix=format.suffix,
            name=name,
            frames=drawn_frames(clip),
            progress=progress,
        )
        files = [path] if path.is_file() else [path / name for name in names]
        notes += losses.notes
    else:
        format.write(path, drawn)
        notes += describe_losses(path, drawn, format)
    return Exported(files, len(drawn), notes + note_lost(drawn, format))


class _Losses:
    """Writes frames of a format, and describes what the first file changes."""

    def __init__(self, format: Format) -> None:
        self.format, self.notes, self._first = format, list[str](), True

    def write(self, path: Path, gaussians: Gaussians) -> None:
        self.format.write(path, gaussians)
        if self._first:
            self.notes, self._first = describe_losses(path, gaussians, self.format), False


def _note_look(clip: Clip, format: Format, *, moves: bool, merges: bool) -> list[str]:
    if (not merges and (format.draws or not moves)) or make_shine(clip) is None:
        return []
    if merges:
        why, remedy = "of --merge", "Remove --merge to keep it."
    else:
        why = f"{format.title} stores one colour and opacity for the whole motion"
        remedy = "The formats usd and 4dgs keep it, and also single frames of other formats."
    return [
        "The file contains the Gaussians as simulated, without the look of the videos (surfaces of "
        f"liquids, light on grains), because {why}. {remedy}"
    ]
