"""Writes a clip as one animated GLB: a mesh with one morph target per frame.

The mesh is the surface of the first frame, or a textured mesh from the user. Each vertex moves by
the rigid motion that best fits the motion of the nearest Gaussians (Kabsch 1976). The weights of
the morph targets change linearly, so at most two targets are active. The axes and the unit are as
in glTF (y up, z to the front, metres). The topology is constant. For objects that tear or flow,
write a mesh of each frame instead (`phy124/io/formats/mesh.py`).
"""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.axes import euler, orientation
from phy124.io.clip import Clip
from phy124.io.content import Y_UP
from phy124.io.files import replacing
from phy124.io.formats.glb import pack_head
from phy124.io.formats.mesh import TINT, find_surface, to_trimesh
from phy124.progress import Progress, silent

CELLS = 56
"""Number of grid cells along the longest side for the surface of the first frame."""
NEAREST = 12
"""Number of nearest Gaussians whose motion a vertex follows."""
FLOAT, VERTICES = 5126, 34962
MISFIT = 0.1
"""Largest distance between the faces of the boxes around a mesh and around the object, relative to
the object's size.
"""
TYPES = {1: "SCALAR", 3: "VEC3"}


def write_moving_mesh(
    path: str | os.PathLike[str], clip: Clip, *, progress: Progress = silent
) -> list[str]:
    """Write the surface of a clip as an animated GLB, atomically; return notes about its accuracy.

    Raises:
        InputError: The clip is empty, a package is missing, or the file cannot be written.
    """
    clip.refuse_empty()
    first = clip.frame(0).gaussians.select(clip.object_mask)
    piece = to_trimesh(find_surface(first, CELLS), linear=True)
    write_moved(path, clip, [piece], progress=progress)
    return note_separation(clip)


def note_separation(clip: Clip) -> list[str]:
    """Return a note if a clip's material flows, crumbles or tears, which a moving mesh cannot
    show.
    """
    tearing = (clip.report.get("balance") or {}).get("tearing") or {}
    flows = any(clip.report.get(name) for name in ("liquids", "fragments", "grains"))
    if not (flows or tearing.get("likely")):
        return []
    return [
        "The material flows, crumbles or tears, but a moving mesh keeps its triangles, so they are "
        "distorted where the material separates. Use the format mesh for all frames, which writes "
        "the surface of each frame."
    ]


def write_moved(
    path: str | os.PathLike[str], clip: Clip, pieces: list[Any], *, progress: Progress = silent
) -> None:
    """Write meshes that follow the motion of a clip as an animated GLB.

    Args:
        path: The file, which is written atomically.
        clip: The clip whose motion the meshes follow.
        pieces: Meshes of the package trimesh, in the pose of the clip's first frame.
        progress: Function that is called as progress("export", frames done, total frames).
    """
    import trimesh

    turn = orientation(*Y_UP).T
    ends = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    points = np.concatenate([np.asarray(piece.vertices, np.float64) for piece in pieces])
    scene = trimesh.Scene()
    for index, piece in enumerate(pieces):
        moved = piece.copy()
        moved.vertices = moved.vertices @ turn.T
        if TINT in moved.vertex_attributes:  # trimesh writes only the colours of the visuals
            rgba = np.insert(moved.vertex_attributes.pop(TINT), 3, 1.0, axis=1)
            moved.visual.vertex_attributes["color"] = np.rint(255 * rgba).astype(np.uint8)
        scene.add_geometry(moved, geom_name=_name(index), node_name=_name(index))
    data: Any = scene.export(file_type="glb", include_normals=True)
    with tempfile.TemporaryFile() as buffer:
        document = _split(data, buffer)
        targets: list[list[dict[str, int]]] = [[] for _ in pieces]
        for index, places in enumerate(follow(clip, points)):
            shift = (places - points) @ turn.T
            for piece, start, end in zip(targets, ends, ends[1:], strict=False):
                if index:
                    place = _append(document, buffer, shift[start:end], target=VERTICES)
                    piece.append({"POSITION": place})
            progress("export", index + 1, len(clip))
        named = {mesh["name"]: mesh for mesh in document["meshes"]}
        for index, piece in enumerate(targets):
            _add_targets(named[_name(index)], piece)
        _animate(document, buffer, clip.times - clip.times[0])
        _unlit(document)
        with replacing(path) as temporary, temporary.open("wb") as file:
            _join(document, buffer, file)


def fit_to_clip(pieces: list[Any], clip: Clip, axes: tuple[str, str | None]) -> list[Any]:
    """Return meshes in the pose that the first object has in the first frame of a clip.

    If the clip was made from the meshes' file, its report states the pose. Otherwise, the meshes
    are rotated like the object, and scaled and shifted to match the box of the Gaussians' centres.

    Args:
        pieces: Meshes of the package trimesh, in the coordinates of their file.
        clip: The clip.
        axes: Up and front directions of the meshes' file.

    Raises:
        InputError: The meshes and the object have different proportions.
    """
    mask = clip.object_mask & (True if clip.object_id is None else clip.object_id == 0)
    box = _box(clip.means[0][mask].astype(np.float64))
    size, sides = float(np.ptp(box, axis=0).max()), np.zeros(3)
    points = np.concatenate([piece.vertices for piece in pieces])
    for rotation, scale, shift in _list_poses(points, box, clip, axes):
        there = _box(scale * points @ rotation.T + shift)
        if np.abs(there - box).max() <= MISFIT * size:
            placed = [piece.copy() for piece in pieces]
            for piece in placed:
                piece.vertices = scale * piece.vertices @ rotation.T + shift
            return placed
        sides = np.ptp(there, axis=0)
    mesh, body = (" x ".join(f"{side:.3g}" for side in each) for each in (sides, np.ptp(box, 0)))
    limit = f"the object in the clip measures {body} m, so the mesh does not fit it."
    remedy = "Give the mesh from which the object was made."
    raise InputError("surface", f"mesh of {mesh} m", limit, remedy)


