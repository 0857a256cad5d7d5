"""Covers a triangle mesh from a file with flat Gaussians in the colours of its surface.

trimesh reads the file in a separate process, which is killed if it takes too long. The interior is
filled as for every object (phy124/particles/solid.py); the mesh may therefore have holes and other
defects.
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
from phy124.generators.shapes import choose_triangles, cover_surface
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.content import AGAIN, Y_UP, describe_coarseness, step_of
from phy124.io.opening import obstacle
from phy124.runtime import isolated
from phy124.runtime.installation import install_command

if TYPE_CHECKING:
    from trimesh import Trimesh

UPRIGHT = {"glb": Y_UP, "gltf": Y_UP, "obj": Y_UP, "stl": ("z", None), "ply": ("z", None)}
"""Up and front directions by file format."""
STL_HEAD, STL_ROW = 84, 50
"""Sizes of a binary STL's header, which ends with the number of triangles, and of one triangle
[bytes]."""
LARGEST = 200_000_000
"""Largest file size [bytes]; larger files are refused before they are read."""
MOST_TRIANGLES = 2_000_000
TIME = isolated.Deadline(seconds=60.0)
"""Time limit for reading a mesh."""
COUNT = 24_000
"""Approximate number of Gaussians, enough to make edges look straight."""
SMALLEST = 1e-6
"""Smallest area of a mesh divided by its longest side squared."""
Drawn = tuple[NDArray[np.float64], NDArray[np.float64], "NDArray[np.float64] | None"]
"""Points [N,3], outward normals [N,3], and colours [N,3] in 0..1, or None without colours."""


def mesh(path: Path, colour: Sequence[float], *, seed: int = 0) -> Gaussians:
    """Make Gaussians of a mesh, centred on the origin, z up, with a longest side of 1 m.

    Args:
        path: A .glb, .gltf, .obj, .stl or .ply file.
        colour: Red, green and blue, 0..1, used if the mesh has no colours.
        seed: Seed of the Gaussians' positions.

    Raises:
        InputError: If the mesh cannot be read, is too large, or has no area.
    """
    _refuse(path)
    kind = _kind(path)
    try:
        drawn, coarse = isolated.run(_read, str(path), kind, seed, deadline=TIME)
    except isolated.Unfinished as error:
        raise _unusable(path, f"reading it {error}.", "Give a smaller mesh.") from None
    except ValueError as error:
        limit, _, remedy = str(error).partition("; ")
        raise _unusable(
            path, limit, remedy or "Save it again from the program that made it."
        ) from None
    if coarse:
        warnings.warn(f"{path}: {coarse}", stacklevel=2)
    points, normals, colours = drawn
    rgb = np.broadcast_to(np.asarray(colour, float), points.shape) if colours is None else colours
    low, high = points.min(axis=0), points.max(axis=0)
    made = cover_surface((points - (low + high) / 2) / (high - low).max(), normals, rgb)
    return rotate_gaussians(made, orientation(*UPRIGHT[kind]))


def _kind(path: Path) -> str:
    """Return the format of a file, from its first bytes if possible, else from its extension.

    Raises:
        InputError: If an STL file is cut short.
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
    if kind == "stl" and b"\0" in head and there < STL_ROW * stated:  # text files have no zeros
        limit = (
            f"it is cut short: {max(there, 0) // STL_ROW:,} of {stated:,} triangles are present."
        )
        raise _unusable(path, limit, AGAIN)
    return kind


def _refuse(path: Path) -> None:
    """Raise an error if a file is not a mesh or is unreadable, or if trimesh is not installed.

    Raises:
        InputError: If the file or the package is missing or unusable.
    """
    if path.suffix.lower().removeprefix(".") not in UPRIGHT:
        known = ", ".join(f".{name}" for name in UPRIGHT)
        raise _unusable(
            path, "it is not a mesh in a format that phy124 reads.", f"Give one of {known}."
        )
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
    """Sample points of a mesh and check its resolution; runs in a separate process.

    Raises:
        ValueError: If the mesh is unusable; its message is "limit; remedy".
    """
    try:
        scene = _load(path, kind)
        shapes = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
        triangles = sum(len(getattr(piece, "faces", ())) for piece in shapes)
        pieces = scene.dump() if triangles <= MOST_TRIANGLES else []
    except MemoryError:
        raise ValueError("it needs more memory than is free.; Give a simpler mesh.") from None
    except Exception as error:
        message = f"{type(error).__name__}: {error}"[:200]
        raise ValueError(f"it cannot be read as a mesh ({message}).") from None
    if not triangles:
        remedy = "For a file of Gaussians or points, use the generator `file`."
        raise ValueError(f"it has no triangles.; {remedy}")
    if triangles > MOST_TRIANGLES:
        limit = f"it has {triangles:,} triangles, and {MOST_TRIANGLES:,} are allowed."
        raise ValueError(f"{limit}; Simplify it in the program that made it.")
    solids: Any = [piece for piece in pieces if len(getattr(piece, "faces", ()))]
    drawn = _sample_surface(solids, seed)
    # The vertices of `shapes` are in the file's coordinates, before any transform of a node.
    largest: Any = max(shapes, key=lambda piece: len(getattr(piece, "faces", ())))
    return drawn, describe_coarseness(largest.vertices, step_of(largest.vertices))


