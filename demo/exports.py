"""Formats that are made on demand."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.io.export import write_ply_sequence
from phy124.io.export.html import write_html
from phy124.io.files import staged
from phy124.rendering.film import cameras
from phy124.rendering.stage.build import stage_of
from phy124.rendering.stage.packing import packed
from phy124.scene import View

from .work import Done, whole_in_view

BRIDGE = __name__.partition("demo")[0] + "bridge"
"""Name of the bridge's package: `bridge` in a checkout, `phy124_bridge` if installed."""
TAIL = 60.0
"""Longest time that the bridge may take [s]."""


def export(kind: str, done: Done) -> Path:
    """The file of one of `EXPORTS` for a finished run, made if it is not there yet.

    Raises:
        InputError: There is no such format, or it cannot be made.
    """
    if kind not in EXPORTS or not EXPORTS[kind].available():
        raise InputError("format", kind, "This format is not offered here.", "Choose another one.")
    path = done.films / EXPORTS[kind].file
    if not path.exists():
        with staged(done.films) as folder:
            EXPORTS[kind].write(done, folder / path.name)
    return path


@dataclass(frozen=True)
class Export:
    """A format made on demand."""

    label: str
    hint: str
    file: str
    write: Callable[[Done, Path], None]
    available: Callable[[], bool] = lambda: True


def _html(done: Done, path: Path) -> None:
    clip = Clip.load(done.clip / "clip.safetensors")
    view = whole_in_view(clip, View.model_validate(clip.scene["view"]))
    around = packed(stage_of(clip, view), clip)
    first = cameras(clip, view, "front")[0]
    write_html(path, clip, first, background=view.background, stage=around)


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


EXPORTS = {
    "html": Export("Player, one file", "Plays offline in any browser", "player.html", _html),
    "ply": Export("PLY sequence", "SuperSplat, brush, Unity", "phy124-ply.zip", _ply),
    "mcap": Export("MCAP", "ROS 2, Foxglove", "phy124.mcap", _mcap, _bridge),
}
