"""All formats that are read or written: `FORMATS` declares each once.

The command line, the page and docs/guide/formats.md show what stands here. To add a still format,
write a module with `read(path) -> Content` and `encode(gaussians, *, antialiased) -> bytes` beside
a table of its layout, both in the axes of the file, and add a line to `FORMATS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError, suggest
from phy124.gaussians import Frame, Gaussians
from phy124.io import ply
from phy124.io.axes import orientation, turned
from phy124.io.clip import Clip
from phy124.io.content import Y_DOWN, Y_UP, Content
from phy124.io.export import write_fourdgs, write_sequence, write_usd
from phy124.io.files import replacing
from phy124.io.formats import compressed_ply, glb, sog, splat, spz
from phy124.io.opening import obstacle
from phy124.io.plyheader import read_header
from phy124.progress import Progress, silent


class Encoder(Protocol):
    """Makes the bytes of a file from Gaussians in the file's axes."""

    def __call__(self, gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
        """The bytes."""
        ...


class ClipWriter(Protocol):
    """Writes all frames into one file."""

    def __call__(self, path: Path, clip: Clip, *, progress: Progress = silent) -> None:
        """Write a clip in our axes."""
        ...


@dataclass(frozen=True)
class Format:
    """One format of files of Gaussians."""

    name: str
    """Name in commands."""
    title: str
    suffix: str
    holds: str
    """What of a Gaussian it holds, and how exactly."""
    opens_in: str
    """Programs that read it."""
    bytes_each: float
    """Bytes that a Gaussian of degree 0 takes per frame, as the duck has them."""
    degree: int = 3
    """Highest degree of the harmonics it holds."""
    objects: str = ""
    """Where it keeps the object of each Gaussian; empty if it does not."""
    axes: tuple[str, str] = Y_DOWN
    """Directions of its files that point up and to the front."""
    read: Callable[[Path], Content] | None = None
    encode: Encoder | None = None
    write_clip: ClipWriter | None = None
    """Writes all frames into one file; None if it holds one instant."""
    package: str | None = None
    """What must be installed besides phy124 to write it."""

    @property
    def installed(self) -> bool:
        """Whether what it needs to be written is there."""
        return self.package is None or find_spec(self.package) is not None

    @property
    def written(self) -> bool:
        """Whether this program writes it."""
        return self.encode is not None or self.write_clip is not None

    def write(self, path: Path, gaussians: Gaussians, *, antialiased: bool = False) -> None:
        """Write one instant; the file appears whole or not at all."""
        if self.encode is None:
            assert self.write_clip is not None, f"{self.name} is not written"
            return self.write_clip(path, Clip.from_frames([Frame(0, 0.0, gaussians)]))
        there = turned(gaussians, orientation(*self.axes).T)
        with replacing(path) as temporary:
            temporary.write_bytes(self.encode(there, antialiased=antialiased))


FORMATS = {
    f.name: f
    for f in (
        Format(
            "ply", "3DGS PLY", ".ply", "everything, in float32",
            "SuperSplat, Blender and Unity add-ons, nearly every viewer", 68,
            objects="property `object_id`", read=ply.read, encode=ply.encode,
        ),
        Format(
            "compressed-ply", "compressed PLY of SuperSplat", ".ply",
            "centres and scales in 10 or 11 bits of a box of 256 Gaussians",
            "PlayCanvas, SuperSplat, Spark, Babylon.js", 17, read=compressed_ply.read,
        ),
        Format(
            "splat", ".splat", ".splat", "centres and scales in float32, the rest in bytes",
            "antimatter15/splat, gsplat.js, nearly every web viewer", 32,
            degree=0, read=splat.read, encode=splat.encode,
        ),
        Format(
            "spz", "SPZ 3", ".spz", "centres in 24 bits, scales in steps of 6.5 %, others in bytes",
            "Unreal Editor for Fortnite, Babylon.js, Cesium, Spark, TouchDesigner", 12,
            axes=Y_UP, read=spz.read, encode=spz.encode,
        ),
        Format(
            "spz4", "SPZ 4", ".spz", "as SPZ 3, packed by Zstandard",
            "Babylon.js, splat-transform, programs with Niantic's library of 2026", 12,
            axes=Y_UP, read=spz.read, encode=spz.encode_v4,
        ),
        Format(
            "sog", "SOG 2", ".sog", "centres in 16 bits, the rest by codebooks of 256 values",
            "PlayCanvas, SuperSplat, Spark, Babylon.js", 7.3,
            objects="picture `object_id.webp`, named in `extras`", read=sog.read, encode=sog.encode,
        ),
        Format(
            "glb", "GLB", ".glb", "everything, in float32 (KHR_gaussian_splatting)",
            "PlayCanvas, Babylon.js, CesiumJS, glTF Sample Renderer", 60,
            objects="attribute `_OBJECT_ID`", axes=Y_UP, read=glb.read, encode=glb.encode,
        ),
        Format(
            "usd", "OpenUSD", ".usdc", "everything, in float32, and its motion",
            "Isaac Sim, Omniverse, Houdini Solaris, Kaolin, Newton", 44,
            objects="primvar `objectId`", axes=("z", "x"), write_clip=write_usd, package="pxr",
        ),
        Format(
            "4dgs", "4DGS container", ".4dgs", "motion, within bounds that the file declares",
            "programs with the fourdgs libraries", 5,
            degree=0, axes=Y_UP, write_clip=write_fourdgs, package="fourdgs",
        ),
    )
}  # fmt: skip
"""Name -> format; of several with one suffix the first is written by that suffix."""
ENDINGS = tuple(dict.fromkeys(f.suffix for f in FORMATS.values() if f.read))
"""Endings of files that are read."""
OTHER_ENDINGS = {".usda": "usd", ".usd": "usd"}
WRITTEN = tuple(name for name, f in FORMATS.items() if f.written)
MAGIC = {b"ply\n": "ply", b"ply\r": "ply", b"glTF": "glb", b"PK\x03\x04": "sog"}
"""First bytes of a file -> its format."""
GZIP = b"\x1f\x8b\x08"
"""First bytes of what gzip packs."""
HEAD = 4096
"""Bytes that are looked at to recognise a file."""


def read_gaussians(
    path: str | os.PathLike[str],
    *,
    up: str | None = None,
    front: str | None = None,
    dialect: str | None = None,
    rotate: str | None = None,
) -> Content:
    """Read a file of Gaussians of any known format, which its content tells, into our axes.

    Args:
        path: The file.
        up: Direction in the file that points up; absent: as the file or its format says.
        front: Direction in the file that the object's front faces.
        dialect: The program that wrote a PLY, used where `up` is not given.
        rotate: Rotation applied to the file before, as `phy124.io.axes.orientation` takes it.

    Raises:
        InputError: If the file is missing, damaged or of an unknown format, or the options
            contradict each other.
    """
    orientation(up, front if up else None, dialect, rotate)  # refuses before the file is read
    content = read_as_is(path).in_place
    rotation = rotation_of(content, up, front, dialect, rotate)
    x, y, z = (rotation @ content.origin).tolist()
    found = turned(content.gaussians, rotation)
    return content._replace(gaussians=found, axes=("z", "x"), origin=(x, y, z))


def read_as_is(path: str | os.PathLike[str]) -> Content:
    """Read a file of Gaussians in its own axes.

    Raises:
        InputError: If the file is missing, damaged or of an unknown format.
    """
    path = Path(path)
    read = recognised(path).read
    assert read is not None
    return read(path)


def rotation_of(
    content: Content, up: str | None, front: str | None, dialect: str | None, rotate: str | None
) -> NDArray[np.float64]:
    """The rotation [3,3] from a file's axes to ours.

    Args:
        content: What was read from it.
        up: Direction that points up, if the user has said so.
        front: Direction of the front, likewise.
        dialect: The program that wrote it, likewise.
        rotate: Rotation before that, likewise.

    Raises:
        InputError: If they contradict each other.
    """
    if up is None and dialect is None:
        up, front = content.axes[0], front or content.axes[1]
    return orientation(up, front, dialect, rotate)


def write_gaussians(
    path: str | os.PathLike[str],
    gaussians: Gaussians,
    format: str | None = None,
    *,
    antialiased: bool = False,
) -> Format:
    """Write Gaussians in our axes; returns the format.

    Args:
        path: The file; it appears whole or not at all.
        gaussians: What to write.
        format: Name in `FORMATS`; absent: by the ending of the path.
        antialiased: Whether they were trained with Mip-Splatting's filter.

    Raises:
        InputError: If the format is unknown, needs a package that is not installed, or the file
            cannot be written.
    """
    chosen = written_as(Path(path), format)
    chosen.write(Path(path), gaussians, antialiased=antialiased)
    return chosen


def written_as(path: Path, name: str | None = None) -> Format:
    """The format of a name, or of the ending of a path.

    Raises:
        InputError: If there is none, or it is not written.
    """
    if name is None:
        ending = path.suffix.lower()
        name = OTHER_ENDINGS.get(ending) or next(
            (known for known in WRITTEN if FORMATS[known].suffix == ending), None
        )
        if name is None:
            endings = ", ".join(dict.fromkeys(FORMATS[known].suffix for known in WRITTEN))
            limit = "Its ending names no format that is written."
            raise InputError("output", path, limit, f"End the name in one of {endings}.")
    if name not in WRITTEN:
        raise InputError("to", name, "No such format is written.", suggest(name, WRITTEN))
    return FORMATS[name]


def recognised(path: Path) -> Format:
    """The format of a file, by its first bytes; `.splat`, which has no mark, by its rows.

    Raises:
        InputError: If the file is missing or of no format that is read.
    """
    if hindrance := obstacle(path):
        limit, remedy = hindrance
        raise InputError("file", path, limit[0].upper() + limit[1:], remedy)
    with open(path, "rb") as file:
        head = file.read(HEAD)
    if spz.begins(head):
        return FORMATS["spz"]
    name = MAGIC.get(head[:4])
    if name == "ply" and compressed_ply.is_compressed(read_header(path)):
        return FORMATS["compressed-ply"]
    if head.startswith(GZIP):
        limit = "It is packed by gzip, and no SPZ."
        raise InputError("file", path, limit, "Unpack it with gunzip, and give what is in it.")
    if name is None and path.suffix.lower() in ENDINGS:
        # Broken, or without a mark: its own reader says what is wrong.
        name = next(known for known, f in FORMATS.items() if f.suffix == path.suffix.lower())
    if name is None and splat.likely(path):
        name = "splat"
    if name is None:
        limit = "It is no file of Gaussians that is read here."
        remedy = f"Give one of {', '.join(ENDINGS)}; splat-transform converts .ksplat and others."
        raise InputError("file", path, limit, remedy)
    return FORMATS[name]


def is_file_of_gaussians(name: str | os.PathLike[str]) -> bool:
    """Whether a name is that of a file of Gaussians: by its ending, else by its content."""
    path = Path(name)
    if path.suffix.lower() in ENDINGS:
        return True
    try:
        return recognised(path).read is not None
    except (InputError, OSError, ValueError):
        return False


def write_frames(
    path: Path, clip: Clip, chosen: Format, *, name: str = "frame", progress: Progress = silent
) -> list[str]:
    """Write every frame of a clip as a file of its own; returns their names.

    Args:
        path: A new or empty folder, or a name ending in .zip.
        clip: What to write.
        chosen: The format of the files.
        name: What the file names start with.
        progress: Called as ("export", frames done, frames in all).

    Raises:
        InputError: If the clip is empty, or the files cannot be written.
    """
    return write_sequence(
        path, clip, partial(_write, chosen), chosen.suffix, name=name, progress=progress
    )


def _write(chosen: Format, path: Path, gaussians: Gaussians) -> None:
    chosen.write(path, gaussians)
