"""Reads the values of a GLB file, and decides whether its scales are logarithms.

Accessors are defined in glTF 2.0, section 3.6.2.

Scales are lengths in the ratified KHR_gaussian_splatting, but logarithms in its draft, and a file
does not state its version. Negative scales must be logarithms, and some programs are known to write
logarithms. Otherwise, the spacing of the Gaussians decides: an object's Gaussians are about as wide
as the distance between them, and logarithms mistaken for lengths would be much narrower.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.io.content import Malformed, refusal

KIND = "GLB"
TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Scene:
    """The JSON description and binary chunk of a GLB file."""

    path: Path
    tree: dict[str, Any]
    body: memoryview


def item(scene: Scene, kind: str, index: Any) -> Any:
    """Return an entry from a list in the JSON description, such as node 3.

    Raises:
        Malformed: If the list has no such entry.
    """
    entries = scene.tree.get(kind, [])
    if type(index) is not int or not 0 <= index < len(entries):
        raise Malformed(f"its {kind} have no number {str(index)[:40]}")
    return entries[index]


def values(
    scene: Scene, index: Any, width: int, count: int, *, as_they_are: bool = False
) -> NDArray[np.float32]:
    """Return the values of an accessor [count,width].

    Args:
        scene: The description and data of the file.
        index: Index of the accessor.
        width: Expected count of numbers per value.
        count: Expected number of values.
        as_they_are: Whether integers are returned unchanged, even if the file declares that they
            are normalised (fractions of the largest integer).

    Raises:
        InputError: If the file is cut short.
        Malformed: If the type or number of values is unexpected, or values are outside their view.
    """
    accessor = item(scene, "accessors", index)
    if WIDTHS.get(accessor["type"]) != width:
        raise Malformed(f"accessor {index} is of type {str(accessor['type'])[:40]}")
    if accessor["count"] != count:
        raise Malformed(f"accessor {index} has {accessor['count']} values for {count} Gaussians")
    dtype = _dtype(accessor)
    if "bufferView" in accessor:
        raw = _read_view(scene, accessor, dtype, count, width)
    else:
        raw = np.zeros((count, width), dtype)
    if "sparse" in accessor:
        raw = _apply_sparse(scene, accessor["sparse"], raw)
    if dtype.kind == "f" or as_they_are:
        return raw.astype(np.float32)
    if not accessor.get("normalized", False):
        raise Malformed(f"accessor {index} holds integers that are not normalised")
    return np.maximum(raw / np.float32(np.iinfo(dtype).max), -1).astype(np.float32)


def is_fractions(scene: Scene, index: Any) -> bool:
    """Whether the integers of an accessor are normalised (fractions of the largest integer)."""
    return bool(item(scene, "accessors", index).get("normalized", False))


def _dtype(place: dict[str, Any]) -> np.dtype[Any]:
    kind = place["componentType"]
    if kind not in TYPES:
        raise Malformed(f"there are no numbers of type {str(kind)[:40]}")
    return np.dtype(TYPES[kind])


def _read_view(
    scene: Scene, place: dict[str, Any], dtype: np.dtype[Any], count: int, width: int
) -> NDArray[Any]:
    view = item(scene, "bufferViews", place["bufferView"])
    if view.get("buffer", 0) != 0 or "uri" in scene.tree["buffers"][0]:
        raise Malformed("some of its values are in another file")
    offset, first = int(view.get("byteOffset", 0)), int(place.get("byteOffset", 0))
    stride = int(view.get("byteStride", dtype.itemsize * width))
    end = first + stride * (count - 1) + dtype.itemsize * width
    if min(offset, first) < 0 or stride < dtype.itemsize * width or end > int(view["byteLength"]):
        raise Malformed(f"view {place['bufferView']} is shorter than its {count:,} values")
    if offset + end > len(scene.body):
        raise refusal(KIND, scene.path, "it is cut short: some of its values are missing.")
    shape, strides = (count, width), (stride, dtype.itemsize)
    return np.ndarray(shape, dtype, scene.body, offset + first, strides)


def _apply_sparse(scene: Scene, sparse: dict[str, Any], raw: NDArray[Any]) -> NDArray[Any]:
    count, kind = int(sparse["count"]), _dtype(sparse["indices"])
    if kind.kind != "u":
        raise Malformed("the indices of a sparse accessor are not integers")
    rows = _read_view(scene, sparse["indices"], kind, count, 1)[:, 0]
    if rows.max() >= len(raw):
        raise Malformed("a sparse accessor has an index beyond its last value")
    raw = raw.copy()
    raw[rows] = _read_view(scene, sparse["values"], raw.dtype, count, raw.shape[1])
    return raw


PLAYCANVAS = re.compile(r"splat-transform (\d+)\.(\d+)")
LENGTHS_SINCE = (2, 7)
"""First version of splat-transform that wrote scales as lengths."""
FEW = 0.01
"""If more than this fraction of a file's scales is negative, the scales are logarithms. Mirrored
objects have a few negative lengths.
"""
NEIGHBOURS = 4
SOME = 2000
BARE = 0.55
"""Below this ratio of the Gaussians' width to their spacing, the object is full of holes."""
SHORT = 1.0
"""Scales that are all positive can be logarithms only if their median is above this value."""
COVERING = (0.6, 6.0)
"""Smallest and largest ratio of width to spacing for Gaussians that cover an object. In example
files, the ratio is 1.2 to 3.5.
"""
NOTE = "Its scales are read as logarithms: {}."


def kind_of_scales(
    generator: str, parts: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]
) -> tuple[bool, list[str]]:
    """Return whether scales are logarithms, and a note if this was guessed.

    `generator` is the program that wrote the file, as the file states it. `parts` are the scales
    [N,3] and centres [N,3] of each primitive.
    """
    negative = sum(np.count_nonzero(scales < 0) for scales, _ in parts)
    if negative > FEW * sum(scales.size for scales, _ in parts):
        return True, []
    if match := PLAYCANVAS.match(generator):
        logs = (int(match[1]), int(match[2])) < LENGTHS_SINCE
        return logs, [NOTE.format(f"{match[0]} wrote logarithms")] if logs else []
    if generator.startswith("phy124"):
        return False, []
    if _too_small(*max(parts, key=lambda part: len(part[0]))):
        return True, [NOTE.format("read as lengths, they would leave holes in the object")]
    return False, []


def _too_small(scales: NDArray[np.float32], means: NDArray[np.float32]) -> bool:
    """Return whether the scales, taken as lengths, would be too small to cover the object."""
    sound = np.isfinite(means).all(axis=1) & np.isfinite(scales).all(axis=1)
    longest, places = scales[sound].max(axis=1, initial=0), means[sound].astype(np.float64)
    if len(places) <= NEIGHBOURS:
        return False
    from scipy.spatial import KDTree

    some = slice(None, None, max(1, len(places) // SOME))
    # On a surface, the k nearest neighbours cover a disc with k times the area of one Gaussian.
    apart = KDTree(places).query(places[some], NEIGHBOURS + 1)[0][:, -1] / np.sqrt(NEIGHBOURS)
    spacing, length = float(np.median(apart)), float(np.median(longest[some]))
    with np.errstate(over="ignore"):
        width = np.exp(length)
    low, high = COVERING
    bare = SHORT < length < BARE * spacing
    return bare and low * spacing <= width <= high * spacing
