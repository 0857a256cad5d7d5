"""Covers a triangle mesh from a file with flat Gaussians that have the colours of its surface.

trimesh reads the file in a separate process, which is killed after a time limit. The mesh may have
holes, because the interior is filled as for every other object (phy124/particles/solid.py).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.shapes import choose_triangles, cover_surface
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.content import AGAIN, Y_UP, Content, describe_coarseness, step_of
from phy124.io.formats import MESH_ENDINGS
from phy124.io.formats.mesh import TINT, to_linear, to_srgb
from phy124.io.opening import obstacle
from phy124.runtime import isolated
from phy124.runtime.installation import install_command

if TYPE_CHECKING:
    from trimesh import Trimesh

UPRIGHT = {"glb": Y_UP, "gltf": Y_UP, "obj": Y_UP, "stl": ("z", None), "ply": ("z", None)}
"""Up and front directions, by file format."""
STL_HEAD = 84
"""Size of a binary STL file's header [bytes]; the last four bytes are the number of triangles."""
STL_ROW = 50
"""Size of a triangle in a binary STL file [bytes]."""
LARGEST = 200_000_000
"""Largest file size [bytes]."""
MOST_TRIANGLES = 2_000_000
TIME = isolated.Deadline(seconds=60.0)
COUNT = 24_000
"""Number of Gaussians of a mesh. With fewer Gaussians, the edges of the mesh would look ragged."""
OBJECT_COUNT = 50_000
"""Number of Gaussians of a mesh that is the first object of a scene."""
GREY = (0.7, 0.7, 0.7)
"""Colour of a mesh without colours."""
FAR = 100.0
"""A mesh that is farther from the origin, relative to its size, is moved to the origin, because
float32 positions would be too coarse.
"""
LARGEST_HEADER = 1 << 20
"""Number of bytes at the start of a file that show whether the file is a mesh."""
SMALLEST = 1e-6
"""Smallest surface area of a mesh, relative to the square of its longest side."""
FARTHEST = 1e18
"""Largest coordinate of a vertex; float32 numbers can store its square."""
CUTOFF = 0.5
"""Smallest visible alpha of a material with the mode MASK that has no `alphaCutoff` (glTF)."""
Drawn = tuple[NDArray[np.float64], NDArray[np.float64], "NDArray[np.float64] | None"]
"""Points [N,3], outward normals [N,3], and colours [N,3] in 0..1 if the mesh has colours."""


def mesh(path: Path, colour: Sequence[float], *, seed: int = 0) -> Gaussians:
    """Make Gaussians of a mesh, centred on the origin, with z up and a longest side of 1 m.

    Args:
        path: A .glb, .gltf, .obj, .stl or .ply file.
        colour: Red, green and blue in 0..1, used if the mesh contains no colours.
        seed: Seed of the Gaussians' positions.

    Raises:
        InputError: If the mesh cannot be read, is too large, or has no surface area.
    """
    made, about = _cover(path, colour, COUNT, seed)
    for note in about.notes:
        warnings.warn(f"{path}: {note}", stacklevel=2)
    return made


def read_mesh(path: Path) -> Content:
    """Return the Gaussians of a mesh file, in the axes and the unit of the file.

    Raises:
        InputError: If the mesh cannot be read, is too large, or has no surface area.
    """
    made, about = _cover(path, GREY, OBJECT_COUNT, seed=0)
    there = rotate_gaussians(made, orientation(*about.axes).T)
    far = float(np.abs(about.centre).max()) > FAR * about.size
    x, y, z = about.centre.tolist()
    return Content(
        there.transform(about.size, np.zeros(3) if far else about.centre),
        axes=about.axes,
        notes=about.notes,
        origin=(x, y, z) if far else (0.0, 0.0, 0.0),
    )


def load_pieces(path: Path) -> tuple[list[Trimesh], tuple[str, str | None]]:
    """Return the meshes of a file, and the file's up and front axes.

    Raises:
        InputError: If the mesh cannot be read or is too large.
    """
    _refuse(path)
    kind = _kind(path)
    return _read_apart(path, _load_sound_solids, str(path), kind), UPRIGHT[kind]


def is_mesh(path: Path) -> bool:
    """Whether a file is a mesh without Gaussians, judged by its first bytes and name."""
    kind = path.suffix.lower()
    if kind in MESH_ENDINGS:
        return True
    if kind not in (".glb", ".ply") or obstacle(path):
        return False
    with open(path, "rb") as file:
        head = file.read(LARGEST_HEADER)
    if head[:4] == b"glTF":
        size = int.from_bytes(head[12:16], "little")
        return b"KHR_gaussian_splatting" not in head[20 : 20 + size]
    header = head.partition(b"end_header")[0]
    faces = re.search(rb"element face +([1-9]\d*)", header)
    return head[:3] == b"ply" and faces is not None and b"scale_0" not in header