def _load(path: str, kind: str) -> Any:
    """Load the scene of a file; if a PLY fails, retry without its comments and blank lines."""
    import trimesh
    from trimesh.resolvers import FilePathResolver

    try:
        return trimesh.load_scene(path, file_type=kind, process=False)
    except ValueError:
        if kind != "ply":
            raise
        files = FilePathResolver(path)
        scene = trimesh.load_scene(_legible(path), file_type=kind, resolver=files, process=False)
        if not any(len(getattr(piece, "faces", ())) for piece in scene.geometry.values()):
            raise
        return scene


def _legible(path: str) -> BytesIO:
    """Return the content of a PLY without blank lines and comments that are not UTF-8."""
    head, end, body = Path(path).read_bytes().partition(b"end_header")
    lines = [line for line in head.splitlines() if line.strip() and _is_text(line)]
    if b"format ascii 1.0" in lines:
        body = b"\n".join([b"", *(line for line in body.splitlines() if line.strip()), b""])
    return BytesIO(b"\n".join([*lines, end]) + body)


def _is_text(line: bytes) -> bool:
    with suppress(UnicodeDecodeError):
        return bool(line.decode("utf-8"))
    return False


def _sample_surface(pieces: list[Trimesh], seed: int) -> Drawn:
    """Sample evenly spaced points on all pieces of a mesh.

    Raises:
        ValueError: If a corner is not finite or does not exist, or the pieces have no area.
    """
    for piece in pieces:
        if piece.faces.min() < 0 or piece.faces.max() >= len(piece.vertices):
            raise ValueError("a triangle refers to a vertex that is not in the file.")
        if not np.isfinite(piece.vertices[piece.faces]).all():
            raise ValueError("a vertex of a triangle is NaN or infinite.")
    corners = np.concatenate([piece.triangles.reshape(-1, 3) for piece in pieces])
    side = float(np.ptp(corners, axis=0).max())
    areas = np.concatenate([piece.area_faces for piece in pieces])
    if not areas.sum() > SMALLEST * side * side > 0:
        raise ValueError("its triangles have no area.")
    # If most of the area faces the centre, the mesh is inside out, and its normals are reversed.
    away = np.concatenate([piece.triangles_center for piece in pieces]) - corners.mean(axis=0)
    normals = np.concatenate([piece.face_normals for piece in pieces])
    sign = 1.0 if (areas * (away * normals).sum(axis=1)).sum() >= 0 else -1.0
    triangles = corners.reshape(-1, 3, 3)
    chosen, weights = choose_triangles(triangles, COUNT, seed)
    points = np.einsum("nc,nci->ni", weights, triangles[chosen])
    return points, sign * normals[chosen], _colours(pieces, chosen, weights)


def _colours(
    pieces: list[Trimesh], chosen: NDArray[np.int64], weights: NDArray
) -> NDArray[np.float64] | None:
    """Return the colours [N,3] of points in triangles; None if no piece has colours.

    Args:
        pieces: Pieces of the mesh, whose triangles are numbered consecutively.
        chosen: Index of the triangle of each point [N].
        weights: Barycentric coordinates of each point [N,3].
    """
    ends = np.cumsum([0, *(len(piece.faces) for piece in pieces)])
    rgb, any_colour = np.full((len(chosen), 3), 0.8), False
    for piece, start, stop in zip(pieces, ends, ends[1:], strict=False):
        within = (chosen >= start) & (chosen < stop)
        if not within.any():
            continue
        colours = _colour_piece(piece, chosen[within] - start, weights[within])
        if colours is not None:
            rgb[within], any_colour = np.asarray(colours, float)[:, :3] / 255, True
    return rgb if any_colour else None


def _colour_piece(piece: Trimesh, triangles: NDArray, weights: NDArray) -> NDArray[Any] | None:
    """Return the colours [N,3 or 4] in 0..255 of points on a piece; None without colours."""
    visual: Any = piece.visual
    if visual.kind == "face":
        return visual.face_colors[triangles]
    if visual.kind == "vertex":
        return np.einsum("nc,nci->ni", weights, visual.vertex_colors[piece.faces[triangles]])
    if visual.kind != "texture":
        return None
    material: Any = visual.material
    tint = np.asarray(material.main_color, float)[None, :3]
    if visual.uv is None or len(visual.uv) != len(piece.vertices):
        return np.repeat(tint, len(triangles), axis=0)
    uv = np.einsum("nc,nci->ni", weights, visual.uv[piece.faces[triangles]])
    texture = material.to_color(np.nan_to_num(uv)) if np.ndim(uv) == 2 else None
    if texture is None or np.ndim(texture) == 1:
        return np.repeat(tint, len(triangles), axis=0)
    factor = getattr(material, "baseColorFactor", None)
    return texture[:, :3] * (1.0 if factor is None else tint / 255)
