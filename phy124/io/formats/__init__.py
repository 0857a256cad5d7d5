"""All formats of files of Gaussians that are read or written.

`FORMATS` declares each of phy124's own once; the command line and the page list what is declared.
To add a still format, write a module with `read(path) -> Content` and
`encode(gaussians, *, antialiased) -> bytes` next to a table of its layout, both in the axes of the
file, and add a `Format` to `FORMATS`. A package registers its `Format` by an entry point of
`phy124.formats` (docs/guide/extending.md).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError, suggest
from phy124.gaussians import Gaussians
from phy124.io import ply
from phy124.io.axes import orientation, turned
from phy124.io.clip import Clip
from phy124.io.content import Y_UP, Content
from phy124.io.export import write_fourdgs, write_sequence, write_usd
from phy124.io.formats import compressed_ply, glb, sog, splat, spz
from phy124.io.formats.format import Format
from phy124.io.opening import obstacle
from phy124.io.plyheader import read_header
from phy124.progress import Progress, silent
from phy124.schema.plugins import list_plugins, load_plugin

__all__ = [
    "FORMATS",
    "Format",
    "endings",
    "formats",
    "is_file_of_gaussians",
    "read_as_is",
    "read_gaussians",
    "recognised",
    "rotation_of",
    "write_frames",
    "write_gaussians",
    "written_as",
    "written_formats",
]


FORMATS = {
    f.name: f
    for f in (
        Format(
            "ply", "3DGS PLY", ".ply", "everything, in float32",
            "SuperSplat, Blender and Unity add-ons, nearly every viewer", 68,
            objects="property `object_id`", read=ply.read, encode=ply.encode,
            signs=(b"ply\n", b"ply\r"),
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
            signs=(b"PK\x03\x04",),
        ),
        Format(
            "glb", "GLB", ".glb", "everything, in float32 (KHR_gaussian_splatting)",
            "PlayCanvas, Babylon.js, CesiumJS, glTF Sample Renderer", 60,
            objects="attribute `_OBJECT_ID`", axes=Y_UP, read=glb.read, encode=glb.encode,
            signs=(b"glTF",),
        ),
        Format(
            "usd", "OpenUSD", ".usdc", "everything, in float32, and its motion",
            "Isaac Sim, Omniverse, Houdini Solaris, Kaolin, Newton", 44,
            objects="primvar `objectId`", axes=("z", "x"), write_clip=write_usd, package="pxr",
            other_suffixes=(".usda", ".usd"),
        ),
        Format(
            "4dgs", "4DGS container", ".4dgs", "motion, within bounds that the file declares",
            "programs with the fourdgs libraries", 5,
            degree=0, axes=Y_UP, write_clip=write_fourdgs, package="fourdgs",
        ),
    )
}  # fmt: skip
"""Name -> format; of several with one suffix the first is written by that suffix."""
GZIP = b"\x1f\x8b\x08"
"""First bytes of what gzip packs."""
HEAD = 4096
"""Bytes that are looked at to recognise a file."""


def formats() -> dict[str, Format]:
    """Return all formats by name: phy124's own, then those that packages have registered.

    A registered format that cannot be loaded is left out, and none replaces one of phy124's own.
    """
    known = dict(FORMATS)
    for name in list_plugins("formats"):
        with suppress(InputError):
            plugin = load_plugin("formats", name)
            if name not in FORMATS and isinstance(plugin, Format):
                known[name] = replace(plugin, name=name)
    return known


def endings() -> tuple[str, ...]:
    """Return the endings of files that are read."""
    return tuple(dict.fromkeys(f.suffix for f in formats().values() if f.read))


def written_formats() -> dict[str, Format]:
    """Return the formats that are written, by name."""
    return {name: f for name, f in formats().items() if f.written}


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
    written = written_formats()
    if name is None:
        ending = path.suffix.lower()
        for chosen in written.values():
            if ending in (chosen.suffix, *chosen.other_suffixes):
                return chosen
        known = ", ".join(dict.fromkeys(f.suffix for f in written.values()))
        limit = "Its ending names no format that is written."
        raise InputError("output", path, limit, f"End the name in one of {known}.")
    if name not in written:
        load_plugin("formats", name)  # a broken plug-in says what is wrong with it
        raise InputError("to", name, "No such format is written.", suggest(name, list(written)))
    return written[name]


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
    known = formats()
    signed = _signed(known.values(), head, path.suffix.lower())
    if signed is FORMATS["ply"] and compressed_ply.is_compressed(read_header(path)):
        return FORMATS["compressed-ply"]
    if signed is not None:
        return signed
    if head.startswith(GZIP):
        limit = "It is packed by gzip, and no SPZ."
        raise InputError("file", path, limit, "Unpack it with gunzip, and give what is in it.")
    # Broken, or without a mark: its own reader says what is wrong.
    for named in known.values():
        if named.read and named.suffix == path.suffix.lower():
            return named
    if splat.likely(path):
        return FORMATS["splat"]
    limit = "It is no file of Gaussians that is read here."
    remedy = f"Give one of {', '.join(endings())}; splat-transform converts .ksplat and others."
    raise InputError("file", path, limit, remedy)


def _signed(known: Iterable[Format], head: bytes, ending: str) -> Format | None:
    """Return the format of a file's first bytes; of several, the one that has its ending."""
    signed = [f for f in known if f.signs and head.startswith(f.signs)]
    return next((f for f in signed if f.suffix == ending), signed[0] if signed else None)


def is_file_of_gaussians(name: str | os.PathLike[str]) -> bool:
    """Whether a name is that of a file of Gaussians: by its ending, else by its content."""
    path = Path(name)
    if path.suffix.lower() in endings():
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