class _About(NamedTuple):
    axes: tuple[str, str | None]
    """Up and front axes of the file."""
    centre: NDArray[np.float64]
    size: float
    """Longest side of the bounding box."""
    notes: tuple[str, ...]


def _cover(path: Path, colour: Sequence[float], count: int, seed: int) -> tuple[Gaussians, _About]:
    """Cover a mesh with Gaussians in phy124's axes, with a longest side of 1."""
    _refuse(path)
    kind = _kind(path)
    drawn, notes = _read_apart(path, _read, str(path), kind, seed, count)
    points, normals, colours = drawn
    rgb = np.broadcast_to(np.asarray(colour, float), points.shape) if colours is None else colours
    low, high = points.min(axis=0), points.max(axis=0)
    centre, size = (low + high) / 2, float((high - low).max())
    turn = orientation(*UPRIGHT[kind])
    made = cover_surface((points - centre) / size @ turn.T, normals @ turn.T, rgb)
    return made, _About(UPRIGHT[kind], centre, size, tuple(notes))


def _read_apart(path: Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a separate process; its ValueErrors have the form "limit; remedy"."""
    try:
        return isolated.run(function, *arguments, deadline=TIME)
    except isolated.Unfinished as error:
        raise _unusable(path, f"reading the mesh {error}.", "Give a smaller mesh.") from None
    except ValueError as error:
        limit, _, remedy = str(error).partition("; ")
        raise _unusable(
            path, limit, remedy or "Save the mesh again from the program that made it."
        ) from None


def _kind(path: Path) -> str:
    with open(path, "rb") as file:
        head = file.read(STL_HEAD)
    if head[:4] == b"glTF":
        return "glb"
    if head[:4] in (b"ply\n", b"ply\r"):
        _check_rows(path)
        return "ply"
    stated, there = int.from_bytes(head[80:], "little"), path.stat().st_size - STL_HEAD
    if head[:6].lower() == b"solid " or there == STL_ROW * stated:
        return "stl"
    kind = path.suffix.lower().removeprefix(".")
    # text files contain no zero bytes
    if kind == "stl" and b"\0" in head and there < STL_ROW * stated:
        limit = (
            f"it is cut short: only {max(there, 0) // STL_ROW:,} of {stated:,} triangles "
            "are present."
        )
        raise _unusable(path, limit, AGAIN)
    return kind


def _check_rows(path: Path) -> None:
    """An ASCII PLY file has one row per line."""
    head, _, body = path.read_bytes().partition(b"end_header")
    if not re.search(rb"^format ascii\b", head, re.MULTILINE):
        return
    stated = sum(int(count) for count in re.findall(rb"^element \S+ (\d+)", head, re.MULTILINE))
    present = sum(bool(line.strip()) for line in body.splitlines())
    if present < stated:
        limit = f"it is cut short: only {present:,} of {stated:,} rows are present."
        raise _unusable(path, limit, AGAIN)


def _refuse(path: Path) -> None:
    if path.suffix.lower().removeprefix(".") not in UPRIGHT:
        known = ", ".join(f".{name}" for name in UPRIGHT)
        raise _unusable(
            path,
            "it is not a mesh in a format that phy124 can read.",
            f"Give a file in one of the formats {known}.",
        )
    if hindrance := obstacle(path):
        raise _unusable(path, *hindrance)
    size = path.stat().st_size
    if not 0 < size <= LARGEST:
        limit = f"it has {size:,} bytes, but a mesh must have from 1 to {LARGEST:,} bytes."
        raise _unusable(path, limit, "Simplify the mesh." if size else "Save it again.")
    if find_spec("trimesh") is None:
        limit = "it needs the package trimesh, which is not installed."
        raise _unusable(path, limit, f"Run `{install_command('mesh')}`.")


def _unusable(path: Path, limit: str, remedy: str) -> InputError:
    return InputError("mesh", path, limit, remedy)


def _read(path: str, kind: str, seed: int, count: int) -> tuple[Drawn, list[str]]:
    """Run in a separate process; the message of a ValueError is "limit; remedy"."""
    solids, shapes, notes = _load_solids(path, kind)
    drawn = _sample_surface(solids, seed, count, linear=kind in ("glb", "gltf"))
    # The vertices of `shapes` are in the file's coordinates, before the transform of any scene node
    # is applied.
    largest: Any = max(shapes, key=lambda piece: len(getattr(piece, "faces", ())))
    coarse = describe_coarseness(largest.vertices, step_of(largest.vertices))
    return drawn, [*notes, coarse] if coarse else notes


def _load_sound_solids(path: str, kind: str) -> list[Trimesh]:
    solids, _, _ = _load_solids(path, kind)
    _join_corners(solids)
    for piece in solids:
        piece.remove_unreferenced_vertices()
    return solids


def _load_solids(path: str, kind: str) -> tuple[list[Trimesh], list[Any], list[str]]:
    """Return the meshes that have triangles, all geometries of the file, and notes."""
    from phy124.generators.mesh_files import Compressed, load  # imports trimesh

    try:
        scene, notes = load(path, kind)
        shapes = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
        triangles = sum(len(getattr(piece, "faces", ())) for piece in shapes)
        for shape in scene.geometry.values():
            _keep_vertex_colours(shape)
        pieces: list[Any] = scene.dump() if triangles <= MOST_TRIANGLES else []
    except Compressed as error:
        raise ValueError(
            f"its triangles are compressed ({error}).; Export it without compression."
        ) from None
    except MemoryError:
        raise ValueError(
            "reading it needs more memory than is free.; Give a mesh with fewer triangles."
        ) from None
    except Exception as error:  # trimesh raises many types of exceptions
        raise ValueError(
            "it cannot be read as a mesh: the file is damaged or of another kind."
        ) from error
    if not triangles:
        points = "For a file of Gaussians or points, use the generator `file`."
        raise ValueError(f"it has no triangles.; {points if kind == 'ply' else AGAIN}")
    if triangles > MOST_TRIANGLES:
        limit = f"it has {triangles:,} triangles, but at most {MOST_TRIANGLES:,} are allowed."
        raise ValueError(f"{limit}; Simplify the mesh in the program that made it.")
    return [piece for piece in pieces if len(getattr(piece, "faces", ()))], shapes, notes


def _keep_vertex_colours(shape: Any) -> None:
    """Store the colours [N,3] of the vertices of a glTF mesh with a material as `TINT`; trimesh
    would drop them.
    """
    visual: Any = getattr(shape, "visual", None)
    if getattr(visual, "kind", None) == "texture" and "color" in visual.vertex_attributes:
        colours = np.asarray(visual.vertex_attributes["color"])
        most = np.iinfo(colours.dtype).max if colours.dtype.kind == "u" else 1.0
        shape.vertex_attributes[TINT] = colours[:, :3] / most


def _factor(material: Any) -> NDArray[np.float64]:
    """Return the linear base colour [3] of a glTF material; the default is white."""
    factor = material.baseColorFactor
    return np.ones(3) if factor is None else factor[:3] / 255


def _join_corners(pieces: list[Trimesh]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners [F,3,3] of all triangles, and normals [F,3] whose lengths are the
    triangles' areas divided by the square of a length close to the longest side.
    """
    for piece in pieces:
        if piece.faces.min() < 0 or piece.faces.max() >= len(piece.vertices):
            raise ValueError("a triangle refers to a vertex that the file does not contain.")
        if not np.isfinite(piece.vertices[piece.faces]).all():
            raise ValueError("a vertex of a triangle has a coordinate that is NaN or infinite.")
    corners = np.concatenate([piece.triangles for piece in pieces])
    if (largest := float(np.abs(corners).max())) > FARTHEST:
        limit = f"a vertex has a coordinate of {largest:.3g}, but at most {FARTHEST:g} is allowed."
        raise ValueError(f"{limit}; Correct this vertex, or scale the mesh.")
    side = float(np.ptp(corners, axis=(0, 1)).max())
    unit = np.ldexp(1.0, np.frexp(side)[1])  # a power of 2 does not change the digits
    edges = (corners[:, 1:] - corners[:, :1]) / unit
    normals = np.cross(edges[:, 0], edges[:, 1]) / 2
    area = float(np.linalg.norm(normals, axis=1).sum() * unit * unit)
    if not area > 0:
        raise ValueError("its triangles have no surface area.")
    if area <= SMALLEST * side * side:
        raise ValueError(
            f"its longest side is {side:.3g}, but its surface area is only {area:.3g}. "
            "One vertex may be far from all other vertices."
        )
    return corners, normals


def _sample_surface(pieces: list[Trimesh], seed: int, count: int, linear: bool) -> Drawn:
    corners, normals = _join_corners(pieces)
    # If the normals of most of the area point towards the centre, the mesh is inside out. All
    # normals are then reversed.
    away = corners.mean(axis=1) - corners.mean(axis=(0, 1))
    sign = 1.0 if (away * normals).sum() >= 0 else -1.0
    chosen, weights = choose_triangles(corners, count, seed)
    seen = np.ones(len(chosen), bool)
    for piece, within, triangles in _split(pieces, chosen):
        seen[within] = _is_opaque(piece, triangles, weights[within])
    if not seen.any():
        raise ValueError("all of its surface is transparent.; Give a mesh with a visible surface.")
    chosen, weights = chosen[seen], weights[seen]
    points = np.einsum("nc,nci->ni", weights, corners[chosen])
    outward = sign * normals[chosen]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return points, outward, _colours(pieces, chosen, weights, linear)


def _colours(
    pieces: list[Trimesh], chosen: NDArray[np.int64], weights: NDArray, linear: bool
) -> NDArray[np.float64] | None:
    """Return the sRGB colours [N,3] of points on triangles, 0..1; None if no mesh has colours.

    Args:
        pieces: Meshes whose triangles are numbered consecutively.
        chosen: Triangle of each point [N].
        weights: Barycentric coordinates of each point [N,3].
        linear: Whether the colours of vertices are linear.
    """
    rgb, any_colour = np.full((len(chosen), 3), 0.8), False
    for piece, within, triangles in _split(pieces, chosen):
        colours = _colour_piece(piece, triangles, weights[within], linear)
        if colours is not None:
            rgb[within], any_colour = colours, True
    return rgb if any_colour else None


def _split(
    pieces: list[Trimesh], chosen: NDArray[np.int64]
) -> Iterator[tuple[Trimesh, NDArray[np.bool_], NDArray[np.int64]]]:
    """Yield each mesh, a mask of its points [N], and the triangles of these points.

    The triangles of all meshes are numbered consecutively; `chosen` [N] contains the number of each
    point's triangle.
    """
    ends = np.cumsum([0, *(len(piece.faces) for piece in pieces)])
    for piece, start, stop in zip(pieces, ends, ends[1:], strict=False):
        within = (chosen >= start) & (chosen < stop)
        if within.any():
            yield piece, within, chosen[within] - start


def _is_opaque(piece: Trimesh, triangles: NDArray, weights: NDArray) -> NDArray[np.bool_]:
    """Whether points [N] are visible; the material may cut out transparent parts of its texture."""
    material: Any = getattr(piece.visual, "material", None)
    alpha = np.ones(len(triangles))
    if getattr(material, "alphaMode", None) != "MASK":
        return alpha > 0
    if material.baseColorFactor is not None:
        alpha *= material.baseColorFactor[3] / 255
    texture = _sample_texture(piece, triangles, weights)
    if texture is not None:
        alpha *= texture[:, 3] / 255
    return alpha >= (CUTOFF if material.alphaCutoff is None else material.alphaCutoff)


def _sample_texture(
    piece: Trimesh, triangles: NDArray, weights: NDArray
) -> NDArray[np.uint8] | None:
    """Return the texture's colours RGBA [N,4] at points; None if the mesh has no texture."""
    visual: Any = piece.visual
    if np.ndim(visual.uv) != 2 or len(visual.uv) != len(piece.vertices):
        return None
    uv = np.einsum("nc,nci->ni", weights, visual.uv[piece.faces[triangles]])
    texture = visual.material.to_color(np.nan_to_num(uv))
    return texture if np.ndim(texture) == 2 else None


def _colour_piece(
    piece: Trimesh, triangles: NDArray, weights: NDArray, linear: bool
) -> NDArray[np.float64] | None:
    """Return the sRGB colours of points [N,3] or of all points [3], 0..1; None if the mesh has no
    colours.
    """
    visual: Any = piece.visual
    if visual.kind == "face":
        return visual.face_colors[triangles, :3] / 255
    if visual.kind == "vertex":
        corners = visual.vertex_colors[piece.faces[triangles], :3] / 255
        colours = np.einsum("nc,nci->ni", weights, corners)
        return to_srgb(colours) if linear else colours
    if visual.kind != "texture":
        return None
    material: Any = visual.material
    # Only materials of glTF have a factor. Factors and colours of vertices are linear; textures are
    # sRGB.
    light = _factor(material) if hasattr(material, "baseColorFactor") else None
    if light is not None and TINT in piece.vertex_attributes:
        corners = piece.vertex_attributes[TINT][piece.faces[triangles]]
        light = light * np.einsum("nc,nci->ni", weights, corners)
    tint = material.main_color[:3] / 255 if light is None else to_srgb(light)
    texture = _sample_texture(piece, triangles, weights)
    if texture is None:
        return tint
    colours = texture[:, :3] / 255
    return colours if light is None else to_srgb(to_linear(colours) * light)
