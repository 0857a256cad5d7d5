"""Formats that are made on demand."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from phy124.errors import InputError
from phy124.io.clip import Clip, read_shape
from phy124.io.files import staging
from phy124.io.formats import FORMATS, Format, written_formats
from phy124.io.html import write_html
from phy124.io.sequence import write_ply_sequence
from phy124.rendering.framing import still_camera
from phy124.rendering.shine import add_gloss
from phy124.rendering.stage.build import make_stage, pack_stage
from phy124.scene import View

from .room import all_taken
from .visitors import Visitor, Visitors
from .work import Done

BRIDGE = __name__.partition("demo")[0] + "bridge"
"""Name of the bridge's package: `bridge` in a checkout, `phy124_bridge` if installed."""
TOGETHER = threading.BoundedSemaphore(2)
"""Held by those that make a format: each takes seconds of a core."""
TAIL = 60.0
"""Longest time that the bridge may take [s]."""


def export(kinds: Sequence[str], done: Done, visitor: Visitor, visitors: Visitors) -> list[Path]:
    """The files of some of `EXPORTS` for a finished run, made if they are not there yet.

    Args:
        kinds: Names of the formats.
        done: The run.
        visitor: Whose it is; older files of theirs are removed if they take the room.
        visitors: Who else needs room.

    Raises:
        InputError: There is no such format, it cannot be made, or there is no room for it.
    """
    for kind in kinds:
        if kind not in EXPORTS or not EXPORTS[kind].available():
            limit = "This format is not offered here."
            raise InputError("format", kind, limit, "Choose another one.")
    paths = [done.exports / EXPORTS[kind].file for kind in kinds]
    keep = {done.clip, done.films, *paths}
    for kind, path in zip(kinds, paths, strict=True):
        if not path.exists():
            size = EXPORTS[kind].about(*read_shape(done.clip / "clip.safetensors"))
            with visitors.writing(visitor, size, keep), TOGETHER, staging(done.exports) as folder:
                EXPORTS[kind].write(done, folder / path.name)
            if not visitor.give_up(visitors.room.each, keep):
                path.unlink()
                raise all_taken(0.0, visitors.room.each, "Choose another format.")
    return paths


def check_size(kinds: Sequence[str], frames: int, gaussians: int, most: float) -> None:
    """Check, before a run, that its formats will fit into the room of one visitor.

    Args:
        kinds: Names of the formats.
        frames: Number of frames.
        gaussians: Number of Gaussians.
        most: The room [bytes].

    Raises:
        InputError: They will not.
    """
    size = sum(EXPORTS[kind].about(frames, gaussians) for kind in kinds)
    if size > most:
        raise all_taken(size, most, "Ask for fewer formats or frames.")


@dataclass(frozen=True)
class Export:
    """A format made on demand."""

    label: str
    hint: str
    file: str
    write: Callable[[Done, Path], None]
    available: Callable[[], bool] = lambda: True
    empty: int = 0
    """Bytes without any Gaussians, about."""
    still: float = 0.0
    """Bytes per Gaussian, about."""
    moving: float = 0.0
    """Bytes per Gaussian and frame, about."""

    def about(self, frames: int, gaussians: int) -> int:
        """About how many bytes the file of so many frames and Gaussians will have."""
        return self.empty + round((self.still + self.moving * frames) * gaussians)


def _html(done: Done, path: Path) -> None:
    clip = Clip.load(done.clip / "clip.safetensors")
    view = View.model_validate(clip.scene["view"])
    around = pack_stage(make_stage(clip, view), clip)
    first = still_camera(clip, view, "front")
    shown, gloss = add_gloss(clip, view)
    write_html(path, shown, first, background=view.background, stage=around, shine=gloss)


def _ply(done: Done, path: Path) -> None:
    write_ply_sequence(path, Clip.load(done.clip / "clip.safetensors"), name="phy124")


def _mcap(done: Done, path: Path) -> None:
    """Uses the bridge's command line, since page and bridge do not import each other."""
    clip = (done.clip / "clip.safetensors").resolve()
    command = [sys.executable, "-m", BRIDGE, "record", str(clip), str(path.resolve())]
    beside = Path(__file__).parents[1]
    try:
        subprocess.run(command, cwd=beside, check=True, timeout=TAIL, capture_output=True)
    except (subprocess.SubprocessError, OSError) as error:
        raise InputError(
            "format", "mcap", "The bridge could not write it.", "Use clip.safetensors instead."
        ) from error


def _bridge() -> bool:
    return all(find_spec(name) is not None for name in (BRIDGE, "mcap"))


def _written(format: Format, done: Done, path: Path) -> None:
    """The whole clip where a file holds motion, else its first frame."""
    clip = Clip.load(done.clip / "clip.safetensors")
    if format.write_clip is not None:
        format.write_clip(path, clip)
    else:
        format.write(path, clip.frame(0).gaussians)


def _of(format: Format) -> Export:
    """The declaration of a format as an offer."""
    moves = format.write_clip is not None
    return Export(
        f"{format.title}, {'moving' if moves else 'at rest'}",
        f"Opens in {format.opens_in}",
        f"phy124-{format.name}{format.suffix}",
        partial(_written, format),
        lambda: format.installed,
        still=0.0 if moves else format.bytes_each,
        moving=format.bytes_each if moves else 0.0,
    )


EXPORTS = {
    "html": Export(
        "Player, one file", "Opens in any browser, offline", "player.html", _html,
        empty=1_310_000, still=28.0, moving=8.0,
    ),
    "ply": Export(
        "PLY sequence", "Opens in SuperSplat, brush, Unity", "phy124-ply.zip", _ply,
        moving=FORMATS["ply"].bytes_each,
    ),
    "mcap": Export(
        "MCAP", "Opens in Foxglove, ROS 2", "phy124.mcap", _mcap, _bridge, moving=60.0
    ),
    # The Gaussians at rest are among the files as a PLY already.
    **{name: _of(format) for name, format in written_formats().items() if name != "ply"},
}  # fmt: skip
