"""Meshes: triangles from a file, covered with flat Gaussians in the colours of their surface.

trimesh reads the file, in a process of its own that can be killed. The inside is filled as that of
every object (phy124/particles/solid.py), so a mesh need be neither closed nor without faults.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.shapes import covered
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.content import AGAIN, Y_UP, describe_coarseness, step_of
from phy124.io.opening import obstacle
from phy124.runtime import isolated
from phy124.runtime.installation import install_command

if TYPE_CHECKING:
    from trimesh import Trimesh

UPRIGHT = {"glb": Y_UP, "gltf": Y_UP, "obj": Y_UP, "stl": ("z", None), "ply": ("z", None)}
"""Kinds of files that are read, and their usual directions up and to the front."""
STL_HEAD, STL_ROW = 84, 50
"""Bytes of a binary STL before its triangles, the last four of which count them, and of each."""
LARGEST = 200_000_000
"""Bytes of a file; larger ones are refused before they are read."""
MOST_TRIANGLES = 2_000_000
TIME = isolated.Deadline(seconds=60.0)
"""How long reading may take."""
COUNT = 24_000
"""About how many Gaussians a mesh has: enough for edges that look straight."""
TRIES = 6
"""Points tried for each Gaussian, of which those are left that lie apart."""
SMALLEST = 1e-6
"""Smallest area of a mesh, in squares of its longest side."""
Drawn = tuple[NDArray[np.float64], NDArray[np.float64], "NDArray[np.float64] | None"]
"""Points [N,3], outward normals [N,3], and colours [N,3] from 0 to 1 if the file has some."""


def mesh(path: Path, colour: Sequence[float], *, seed: int = 0) -> Gaussians:
    """The Gaussians of a mesh around the origin, z up, with a longest side of 1 m.

    Args:
        path: A .glb, .gltf, .obj, .stl or .ply file.
        colour: Red, green and blue, 0..1, of a mesh that has no colours.
        seed: Of the places of the Gaussians.

    Raises:
        InputError: It cannot be read, is too large, or has no triangles to speak of.
    """
    _refuse(path)
    kind = _kind(path)
    try:
        drawn, coarse = isolated.run(_read, str(path), kind, seed, deadline=TIME)
    except isolated.Unfinished as error:
        raise _unusable(path, f"reading it {error}.", "Give a smaller mesh.") from None
    except ValueError as error:
        limit, _, remedy = str(error).partition("; ")
        raise _unusable(path, limit, remedy or "Save it again from the program.") from None
    if coarse:
        warnings.warn(f"{path}: {coarse}", stacklevel=2)
    points, normals, colours = drawn
    rgb = np.broadcast_to(np.asarray(colour, float), points.shape) if colours is None else colours
    low, high = points.min(axis=0), points.max(axis=0)
    made = covered((points - (low + high) / 2) / (high - low).max(), normals, rgb)
    return rotate_gaussians(made, orientation(*UPRIGHT[kind]))


def _kind(path: Path) -> str:
    """The kind of a file, by its first bytes if they tell, else by its ending.

    Raises:
        InputError: It is an STL that is cut short.
    """
    with open(path, "rb") as file:
        head = file.read(STL_HEAD)
    if head[:4] == b"glTF":
        return "glb"
    if head[:4] in (b"ply\n", b"ply\r"):
        return "ply"
    stated, there = int.from_bytes(head[80:], "little"), path.stat().st_size - STL_HEAD
    if head[:6].lower() == b"solid " or there == STL_ROW * stated:
        return "stl"
    kind = path.suffix.lower().removeprefix(".")
    if kind == "stl" and b"\0" in head and there < STL_ROW * stated:  # Texts have no zeros.
        limit = f"it is cut short: {max(there, 0) // STL_ROW:,} of {stated:,} triangles are there."
        raise _unusable(path, limit, AGAIN)
    return kind


def _refuse(path: Path) -> None:
    """Make sure that there is a file of meshes, and what reads it.

    Raises:
        InputError: There is not.
    """
    if path.suffix.lower().removeprefix(".") not in UPRIGHT:
        known = ", ".join(f".{name}" for name in UPRIGHT)
        raise _unusable(path, "it is no kind of mesh that is read.", f"Give one of {known}.")
    if hindrance := obstacle(path):
        raise _unusable(path, *hindrance)
    size = path.stat().st_size
    if not 0 < size <= LARGEST:
        limit = f"it has {size:,} bytes; a mesh has from 1 to {LARGEST:,}."
        raise _unusable(path, limit, "Give a simpler mesh." if size else "Save it again.")
    if find_spec("trimesh") is None:
        limit = "it needs the package trimesh, which is not installed."
        raise _unusable(path, limit, f"Run `{install_command('mesh')}`.")


def _unusable(path: Path, limit: str, remedy: str) -> InputError:
    return InputError("mesh", path, limit, remedy)


def _read(path: str, kind: str, seed: int) -> tuple[Drawn, str | None]:
    """Points all over a mesh, and a sentence if its file is too coarse; called in another process.

    Raises:
        ValueError: It cannot be used; the message has a limit and a remedy.
    """
    try:
        scene = _loaded(path, kind)
        shapes = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
        triangles = sum(len(getattr(one, "faces", ())) for one in shapes)
        pieces = scene.dump() if triangles <= MOST_TRIANGLES else []
    except MemoryError:
        raise ValueError("it needs more memory than there is.; Give a simpler mesh.") from None
    except Exception as error:
        said = f"{type(error).__name__}: {error}"[:200]
        raise ValueError(f"it cannot be read as a mesh ({said}).") from None
    if not triangles:
        remedy = "A file of Gaussians or points belongs to `file`."
        raise ValueError(f"it has no triangles.; {remedy}")
    if triangles > MOST_TRIANGLES:
        limit = f"it has {triangles:,} triangles, and {MOST_TRIANGLES:,} are allowed."
        raise ValueError(f"{limit}; Simplify it in the program that made it.")
    solids: Any = [one for one in pieces if len(getattr(one, "faces", ()))]
    drawn = _drawn(solids, seed)
    # Before its node moves it, a shape has the numbers of the file.
    largest: Any = max(shapes, key=lambda one: len(getattr(one, "faces", ())))
    return drawn, describe_coarseness(largest.vertices, step_of(largest.vertices))


def _loaded(path: str, kind: str) -> Any:
    """The scene of a file, in which trimesh may stumble over words and lines that mean nothing."""
    import trimesh
    from trimesh.resolvers import FilePathResolver

    try:
        return trimesh.load_scene(path, file_type=kind, process=False)
    except ValueError:
        if kind != "ply":
            raise
        beside = FilePathResolver(path)
        scene = trimesh.load_scene(_legible(path), file_type=kind, resolver=beside, process=False)
        if not any(len(getattr(one, "faces", ())) for one in scene.geometry.values()):
            raise
        return scene


def _legible(path: str) -> BytesIO:
    """A PLY without comments of any bytes and without blank lines."""
    head, end, body = Path(path).read_bytes().partition(b"end_header")
    lines = [line for line in head.splitlines() if line.strip() and _is_text(line)]
    if b"format ascii 1.0" in lines:
        body = b"\n".join([b"", *(line for line in body.splitlines() if line.strip()), b""])
    return BytesIO(b"\n".join([*lines, end]) + body)


def _is_text(line: bytes) -> bool:
    with suppress(UnicodeDecodeError):
        return bool(line.decode("utf-8"))
    return False


def _drawn(pieces: list[Trimesh], seed: int) -> Drawn:
    """Points that lie apart on all pieces of a mesh together.

    Raises:
        ValueError: A corner is not finite or is missing, or the pieces have no area.
    """
    for one in pieces:
        if one.faces.min() < 0 or one.faces.max() >= len(one.vertices):
            raise ValueError("a triangle has a corner that is not in the file.")
        if not np.isfinite(one.vertices[one.faces]).all():
            raise ValueError("a corner of a triangle is NaN or infinite.")
    corners = np.concatenate([one.triangles.reshape(-1, 3) for one in pieces])
    side = float(np.ptp(corners, axis=0).max())
    areas = np.concatenate([one.area_faces for one in pieces])
    if not areas.sum() > SMALLEST * side * side > 0:
        raise ValueError("its triangles have no area.")
    # Which way most triangles face: those of a mesh turned inside out face inwards.
    away = np.concatenate([one.triangles_center for one in pieces]) - corners.mean(axis=0)
    normals = np.concatenate([one.face_normals for one in pieces])
    sign = 1.0 if (areas * (away * normals).sum(axis=1)).sum() >= 0 else -1.0
    some = np.random.default_rng(seed)
    found = some.choice(len(areas), TRIES * COUNT, p=areas / areas.sum())
    weights = some.dirichlet((1.0, 1.0, 1.0), len(found))
    points = np.einsum("nc,nci->ni", weights, corners.reshape(-1, 3, 3)[found])
    kept = _apart(points, np.sqrt(areas.sum() / COUNT))
    found, weights = found[kept], weights[kept]
    return points[kept], sign * normals[found], _colours(pieces, found, weights)


def _apart(points: NDArray, width: float) -> NDArray[np.int64]:
    """One point of each cube of a width, that nearest to its middle: indices."""
    cubes = np.floor(points / width)
    off = np.linalg.norm(points / width - cubes - 0.5, axis=1)
    order = np.lexsort((off, *cubes.T))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(cubes[order], axis=0) != 0).any(axis=1)
    return order[first]


def _colours(
    pieces: list[Trimesh], found: NDArray[np.int64], weights: NDArray
) -> NDArray[np.float64] | None:
    """Colours [N,3] of points in triangles, of all pieces numbered on; None if none has any.

    Args:
        pieces: Parts of the mesh.
        found: The triangle of each point [N].
        weights: Where in its triangle each is [N,3].
    """
    ends = np.cumsum([0, *(len(one.faces) for one in pieces)])
    rgb, any_colour = np.full((len(found), 3), 0.8), False
    for one, start, stop in zip(pieces, ends, ends[1:], strict=False):
        own = (found >= start) & (found < stop)
        given = _coloured(one, found[own] - start, weights[own]) if own.any() else None
        if given is not None:
            rgb[own], any_colour = np.asarray(given, float)[:, :3] / 255, True
    return rgb if any_colour else None


def _coloured(one: Trimesh, triangles: NDArray, weights: NDArray) -> NDArray[Any] | None:
    """Colours [N,3 or 4] from 0 to 255 of points on a piece; None if it has none."""
    visual: Any = one.visual
    if visual.kind == "face":
        return visual.face_colors[triangles]
    if visual.kind == "vertex":
        return np.einsum("nc,nci->ni", weights, visual.vertex_colors[one.faces[triangles]])
    if visual.kind != "texture":
        return None
    material: Any = visual.material
    tint = np.asarray(material.main_color, float)[None, :3]
    if visual.uv is None or len(visual.uv) != len(one.vertices):
        return np.repeat(tint, len(triangles), axis=0)
    uv = np.einsum("nc,nci->ni", weights, visual.uv[one.faces[triangles]])
    texture = material.to_color(np.nan_to_num(uv)) if np.ndim(uv) == 2 else None
    if texture is None or np.ndim(texture) == 1:
        return np.repeat(tint, len(triangles), axis=0)
    factor = getattr(material, "baseColorFactor", None)
    return texture[:, :3] * (1.0 if factor is None else tint / 255)
