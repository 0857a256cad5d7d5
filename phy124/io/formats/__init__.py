"""Declares the formats in which files of Gaussians are read or written.

To add a format for single frames, write a module with the functions `read(path) -> Content` and
`encode(gaussians, *, antialiased) -> bytes`, both in the axes of the file, and add a `Format` to
`FORMATS`. A package registers its own `Format` with an entry point in the group `phy124.formats`
(docs/guide/extending-files.md).
"""

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError, suggest
from phy124.gaussians import Frame, Gaussians
from phy124.io import ply
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from phy124.io.content import Y_DOWN, Y_UP, Content
from phy124.io.files import replacing
from phy124.io.flaws import hide_flaws
from phy124.io.formats import compressed_ply, glb, mesh, sog, splat, spz
from phy124.io.formats.fourdgs import write_fourdgs
from phy124.io.formats.lattice4d import write_lattice4d
from phy124.io.formats.moving_mesh import write_moving_mesh
from phy124.io.formats.usd import write_usd
from phy124.io.formats.usdz import write_usdz
from phy124.io.opening import obstacle
from phy124.io.plyheader import read_header
from phy124.progress import Progress, silent
from phy124.schema.plugins import list_plugins, load_plugin


class Encoder(Protocol):
    """Encodes Gaussians as the bytes of a file; the Gaussians must be in the axes of the file."""

    def __call__(self, gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
        """Return the bytes of the encoded file."""
        ...


@dataclass(frozen=True)
class Format:
    """A format for files of Gaussians, with its reader and its writers."""

    name: str
    title: str
    suffix: str
    holds: str
    """Properties of the Gaussians that a file stores, and their precision."""
    opens_in: str
    """Programs that read the format."""
    bytes_each: float
    """Size of a file per frame and per Gaussian of degree 0 [bytes], measured with the example
    duck.
    """
    bytes_fixed: float = 0.0
    """Size of a file per frame, apart from its Gaussians [bytes]."""
    degree: int = 3
    """Highest degree of spherical harmonics that the format can store."""
    objects: str = ""
    """Name of the field with the object index of each Gaussian; empty if there is no such field."""
    axes: tuple[str, str] = Y_DOWN
    """Up and front directions that the format prescribes."""
    read: Callable[[Path], Content] | None = None
    encode: Encoder | None = None
    write_clip: Callable[..., list[str] | None] | None = None
    """Function that writes all frames of a clip in the axes of phy124 into one file, and may return
    notes; None if a file stores only one frame.
    """
    draws: bool = False
    """Whether `write_clip` has the keyword `frames`, because a file stores the colour and opacity
    of each Gaussian in each frame.
    """
    package: str | None = None
    """Package that must be installed to write the format; None if no package is needed."""
    signs: tuple[bytes, ...] = ()
    """Possible first bytes of a file; empty if only its extension identifies the format."""
    other_suffixes: tuple[str, ...] = ()

    @property
    def installed(self) -> bool:
        """Whether the package that writes the format is installed."""
        return self.package is None or find_spec(self.package) is not None

    @property
    def written(self) -> bool:
        """Whether phy124 can write the format."""
        return self.encode is not None or self.write_clip is not None

    def write(self, path: Path, gaussians: Gaussians, *, antialiased: bool = False) -> None:
        """Write one frame to a file atomically; Gaussians with NaN or infinite values are hidden.

        Raises:
            InputError: No Gaussian has finite values, or the file cannot be written.
        """
        clip, _ = hide_flaws(Clip.from_frames([Frame(0, 0.0, gaussians)]))
        if self.encode is None:
            assert self.write_clip is not None, f"{self.name} is not written"
            self.write_clip(path, clip)
            return
        there = rotate_gaussians(clip.frame(0).gaussians, orientation(*self.axes).T)
        with replacing(path) as temporary:
            temporary.write_bytes(self.encode(there, antialiased=antialiased))

    def write_motion(
        self,
        path: Path,
        clip: Clip,
        frames: Iterable[Frame] | None = None,
        *,
        progress: Progress = silent,
    ) -> list[str]:
        """Write all frames into one file atomically; return notes about the file.

        Args:
            path: The file.
            clip: The clip.
            frames: The frames as they are drawn, which are used if `draws` is set; None: the clip's
                own frames.
            progress: Function that is called as progress("export", steps done, total steps).
        """
        assert self.write_clip is not None, f"{self.name} stores no motion"
        drawn = {"frames": frames} if self.draws else {}
        return self.write_clip(path, clip, progress=progress, **drawn) or []


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
            "centres and scales in 10 or 11 bits, relative to a box around 256 Gaussians",
            "PlayCanvas, SuperSplat, Spark, Babylon.js", 17, read=compressed_ply.read,
        ),
        Format(
            "splat", ".splat", ".splat", "centres and scales in float32, the rest in bytes",
            "antimatter15/splat, gsplat.js, nearly every web viewer", 32,
            degree=0, read=splat.read, encode=splat.encode,
        ),
        Format(
            "spz", "SPZ 3", ".spz",
            "centres in 24 bits, scales from 0.05 mm to 380 m in steps of 6.5 %, others in bytes",
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
            objects="primvar `objectId`", axes=("z", "x"), write_clip=write_usd, draws=True,
            package="pxr", other_suffixes=(".usda", ".usd"),
        ),
        Format(
            "4dgs", "4DGS container", ".4dgs", "motion, within bounds that the file declares",
            "programs with the fourdgs libraries", 5,
            degree=0, axes=Y_UP, write_clip=write_fourdgs, draws=True,
            package="fourdgs",
        ),
        Format(
            "p4d", "P4D", ".p4d", "first frame as SOG, and motion to 0.1 % of the size",
            "programs with one of the guide's readers, each of 100 lines", 0.6, bytes_fixed=2_000,
            degree=0, write_clip=write_lattice4d,
        ),
        Format(
            "mesh", "mesh (GLB)", ".glb", "surface of each frame with colours, watertight",
            "Blender, Unity, Unreal, three.js, nearly every 3D program", 0, 800_000,
            degree=0, axes=Y_UP, encode=partial(mesh.encode, kind="glb"), package="skimage",
        ),
        Format(
            "mesh-obj", "mesh (OBJ)", ".obj", "surface of each frame with colours, watertight",
            "Blender, MeshLab, Maya, Houdini", 0, 2_000_000,
            degree=0, axes=Y_UP, encode=partial(mesh.encode, kind="obj"), package="skimage",
        ),
        Format(
            "mesh-ply", "mesh (PLY)", ".ply", "surface of each frame with colours, watertight",
            "Blender, MeshLab, CloudCompare, Open3D", 0, 800_000,
            degree=0, axes=("z", "x"), encode=partial(mesh.encode, kind="ply"), package="skimage",
        ),
        Format(
            "moving-mesh", "animated mesh (GLB)", ".glb",
            "surface of the first frame with colours, and its motion",
            "Blender, Unity, three.js, model-viewer, Windows 3D Viewer", 0, 140_000,
            degree=0, axes=Y_UP, write_clip=write_moving_mesh, package="skimage",
        ),
        Format(
            "usdz", "animated mesh (USDZ)", ".usdz",
            "surface of the first frame with colours, and its motion",
            "OpenUSD, Blender", 0, 150_000,
            degree=0, axes=Y_UP, write_clip=write_usdz, package="pxr",
        ),
    )
}  # fmt: skip
"""All formats of phy124 by name.

If several formats have the same suffix, a file name with this suffix selects the first of them.
"""
MESH_ENDINGS = (".gltf", ".obj", ".stl")
"""Extensions of files that can only be meshes; .glb and .ply may contain either."""
GZIP = b"\x1f\x8b\x08"
HEAD = 4096


