"""`phy124 convert` and `phy124 export`: write Gaussians and clips for other programs."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import help_of
from phy124.errors import InputError
from phy124.generators.ply_file import Reading
from phy124.io.clip import Clip
from phy124.io.content import Content
from phy124.io.files import refuse_replacing
from phy124.io.formats import (
    Format,
    find_written_format,
    read_gaussians,
    write_gaussians,
    written_formats,
)
from phy124.io.formats.losses import describe_losses, note_lost
from phy124.io.growing import write_frames_clip
from phy124.particles.merging import merge_to
from phy124.pipeline.exporting import export_clip
from phy124.pipeline.run_folder import list_results
from phy124.scene import Format as Filmed

MERGE = tyro.conf.arg(metavar="N")
TO = "; ".join(f"{name}: {format.title}" for name, format in written_formats().items())
FRAMES = "frames: a clip with all values of each frame"
OF_RUNS = (".json", ".toml", ".safetensors", ".png", ".mp4")
"""File name endings of a run's results that no format has."""


@dataclass(frozen=True)
class Convert:
    """Write a file of Gaussians in another format, rotated to that format's up axis."""

    file: tyro.conf.Positional[Path]
    """File to read: PLY (plain or SuperSplat's), SPZ, .splat, SOG or GLB, detected by content."""
    out: tyro.conf.Positional[Path]
    """File to write; the ending of its name determines the format."""
    to: Annotated[str | None, tyro.conf.arg(help=f"Format, if the ending is ambiguous. {TO}")] = (
        None
    )
    up: Annotated[str | None, help_of(Reading, "up")] = None
    front: Annotated[str | None, help_of(Reading, "front")] = None
    dialect: Annotated[str | None, help_of(Reading, "dialect")] = None
    rotate: Annotated[str | None, help_of(Reading, "rotate")] = None
    merge: Annotated[int | None, MERGE] = None
    """Maximum number of Gaussians. If there are more, neighbours are merged, which preserves mass
    and colour.
    """
    json: bool = False
    """Print only the result, as JSON."""

    def run(self) -> int:
        """Convert the file; print the new file, its size and the programs that open it.

        Raises:
            InputError: The file cannot be read, or the new file cannot be written.
        """
        chosen = find_written_format(self.out, self.to)
        _refuse_name(self.out, chosen)
        refuse_replacing(self.out, [self.file])
        content = read_gaussians(
            self.file, up=self.up, front=self.front, dialect=self.dialect, rotate=self.rotate
        )
        gaussians = content.gaussians
        if self.merge is not None:
            gaussians = merge_to(gaussians, self.merge)
        write_gaussians(self.out, gaussians, chosen.name, antialiased=content.antialiased)
        notes = [*_note_dropped(content.dropped), *content.remarks(), *_note_far(content)]
        notes += note_lost(gaussians, chosen) + describe_losses(self.out, gaussians, chosen)
        return _show([self.out], len(gaussians), notes, chosen, as_json=self.json)


