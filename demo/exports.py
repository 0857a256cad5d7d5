"""Convert a finished run to further formats on demand."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from phy124.errors import InputError
from phy124.io.clip import Clip, read_shape
from phy124.io.files import staging
from phy124.io.flaws import hide_flaws
from phy124.io.formats import FORMATS, Format, written_formats
from phy124.pipeline.exporting import export_clip
from phy124.rendering.film import write_player

from .room import all_taken
from .visitors import Visitor, Visitors
from .work import Done

BRIDGE = __name__.partition("demo")[0] + "bridge"
"""Package name of the bridge: `bridge` in a checkout, `phy124_bridge` if installed."""
TOGETHER = threading.BoundedSemaphore(2)
"""Limits simultaneous conversions, because each conversion occupies a core for seconds."""
TAIL = 60.0
"""Time limit for the bridge to write an MCAP file [s]."""


def offered_formats() -> list[str]:
    """Return the names of the formats that this server can write."""
    return [kind for kind, each in EXPORTS.items() if each.available()]


def export(kinds: Sequence[str], done: Done, visitor: Visitor, visitors: Visitors) -> list[Path]:
    """Return the files of a finished run in the requested formats; create files that are missing.

    Args:
        kinds: Names of formats in `EXPORTS`.
        done: The finished run.
        visitor: The visitor who made the run. Older files of this visitor may be removed.
        visitors: All visitors.

    Raises:
        InputError: A format does not exist, cannot be written, or needs too much disk space.
    """
    for kind in kinds:
        if kind not in offered_formats():
            limit = "This server does not offer this format."
            raise InputError("format", kind, limit, "Choose another one.")
    paths = [done.exports / EXPORTS[kind].file for kind in kinds]
    keep = {done.clip, done.films, *paths, *map(_notes, paths)}
    for kind, path in zip(kinds, paths, strict=True):
        if not path.exists():
            size = EXPORTS[kind].about(*read_shape(done.clip / "clip.safetensors"))
            with visitors.writing(visitor, size, keep), TOGETHER, staging(done.exports) as folder:
                notes = EXPORTS[kind].write(done, folder / path.name)
                if notes:
                    (folder / _notes(path).name).write_text("\n".join(notes), "utf-8")
            if not visitor.give_up(visitors.room.each, keep):
                path.unlink()
                _notes(path).unlink(missing_ok=True)
                raise all_taken(0.0, visitors.room.each, "Choose another format.")
    return paths


def notes_on(path: Path) -> list[str]:
    """Return the notes about information that a file in this format changes or omits."""
    notes = _notes(path)
    return notes.read_text("utf-8").splitlines() if notes.exists() else []


def _notes(path: Path) -> Path:
    return path.with_name(f"{path.name}.txt")


def check_size(kinds: Sequence[str], frames: int, gaussians: int, most: float) -> None:
    """Refuse formats whose files would exceed a visitor's disk space; called before the run.

    Args:
        kinds: Names of the formats.
        frames: Number of frames.
        gaussians: Number of Gaussians.
        most: Disk space available to a visitor [bytes].

    Raises:
        InputError: The formats need more disk space.
    """
    size = sum(EXPORTS[kind].about(frames, gaussians) for kind in kinds)
    if size > most:
        raise all_taken(size, most, "Ask for fewer formats or frames.")


@dataclass(frozen=True)
class Export:
    """A file format that is written on request."""

    label: str
    hint: str
    file: str
    write: Callable[[Done, Path], list[str]]
    """Writes the file, and returns notes about it."""
    available: Callable[[], bool] = lambda: True
    empty: int = 0
    """Approximate size of a file without any Gaussians [bytes]."""
    still: float = 0.0
    """Approximate additional size per Gaussian [bytes]."""
    moving: float = 0.0
    """Approximate additional size per Gaussian and frame [bytes]."""

    frame: float = 0.0
    """Approximate additional size per frame, independent of the number of Gaussians [bytes]."""

    def about(self, frames: int, gaussians: int) -> int:
        """Estimate the size of the file in this format [bytes]."""
        each = self.still + self.moving * frames
        return self.empty + round(self.frame * frames + each * gaussians)


def _html(done: Done, path: Path) -> list[str]:
    clip, notes = hide_flaws(Clip.load(done.clip / "clip.safetensors"))
    write_player(path, clip, done.view, "front")
    return notes


def _write_format(format: Format, every: bool, done: Done, path: Path) -> list[str]:
    clip = replace(Clip.load(done.clip / "clip.safetensors"), scene=done.scene.data())
    return export_clip(path, clip, format, every=every, name="phy124").notes


def _mcap(done: Done, path: Path) -> list[str]:
    """Write an MCAP file by the bridge's command line; the page must not import the bridge."""
    clip = done.viewed_clip.resolve()
    command = [sys.executable, "-m", BRIDGE, "record", str(clip), str(path.resolve())]
    root = Path(__file__).parents[1]
    try:
        subprocess.run(command, cwd=root, check=True, timeout=TAIL, capture_output=True)
    except (subprocess.SubprocessError, OSError) as error:
        raise InputError(
            "format",
            "mcap",
            "The server could not write the file.",
            "Use clip.safetensors instead.",
        ) from error
    return []


def _bridge() -> bool:
    return all(find_spec(name) is not None for name in (BRIDGE, "mcap"))


def _export_of(format: Format) -> Export:
    moves = format.write_clip is not None
    return Export(
        f"{format.title[0].upper()}{format.title[1:]}, {'moving' if moves else 'at rest'}",
        f"Opens in {format.opens_in}",
        f"phy124-{format.name}{format.suffix}",
        partial(_write_format, format, moves),
        lambda: format.installed,
        empty=0 if moves else round(format.bytes_fixed),
        frame=format.bytes_fixed if moves else 0.0,
        still=0.0 if moves else format.bytes_each,
        moving=format.bytes_each if moves else 0.0,
    )


EXPORTS = {
    "html": Export(
        label="Page with the player",
        hint="Opens in any browser, offline",
        file="player.html",
        write=_html,
        empty=465_000,
        still=28.0,
        moving=8.0,
    ),
    "ply": Export(
        label="PLY sequence",
        hint="Opens in SuperSplat, brush, Unity",
        file="phy124-ply.zip",
        write=partial(_write_format, FORMATS["ply"], True),
        moving=FORMATS["ply"].bytes_each,
    ),
    "mcap": Export("MCAP", "Opens in Foxglove, ROS 2", "phy124.mcap", _mcap, _bridge, moving=60.0),
    # The files of a run already include a PLY file of the Gaussians at rest.
    **{name: _export_of(format) for name, format in written_formats().items() if name != "ply"},
}