def formats() -> dict[str, Format]:
    """Return all formats by name: first the formats of phy124, then formats of other packages.

    A registered format is ignored if it fails to load or if phy124 has a format of the same name.
    """
    known = dict(FORMATS)
    for name in list_plugins("formats"):
        with suppress(InputError):
            plugin = load_plugin("formats", name)
            if name not in FORMATS and isinstance(plugin, Format):
                known[name] = replace(plugin, name=name)
    return known


def object_endings() -> tuple[str, ...]:
    """Return the file name extensions of all formats of Gaussians and meshes that can be read."""
    return (*endings(), *MESH_ENDINGS)


def endings() -> tuple[str, ...]:
    """Return the file name extensions of all formats that can be read."""
    return tuple(dict.fromkeys(f.suffix for f in formats().values() if f.read))


def written_formats() -> dict[str, Format]:
    """Return the formats that can be written, by name."""
    return {name: f for name, f in formats().items() if f.written}


def read_gaussians(
    path: str | os.PathLike[str],
    *,
    up: str | None = None,
    front: str | None = None,
    dialect: str | None = None,
    rotate: str | None = None,
) -> Content:
    """Read a file of Gaussians of any format, and convert it to the axes of phy124.

    Args:
        path: The file.
        up: Direction in the file that points up; default: the up direction of the file or its
            format.
        front: Direction of the object's front, in the file's axes.
        dialect: The program that wrote a PLY file, used if `up` is None.
        rotate: Rotation that is applied first, in the notation of `phy124.io.axes.orientation`.

    Raises:
        InputError: If the file is missing, damaged or of an unknown format, or if the options
            contradict each other.
    """
    # raise an error for bad options before the file is read
    orientation(up, front if up else None, dialect, rotate)
    content = read_as_is(path).in_place
    rotation = rotation_of(content, up, front, dialect, rotate)
    x, y, z = (rotation @ content.origin).tolist()
    gaussians = rotate_gaussians(content.gaussians, rotation)
    return content._replace(gaussians=gaussians, axes=("z", "x"), origin=(x, y, z))