@dataclass(frozen=True)
class Export:
    """Write a clip, or one of its frames, in the format of another program."""

    clip: tyro.conf.Positional[Path]
    """clip.safetensors made by `phy124 generate`."""
    to: Annotated[str, tyro.conf.arg(help=f"Format. {TO}; {FRAMES}", metavar="FORMAT")]
    frame: int | None = None
    """Index of the frame to write, starting at 0. By default, frame 0 is written, or all frames if
    the format can store motion. In the file's name, frames are numbered from 0001, as with --all.
    """
    all: bool = False
    """Write all frames, either to one file or to numbered files."""
    out: Path | None = None
    """File to write; with --all, a folder or a name ending in .zip. By default, the files are
    written next to the clip.
    """
    merge: Annotated[int | None, MERGE] = None
    """Maximum number of Gaussians. If there are more, Gaussians that stay neighbours in all frames
    are merged.
    """
    surface: Path | None = None
    """For --to moving-mesh: the mesh from which the object was made. The export then moves the
    triangles and the texture of this mesh, instead of a surface made from the Gaussians.
    """
    json: bool = False
    """Print only the result, as JSON."""

    def run(self) -> int:
        """Export the clip; print the written files, their size and the programs that open them.

        Raises:
            InputError: The clip cannot be read, has no such frame, or a file cannot be written.
        """
        if self.to == "frames":
            return self._write_values()
        chosen = self._find_format()
        refuse_replacing(self.out or self.clip.with_suffix(chosen.suffix), self._list_read())
        if self.out is not None and not self.all:
            _refuse_name(self.out, chosen)
        clip = Clip.load(self.clip)
        if self.frame is not None and self.all:
            limit = "--frame selects one frame, but --all selects every frame."
            raise InputError("frame", self.frame, limit, "Remove one of the two options.")
        if self.frame is not None and not 0 <= self.frame < len(clip):
            limit = f"The clip has the frames 0 to {len(clip) - 1}."
            raise InputError("frame", self.frame, limit, "Choose one of them.")
        if self.surface is not None and (self.to != "moving-mesh" or self.frame is not None):
            limit = "This option is only for --to moving-mesh with all frames."
            raise InputError("surface", self.surface, limit, "Remove this option.")
        with Bars(quiet=self.json) as bars:
            exported = export_clip(
                self.out or self.clip.with_name(self._name(chosen)),
                clip,
                chosen,
                frame=self.frame,
                every=self.all,
                merge=self.merge,
                surface=self.surface,
                name=self.clip.stem,
                progress=bars,
            )
        return _show(*exported, chosen, as_json=self.json)

    def _name(self, chosen: Format) -> str:
        if self.frame is None and chosen.write_clip is not None:
            return f"{self.clip.stem}{chosen.suffix}"
        if self.all:
            return f"{self.clip.stem}-{chosen.name}"
        return f"{self.clip.stem}_{(self.frame or 0) + 1:04}{chosen.suffix}"

    def _find_format(self) -> Format:
        if self.to in get_args(Filmed) and self.to not in written_formats():
            limit = "This is a format of videos, which `export` does not write."
            remedy = f"Use `phy124 render {self.clip} --format {self.to}`."
            raise InputError("to", self.to, limit, remedy)
        return find_written_format(Path(), self.to, others=("frames",))

    def _write_values(self) -> int:
        for name in ("frame", "merge", "surface"):
            if (value := getattr(self, name)) is not None:
                limit = "--to frames writes all frames and all Gaussians."
                raise InputError(name, value, limit, "Remove this option.")
        path = self.out or self.clip.with_name(f"{self.clip.stem}-frames.safetensors")
        refuse_replacing(path, self._list_read())
        clip = Clip.load(self.clip)
        with Bars(quiet=self.json) as bars:
            write_frames_clip(path, clip, bars)
        print(json.dumps({"files": [str(path)]}) if self.json else path)
        return 0

    def _list_read(self) -> list[Path]:
        return [path for path in (self.clip, self.surface) if path is not None]


def _refuse_name(path: Path, chosen: Format) -> None:
    """Refuse to replace a file of a run, and a file name with the ending of another format."""
    if path.name in list_results(path.parent):
        limit = "this file is a result of the run in its folder."
        raise InputError("out", path, limit, "Give another name or folder.")
    ending, known = path.suffix.lower(), written_formats().values()
    endings = {each.name: (each.suffix, *each.other_suffixes) for each in known}
    others = [name for name, each in endings.items() if ending in each]
    if ending in OF_RUNS or (others and chosen.name not in others):
        limit = f"files of the format {chosen.title} end in {chosen.suffix}."
        remedy = f"Rename it, or choose --to {' or '.join(others)}." if others else "Rename it."
        raise InputError("out", path, limit, remedy)


def _note_dropped(count: int) -> list[str]:
    return [f"{count} Gaussians had NaN or infinite values and were dropped."] if count else []


def _note_far(content: Content) -> list[str]:
    if not any(content.origin):
        return []
    place = ", ".join(f"{x:.10g}" for x in content.origin)
    return [
        f"The object is so far from the origin that float32 positions would be inexact, so {place} "
        "was subtracted from all positions."
    ]


def _show(files: list[Path], count: int, notes: list[str], chosen: Format, *, as_json: bool) -> int:
    size = sum(path.stat().st_size for path in files)
    if as_json:
        data = {"files": [str(path) for path in files], "gaussians": count, "bytes": size}
        print(json.dumps({**data, "format": chosen.name, "notes": notes}))
        return 0
    for note in notes:
        print(f"note: {note}")
    print(
        f"{count:,} Gaussians as {chosen.title}, {size / 1e6:,.2f} MB; opens in {chosen.opens_in}"
    )
    for path in files:
        print(path)
    return 0
