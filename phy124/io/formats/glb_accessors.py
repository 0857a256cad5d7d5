"""The values of a GLB: lists of its description, and the accessors that read its binary chunk.

An accessor (glTF 2.0, section 3.6.2) reads numbers of one type from a view of the chunk. A sparse
one replaces some of them, and one without a view begins with zeros.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.io.content import refusal

KIND = "GLB"
TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Scene:
    """The two chunks of a file."""

    path: Path
    tree: dict[str, Any]
    body: memoryview


def item(scene: Scene, kind: str, index: Any) -> Any:
    """The entry of one of the description's lists, such as its node 3.

    Raises:
        ValueError: There is none.
    """
    entries = scene.tree.get(kind, [])
    if type(index) is not int or not 0 <= index < len(entries):
        raise ValueError(f"its {kind} have no number {str(index)[:40]}")
    return entries[index]


def values(
    scene: Scene, index: Any, width: int, count: int, *, as_they_are: bool = False
) -> NDArray[np.float32]:
    """The values of an accessor [count,width].

    Args:
        scene: The file.
        index: Number of the accessor.
        width: Numbers per value.
        count: Number of values it must have.
        as_they_are: Whether integers stand for themselves, even if the file calls them fractions
            of the largest integer.

    Raises:
        InputError: The file is cut short.
        ValueError: The accessor has other values, or reaches beyond what is there.
    """
    accessor = item(scene, "accessors", index)
    if WIDTHS.get(accessor["type"]) != width:
        raise ValueError(f"accessor {index} is of type {str(accessor['type'])[:40]}")
    if accessor["count"] != count:
        raise ValueError(f"accessor {index} has {accessor['count']} values for {count} Gaussians")
    dtype = np.dtype(TYPES[accessor["componentType"]])
    if "bufferView" in accessor:
        raw = _stored(scene, accessor, dtype, count, width)
    else:
        raw = np.zeros((count, width), dtype)
    if "sparse" in accessor:
        raw = _replaced(scene, accessor["sparse"], raw)
    if dtype.kind == "f" or as_they_are:
        return raw.astype(np.float32)
    if not accessor.get("normalized", False):
        raise ValueError(f"accessor {index} holds integers that are not normalised")
    return np.maximum(raw / np.float32(np.iinfo(dtype).max), -1).astype(np.float32)


def is_fractions(scene: Scene, index: Any) -> bool:
    """Whether the integers of an accessor stand for fractions of the largest integer."""
    return bool(item(scene, "accessors", index).get("normalized", False))


def _stored(
    scene: Scene, place: dict[str, Any], dtype: np.dtype[Any], count: int, width: int
) -> NDArray[Any]:
    """Numbers [count,width] from a view of the chunk."""
    view = item(scene, "bufferViews", place["bufferView"])
    if view.get("buffer", 0) != 0 or "uri" in scene.tree["buffers"][0]:
        raise ValueError("some of its values are in another file")
    offset, first = int(view.get("byteOffset", 0)), int(place.get("byteOffset", 0))
    stride = int(view.get("byteStride", dtype.itemsize * width))
    end = first + stride * (count - 1) + dtype.itemsize * width
    if min(offset, first) < 0 or stride < dtype.itemsize * width or end > int(view["byteLength"]):
        raise ValueError(f"view {place['bufferView']} is shorter than its {count:,} values")
    if offset + end > len(scene.body):
        raise refusal(KIND, scene.path, "it is cut short: some of its values are missing.")
    shape, strides = (count, width), (stride, dtype.itemsize)
    return np.ndarray(shape, dtype, scene.body, offset + first, strides)


def _replaced(scene: Scene, sparse: dict[str, Any], raw: NDArray[Any]) -> NDArray[Any]:
    """Numbers [N,width] of which a sparse accessor replaces some."""
    count, kind = int(sparse["count"]), np.dtype(TYPES[sparse["indices"]["componentType"]])
    if kind.kind != "u":
        raise ValueError("a sparse accessor has no whole indices")
    rows = _stored(scene, sparse["indices"], kind, count, 1)[:, 0]
    if rows.max() >= len(raw):
        raise ValueError("a sparse accessor replaces values that are not there")
    raw = raw.copy()
    raw[rows] = _stored(scene, sparse["values"], raw.dtype, count, raw.shape[1])
    return raw