def read_as_is(path: str | os.PathLike[str]) -> Content:
    """Read a file of Gaussians without converting the axes of the file.

    Raises:
        InputError: If the file is missing, damaged or of an unknown format.
    """
    path = Path(path)
    read = recognise(path).read
    assert read is not None
    return read(path)


def rotation_of(
    content: Content, up: str | None, front: str | None, dialect: str | None, rotate: str | None
) -> NDArray[np.float64]:
    """Return the rotation [3,3] from the axes of a file to the axes of phy124.

    Args:
        content: Content of the file.
        up: Direction that points up, if the user chose it.
        front: Direction that the object faces, if the user chose it.
        dialect: The program that wrote the file, if the user chose it.
        rotate: Rotation that is applied first, if the user chose one.

    Raises:
        InputError: If the options contradict each other.
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
    """Write Gaussians that are in the axes of phy124, and return the format of the file.

    Args:
        path: The file, which is written atomically.
        gaussians: The Gaussians to write.
        format: Name of the format in `FORMATS`; default: the format with the path's extension.
        antialiased: Whether the Gaussians were trained with Mip-Splatting's filter.

    Raises:
        InputError: If the format is unknown or needs a package that is not installed, or the file
            cannot be written.
    """
    chosen = find_written_format(Path(path), format)
    chosen.write(Path(path), gaussians, antialiased=antialiased)
    return chosen


def find_written_format(
    path: Path, name: str | None = None, *, others: Sequence[str] = ()
) -> Format:
    """Return the format that has this name, or the format for the extension of a path.

    Args:
        path: The file that will be written.
        name: Name of the format; if None, the extension of the path determines the format.
        others: Further names that the caller accepts; they are also listed in error messages.

    Raises:
        InputError: If the format does not exist, or can only be read.
    """
    written = written_formats()
    if name is None:
        ending = path.suffix.lower()
        for chosen in written.values():
            if ending in (chosen.suffix, *chosen.other_suffixes):
                return chosen
        known = ", ".join(dict.fromkeys(f.suffix for f in written.values()))
        limit = "phy124 cannot write a format with this file name extension."
        raise InputError("output", path, limit, f"Use one of the extensions {known}.")
    if name not in written:
        load_plugin("formats", name)  # raises an error that describes a broken plug-in
        raise InputError(
            "to", name, "This output format is not supported.", suggest(name, [*written, *others])
        )
    return written[name]


def recognise(path: Path) -> Format:
    """Recognise the format of a file by its first bytes or, for `.splat`, by its rows.

    Raises:
        InputError: If the file is missing or its format cannot be read.
    """
    if hindrance := obstacle(path):
        limit, remedy = hindrance
        raise InputError("file", path, limit[0].upper() + limit[1:], remedy)
    with open(path, "rb") as file:
        head = file.read(HEAD)
    if spz.begins(head):
        return FORMATS["spz"]
    known = formats()
    signed = _match_signature(known.values(), head, path.suffix.lower())
    if signed is FORMATS["ply"] and compressed_ply.is_compressed(read_header(path)):
        return FORMATS["compressed-ply"]
    if signed is not None:
        return signed
    if head.startswith(GZIP):
        limit = "It is compressed by gzip, but is not an SPZ file."
        raise InputError(
            "file", path, limit, "Unpack the file with gunzip, and give the unpacked file."
        )
    # The file is damaged or has no signature. The reader for its extension reports any damage.
    for chosen in known.values():
        if chosen.read and chosen.suffix == path.suffix.lower():
            return chosen
    if splat.likely(path):
        return FORMATS["splat"]
    limit = "It is not a file of Gaussians in a format that phy124 can read."
    remedy = f"Give one of {', '.join(endings())}; splat-transform converts .ksplat and others."
    raise InputError("file", path, limit, remedy)


def _match_signature(known: Iterable[Format], head: bytes, ending: str) -> Format | None:
    signed = [f for f in known if f.signs and head.startswith(f.signs)]
    return next((f for f in signed if f.suffix == ending), signed[0] if signed else None)


def is_file_of_gaussians(name: str | os.PathLike[str]) -> bool:
    """Return whether a file contains Gaussians or a mesh, judged by its extension or content."""
    path = Path(name)
    if path.suffix.lower() in object_endings():
        return True
    try:
        return recognise(path).read is not None
    except (InputError, OSError, ValueError):
        return False