def _list_poses(
    points: NDArray[np.float64], box: NDArray[np.float64], clip: Clip, axes: tuple[str, str | None]
) -> Iterator[tuple[NDArray[np.float64], float, NDArray[np.float64]]]:
    """Yield likely poses (rotation, scale, shift) of a mesh with corners `points` [V,3]."""
    read = clip.report.get("capture") or {}
    if placement := read.get("placement"):
        yield np.array(placement["rotation"]), placement["scale"], np.array(placement["shift"])
    turn = euler(clip.scene.get("object", {}).get("turn", (0, 0, 0)))
    for rotation in (read.get("rotation"), orientation(*axes)):
        if rotation is not None:
            both = turn @ rotation
            ends = _box(points @ both.T)
            scale = float(np.ptp(box, axis=0).max() / np.ptp(ends, axis=0).max())
            yield both, scale, box.mean(axis=0) - scale * ends.mean(axis=0)


def follow(clip: Clip, points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the positions [V,3], m, of points that move with a clip's Gaussians, for each frame."""
    from scipy.spatial import KDTree

    mask = clip.object_mask
    rest = clip.means[0][mask].astype(np.float64)
    count = min(NEAREST, len(rest))
    distance, near = KDTree(rest).query(points, count)
    distance, near = distance.reshape(-1, count), near.reshape(-1, count)
    weights = 1 / (distance**2 + (0.5 * distance.mean()) ** 2 + 1e-18)
    weights /= weights.sum(axis=1, keepdims=True)
    centre = np.einsum("vk,vkc->vc", weights, rest[near])
    arms = weights[..., None] * (rest[near] - centre[:, None])
    for index in range(len(clip)):
        now = clip.means[index][mask].astype(np.float64)[near]
        middle = np.einsum("vk,vkc->vc", weights, now)
        turns = _fit_rotations(np.einsum("vki,vkj->vij", arms, now - middle[:, None]))
        yield middle + np.einsum("vij,vj->vi", turns, points - centre)


def _fit_rotations(correlation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations R [V,3,3] that map vectors a to vectors b = R a as well as possible.

    `correlation` [V,3,3] is the sum of w a b^T over pairs of vectors a and b with weight w.
    """
    u, _, vt = np.linalg.svd(correlation)
    sign = np.linalg.det(u) * np.linalg.det(vt)
    u[:, :, 2] *= sign[:, None]
    return np.einsum("vij,vkj->vik", vt.transpose(0, 2, 1), u)


def _box(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lower and upper corner [2,3]."""
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _name(index: int) -> str:
    return f"object{index}"


def _split(data: bytes, buffer: BinaryIO) -> dict[str, Any]:
    size = int.from_bytes(data[12:16], "little")
    buffer.write(data[28 + size :])
    return json.loads(data[20 : 20 + size])


def _join(document: dict[str, Any], buffer: BinaryIO, file: BinaryIO) -> None:
    length = _pad(buffer)
    document["buffers"] = [{"byteLength": length}]
    text = json.dumps(document, separators=(",", ":")).encode()
    file.write(pack_head(text, length))
    buffer.seek(0)
    shutil.copyfileobj(buffer, file)


def _pad(buffer: BinaryIO) -> int:
    buffer.write(b"\0" * (-buffer.tell() % 4))
    return buffer.tell()


def _append(
    document: dict[str, Any], buffer: BinaryIO, values: NDArray[np.floating], **more: Any
) -> int:
    values = np.ascontiguousarray(values, np.float32)
    view = {"buffer": 0, "byteOffset": _pad(buffer), "byteLength": values.nbytes, **more}
    document["bufferViews"].append(view)
    buffer.write(values.tobytes())
    accessor = {
        "bufferView": len(document["bufferViews"]) - 1,
        "componentType": FLOAT,
        "count": len(values),
        "type": TYPES[1 if values.ndim == 1 else values.shape[1]],
        "min": np.atleast_1d(values.min(axis=0)).tolist(),
        "max": np.atleast_1d(values.max(axis=0)).tolist(),
    }
    document["accessors"].append(accessor)
    return len(document["accessors"]) - 1


def _add_targets(mesh: dict[str, Any], targets: list[dict[str, int]]) -> None:
    if targets:
        mesh["weights"] = [0.0] * len(targets)
        for primitive in mesh["primitives"]:
            primitive["targets"] = targets


def _animate(document: dict[str, Any], buffer: BinaryIO, times: NDArray[np.float64]) -> None:
    """In frame k, only morph target k - 1 has weight 1."""
    if len(times) < 2:
        return
    at = _append(document, buffer, times)
    weights = _append(document, buffer, np.eye(len(times), len(times) - 1, -1, np.float32).ravel())
    nodes = [index for index, node in enumerate(document["nodes"]) if "mesh" in node]
    document["animations"] = [
        {
            "name": "motion",
            "samplers": [{"input": at, "output": weights, "interpolation": "LINEAR"}],
            "channels": [
                {"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes
            ],
        }
    ]


def _unlit(document: dict[str, Any]) -> None:
    """Show vertex colours without lighting, because the colours contain the picture's light."""
    bare = [
        primitive
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
        if "COLOR_0" in primitive["attributes"] and "material" not in primitive
    ]
    if bare:
        materials = document.setdefault("materials", [])
        for primitive in bare:
            primitive["material"] = len(materials)
        materials.append({"name": "colours", "extensions": {"KHR_materials_unlit": {}}})
        used = document.setdefault("extensionsUsed", [])
        used.append("KHR_materials_unlit")
