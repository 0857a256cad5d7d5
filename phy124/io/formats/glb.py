"""Reads and writes GLB (glTF 2.0) with KHR_gaussian_splatting, which stores scales as lengths.

    header      "glTF", 2, length (uint32 each)
    chunk JSON  one primitive of mode 0 (points) with the extension
                {kernel: "ellipse", colorSpace: "srgb_rec709_display", ...} and the attributes below
    chunk BIN   their values

    attribute                                type           meaning
    POSITION                                 VEC3 float     centre; y up, the front is z, metres
    COLOR_0                                  VEC4 uint8     for readers without the extension
    KHR_gaussian_splatting:ROTATION          VEC4 float     xyzw; read also as int8, int16
    KHR_gaussian_splatting:SCALE             VEC3 float     standard deviations
    KHR_gaussian_splatting:OPACITY           SCALAR float   0..1; read also as uint8, uint16
    KHR_gaussian_splatting:SH_DEGREE_l_COEF_n VEC3 float    coefficients of 3DGS, degree by degree
    _OBJECT_ID                               SCALAR float   index of the object (phy124 only)

Files from early 2026, before the extension was ratified, have logarithmic scales (glb_values.py).
Nodes may translate and rotate their Gaussians, and scale them uniformly.
"""

import json
import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import SH_C0, Gaussians, rotation_matrices
from phy124.io.axes import rotate_gaussians
from phy124.io.content import (
    DEGREE_4,
    LARGEST_SH,
    Y_UP,
    Content,
    check_count,
    content_of,
    name_fault,
    normalise_quats,
    read_whole_file,
    refusal,
    step_of,
)
from phy124.io.formats.glb_values import KIND, Scene, is_fractions, item, kind_of_scales, values
from phy124.io.ply import describe_unread

