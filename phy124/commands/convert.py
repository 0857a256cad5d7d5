"""`phy124 convert` and `phy124 export`: write Gaussians and clips for other programs."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import help_of
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.mesh import load_pieces
from phy124.generators.ply_file import Reading
from phy124.io.clip import Clip
from phy124.io.content import Content
from phy124.io.files import refuse_replacing
from phy124.io.flaws import hide_flaws
from phy124.io.formats import (
    Format,
    find_written_format,
    read_gaussians,
    write_gaussians,
    written_formats,
)
from phy124.io.formats.losses import describe_losses
from phy124.io.formats.moving_mesh import fit_to_clip, note_separation, write_moved
from phy124.io.growing import write_frames_clip
from phy124.io.sequence import write_sequence
from phy124.particles.merging import merge_clip_to, merge_to
from phy124.pipeline.run_folder import list_results
from phy124.rendering.shine import drawn_frames, make_shine
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
        return _show([self.out], len(gaussians), chosen, notes, as_json=self.json)


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
        moves = self.all or (self.frame is None and chosen.write_clip is not None)
        every = moves or self.merge is not None  # --merge compares Gaussians in all frames
        clip, notes = hide_flaws(clip, None if every else [self.frame or 0])
        notes += self._note_look(clip, chosen)
        if self.merge is not None:
            clip = merge_clip_to(clip, self.merge)
        shine, frame = make_shine(clip), clip.frame(self.frame or 0)
        first = (frame if shine is None else shine.shape(frame)).gaussians
        with Bars(quiet=self.json) as bars:
            files = self._write(clip, first, chosen, bars, notes)
        notes += note_lost(first, chosen)
        if files[0].suffix != ".zip":
            notes += describe_losses(files[0], first, chosen)
        return _show(files, len(first), chosen, notes, as_json=self.json)

    def _note_look(self, clip: Clip, chosen: Format) -> list[str]:
        whole = self.frame is None and chosen.write_clip is not None
        if (self.merge is None and (chosen.draws or not whole)) or make_shine(clip) is None:
            return []
        if self.merge is not None:
            why, remedy = "of --merge", "Remove --merge to keep it."
        else:
            why = f"{chosen.title} stores one colour and opacity for the whole motion"
            remedy = "It is kept by --to usd, --to 4dgs, and --to ply --all."
        return [
            "The file contains the Gaussians as simulated, without the look of the videos "
            f"(surfaces of liquids, light on grains), because {why}. {remedy}"
        ]

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

    def _write(
        self, clip: Clip, first: Gaussians, chosen: Format, bars: Bars, notes: list[str]
    ) -> list[Path]:
        """Write the files, whose paths are returned, and append notes about them."""
        if self.frame is None and chosen.write_clip is not None:
            path = self.out or self.clip.with_suffix(chosen.suffix)
            if self.surface is not None:
                pieces, axes = load_pieces(self.surface)
                write_moved(path, clip, fit_to_clip(pieces, clip, axes), progress=bars)
                notes += note_separation(clip)
                return [path]
            notes += chosen.write_motion(path, clip, drawn_frames(clip), progress=bars)
            return [path]
        if self.all:
            path = self.out or self.clip.with_name(f"{self.clip.stem}-{chosen.name}")
            frames = drawn_frames(clip)
            form: Any = {"write": chosen.write, "suffix": chosen.suffix, "name": self.clip.stem}
            names = write_sequence(path, clip, **form, frames=frames, progress=bars)
            return [path] if path.is_file() else [path / name for name in names]
        index = self.frame or 0
        name = f"{self.clip.stem}_{index + 1:04}{chosen.suffix}"
        path = self.out or self.clip.with_name(name)
        chosen.write(path, first)
        return [path]


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


def note_lost(gaussians: Gaussians, chosen: Format) -> list[str]:
    """Return notes about data that the chosen format cannot store."""
    if gaussians.sh_degree <= chosen.degree:
        return []
    return [
        f"{chosen.title} stores no harmonics above degree {chosen.degree}: changes of colour with "
        "the direction are left out."
    ]


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


def _show(files: list[Path], count: int, chosen: Format, notes: list[str], *, as_json: bool) -> int:
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