MAGIC = b"glTF"
EXTENSION = "KHR_gaussian_splatting"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
HEADER, CHUNK = struct.Struct("<4sII"), struct.Struct("<II")
LONGEST = 1 << 20
"""Largest JSON description that is read [bytes]; descriptions usually have 4,000 bytes."""
SRGB, LINEAR = "srgb_rec709_display", "lin_rec709_display"
EVEN = 1e-3
"""A node's scaling counts as uniform if its scales differ by at most this relative value."""
EXTENSIONS = (EXTENSION, "KHR_mesh_quantization")
MAX_NODES = 2000
SCALE = f"{EXTENSION}:SCALE"
OBJECT = "_OBJECT_ID"
LEAVES_THE_FRONT = ("splat-transform", "SuperSplat")
"""Programs that rotate Gaussians by 180 degrees about z when they convert a PLY to a GLB. In such a
GLB, the object faces -z, as in the PLY.
"""
READ = {"POSITION", "COLOR_0", OBJECT}
READ |= {f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY")}
READ |= {f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}" for degree in range(4) for n in range(7)}
"""Attributes that are not reported as ignored; COLOR_0 is for programs without the extension."""


class Primitive(NamedTuple):
    """A glTF primitive whose points are Gaussians."""

    attributes: dict[str, int]
    """Index of the accessor of each attribute."""
    extension: dict[str, Any]
    matrix: NDArray[np.float64]
    """World transform of the primitive's node [4,4]."""
    gaussians: int


def read(path: Path) -> Content:
    """Read the Gaussians from all nodes in the scene of a GLB file.

    Raises:
        InputError: If the file is missing, cut short or damaged, has no Gaussians, or has an
            unsupported feature, such as compression or another kernel.
    """
    scene = _chunks(path, read_whole_file(KIND, path))
    try:
        primitives = _primitives(scene)
        generator = str(scene.tree.get("asset", {}).get("generator", ""))
        of = partial(_values, scene, width=3)
        logs, notes = kind_of_scales(
            generator, [(of(p, name=SCALE), of(p, name="POSITION")) for p in primitives]
        )
        parts = [_apply_matrix(scene, _columns(scene, p, logs), p.matrix) for p in primitives]
        step = max(part.pop("step") for part in parts)
        raw = {name: np.concatenate([part[name] for part in _alike(parts)]) for name in parts[0]}
        if not any(OBJECT in primitive.attributes for primitive in primitives):
            del raw["object_id"]
        axes = ("y", "-z") if generator.startswith(LEAVES_THE_FRONT) else Y_UP
        notes = [*notes, *_passed_over(scene, primitives)]
    except InputError:
        raise
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        limit = f"its description is malformed: {name_fault(error)}."
        raise refusal(KIND, path, limit, "Export it again.") from error
    return content_of(KIND, path, raw, axes, notes=notes, step=step)


def encode(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """Return the bytes of a GLB file; the extension has no field for `antialiased`."""
    arrays = _attributes(gaussians)
    body, views, accessors = bytearray(), [], []
    for name, array in arrays.items():
        view = {"byteOffset": len(body), "byteLength": array.nbytes, "target": 34962}
        views.append({"buffer": 0, **view})
        accessors.append(_accessor(name, array, len(accessors)))
        body += array.tobytes()
    splats = {"kernel": "ellipse", "colorSpace": SRGB}
    splats |= {"projection": "perspective", "sortingMethod": "cameraDistance"}
    primitive = {
        "mode": 0,
        "attributes": {name: index for index, name in enumerate(arrays)},
        "extensions": {EXTENSION: splats},
    }
    tree = {
        "asset": {"version": "2.0", "generator": "phy124"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": len(body)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(tree, separators=(",", ":"), allow_nan=False).encode()
    return pack_head(text, len(body)) + body


def pack_head(text: bytes, length: int) -> bytes:
    """Return the header and the JSON chunk of a GLB file whose binary chunk has `length` bytes."""
    text += b" " * (-len(text) % 4)
    whole = HEADER.size + 2 * CHUNK.size + len(text) + length
    head = HEADER.pack(MAGIC, 2, whole) + CHUNK.pack(len(text), JSON_CHUNK)
    return head + text + CHUNK.pack(length, BIN_CHUNK)


def _attributes(gaussians: Gaussians) -> dict[str, NDArray]:
    """The size of each array is a multiple of 4 bytes."""
    rgba = np.concatenate([gaussians.rgb, gaussians.opacities[:, None]], axis=1)
    arrays = {
        "POSITION": gaussians.means,
        "COLOR_0": np.rint(np.clip(rgba, 0, 1) * 255).astype(np.uint8),
        f"{EXTENSION}:ROTATION": np.roll(gaussians.quats, -1, axis=1),
        SCALE: gaussians.scales,
        f"{EXTENSION}:OPACITY": gaussians.opacities,
    }
    names = _names(gaussians.sh.shape[1])
    arrays |= {name: gaussians.sh[:, i] for i, name in enumerate(names)}
    if gaussians.object_id is not None:  # float32 is exact, because there are few objects
        arrays[OBJECT] = gaussians.object_id.astype(np.float32)
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _names(count: int) -> list[str]:
    pairs = [(degree, n) for degree in range(4) for n in range(2 * degree + 1)]
    return [f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}" for degree, n in pairs[:count]]


def _accessor(name: str, array: NDArray, view: int) -> dict[str, Any]:
    kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[1 if array.ndim == 1 else array.shape[1]]
    accessor: dict[str, Any] = {
        "bufferView": view,
        "componentType": 5121 if array.dtype == np.uint8 else 5126,
        "count": len(array),
        "type": kind,
    }
    if array.dtype == np.uint8:
        accessor["normalized"] = True
    if name == "POSITION":
        accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
    return accessor


def _chunks(path: Path, data: bytes) -> Scene:
    if len(data) < HEADER.size or data[:4] != MAGIC:
        raise refusal(
            KIND, path, "it does not begin with the header of a GLB file.", "Give a GLB file."
        )
    _, version, length = HEADER.unpack_from(data)
    if version != 2:
        raise refusal(
            KIND, path, f"it is glTF {version}; only glTF 2 can be read.", "Export it again."
        )
    if length > len(data):
        raise refusal(
            KIND, path, f"it is cut short: {len(data):,} of {length:,} bytes are present."
        )
    chunks: dict[int, memoryview] = {}
    at, view = HEADER.size, memoryview(data)
    while at + CHUNK.size <= len(data):
        size, kind = CHUNK.unpack_from(data, at)
        at += CHUNK.size
        chunks.setdefault(kind, view[at : at + size])
        at += size
    text = chunks.get(JSON_CHUNK, memoryview(b""))
    if not text or len(text) > LONGEST:
        raise refusal(KIND, path, f"its description is missing or longer than {LONGEST:,} bytes.")
    try:
        tree = json.loads(bytes(text))
    except (ValueError, RecursionError) as error:
        raise refusal(KIND, path, "its description is not JSON.") from error
    if not isinstance(tree, dict):
        raise refusal(KIND, path, "its description is not glTF.")
    return Scene(path, tree, chunks.get(BIN_CHUNK, memoryview(b"")))


def _primitives(scene: Scene) -> list[Primitive]:
    total, primitives = 0, []
    # this also detects cycles of nodes
    for mesh, matrix in list(_list_meshes(scene)):
        for primitive in item(scene, "meshes", mesh)["primitives"]:
            extension = primitive.get("extensions", {}).get(EXTENSION)
            if extension is not None:
                _check_kind(scene, primitive, extension)
                count = int(item(scene, "accessors", primitive["attributes"]["POSITION"])["count"])
                total += count
                # A small file can describe a large scene, because several nodes may show the same
                # mesh.
                check_count(KIND, scene.path, total, 60, len(scene.body))
                primitives.append(Primitive(primitive["attributes"], extension, matrix, count))
    if not total:
        limit = f"it holds no Gaussians: no mesh has {EXTENSION}."
        raise refusal(KIND, scene.path, limit, "Give a GLB of Gaussians, not of a mesh.")
    return primitives


def _passed_over(scene: Scene, primitives: list[Primitive]) -> list[str]:
    names = dict.fromkeys(name for primitive in primitives for name in primitive.attributes)
    fourth = f"{EXTENSION}:SH_DEGREE_4"
    others = [name for name in names if name not in READ and not name.startswith(fourth)]
    degree = [DEGREE_4] if any(name.startswith(fourth) for name in names) else []
    wanted = dict.fromkeys(map(str, scene.tree.get("extensionsRequired", [])))
    for node in scene.tree.get("nodes", []):
        wanted |= dict.fromkeys(node.get("extensions", {}) if "mesh" in node else [])
    unread = ", ".join(name[:60] for name in wanted if name not in EXTENSIONS)
    extensions = (
        [f"phy124 ignores some extensions of this file, so it may look different: {unread[:300]}."]
        if unread
        else []
    )
    return [*degree, *describe_unread(others), *extensions]


def _list_meshes(scene: Scene) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield each mesh of the scene with the world transform [4,4] of its node."""
    tree, here = scene.tree, np.eye(4)
    shown = item(scene, "scenes", tree.get("scene", 0)) if "scenes" in tree else {}
    roots = shown.get("nodes", [])
    waiting = [(root, here) for root in roots or range(len(tree.get("nodes", [])))]
    for _ in range(MAX_NODES):
        if not waiting:
            return
        if len(waiting) > MAX_NODES:
            break
        index, above = waiting.pop()
        node = item(scene, "nodes", index)
        matrix = above @ _matrix(node)
        waiting += [(child, matrix) for child in node.get("children", [])] if roots else []
        if "mesh" in node:
            yield node["mesh"], matrix
    limit = f"it has more than {MAX_NODES:,} nodes, or a cycle of nodes."
    raise refusal(KIND, scene.path, limit, "Export it again.")


def _matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    with np.errstate(all="ignore"):  # an invalid rotation becomes NaN and is refused later
        turn = rotation_matrices(np.array([[w, x, y, z]]))[0]
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _check_kind(scene: Scene, primitive: dict[str, Any], extension: dict[str, Any]) -> None:
    if "indices" in primitive:
        limit = "its Gaussians are selected by indices, which is not supported."
        raise refusal(KIND, scene.path, limit, "Export the scene without indices.")
    if extension.get("extensions"):
        limit = (
            f"its Gaussians are compressed by {', '.join(extension['extensions'])}, "
            "a draft extension that phy124 does not read."
        )
        raise refusal(KIND, scene.path, limit, "Export the scene without compression.")
    if extension.get("kernel", "ellipse") != "ellipse":
        limit = f"its kernel is {str(extension['kernel'])[:40]}; only ellipse can be read."
        raise refusal(KIND, scene.path, limit, "Export it again.")


def _values(scene: Scene, primitive: Primitive, name: str, width: int) -> NDArray[np.float32]:
    if name not in primitive.attributes:
        raise refusal(KIND, scene.path, f"its Gaussians have no {name}.", "Export it again.")
    index = primitive.attributes[name]
    # Centres may be integer multiples of an increment that the node's scale sets
    # (KHR_mesh_quantization).
    whole = name == OBJECT or (name == "POSITION" and not is_fractions(scene, index))
    return values(scene, index, width, primitive.gaussians, as_they_are=whole)


def _columns(scene: Scene, primitive: Primitive, logs: bool) -> dict[str, NDArray[np.float32]]:
    of = partial(_values, scene, primitive)
    scales = of(SCALE, 3)
    with np.errstate(over="ignore"):
        scales = np.exp(scales) if logs else np.abs(scales)
    names = [name for name in _names(LARGEST_SH) if name in primitive.attributes]
    whole = max(k for k in (1, 4, 9, 16) if names[:k] == _names(k) or k == 1)
    sh = np.stack([of(name, 3) for name in _names(whole)], axis=1)
    named = OBJECT in primitive.attributes
    return {
        "means": of("POSITION", 3),
        "quats": normalise_quats(np.roll(of(f"{EXTENSION}:ROTATION", 4), 1, axis=1)),
        "scales": scales,
        "opacities": of(f"{EXTENSION}:OPACITY", 1)[:, 0],
        "sh": _to_display_colours(sh) if primitive.extension.get("colorSpace") == LINEAR else sh,
        "object_id": of(OBJECT, 1)[:, 0] if named else np.full(len(sh), np.nan, np.float32),
    }


def _to_display_colours(sh: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert harmonics from linear colours to sRGB. Coefficients above degree 0 are multiplied by
    the derivative of the conversion at degree 0.
    """
    linear = np.clip(0.5 + SH_C0 * sh[:, :1].astype(np.float64), 0, 1)
    bright = 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    slope = np.where(linear <= 0.0031308, 12.92, (bright + 0.055) / 2.4 / np.maximum(linear, 1e-9))
    shown = np.where(linear <= 0.0031308, 12.92 * linear, bright)
    first = (shown - 0.5) / SH_C0
    return np.concatenate([first, sh[:, 1:] * slope], axis=1, dtype=np.float32)


def _apply_matrix(scene: Scene, raw: dict[str, Any], matrix: NDArray[np.float64]) -> dict[str, Any]:
    """The result includes `step`, the spacing of float32 numbers at the positions."""
    step = step_of(raw["means"])
    if np.array_equal(matrix, np.eye(4)):
        return {**raw, "step": step}
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    size = float(sizes.mean())
    turn = matrix[:3, :3] / (size or 1.0)
    if not np.allclose(turn @ turn.T, np.eye(3), atol=EVEN) or np.linalg.det(turn) < 0:
        limit = "a node scales its Gaussians unevenly, skews or mirrors them, which is unsupported."
        raise refusal(
            KIND, scene.path, limit, "Apply the node's transform and export the scene again."
        )
    shapes = {name: value for name, value in raw.items() if name != "object_id"}
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        means = raw["means"].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        gaussians = rotate_gaussians(Gaussians(**shapes), turn).transform(size, np.zeros(3))
    rotated = {name: getattr(gaussians, name) for name in shapes}
    return {**raw, **rotated, "means": means, "step": step * size}


def _alike(parts: list[dict[str, NDArray]]) -> list[dict[str, NDArray]]:
    """Append zeros to the primitives' spherical harmonics, so that all have the same degree."""
    most = max(part["sh"].shape[1] for part in parts)
    rows = [(0, most - part["sh"].shape[1]) for part in parts]
    padded = [np.pad(p["sh"], ((0, 0), row, (0, 0))) for p, row in zip(parts, rows, strict=True)]
    return [{**part, "sh": sh} for part, sh in zip(parts, padded, strict=True)]
