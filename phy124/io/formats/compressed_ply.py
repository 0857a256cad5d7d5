"""Reads compressed PLY files (SuperSplat), which store packed integers in chunks of 256 Gaussians.

    element  property                    meaning
    chunk    min_x ... max_z             float32, bounding box of the centres of 256 Gaussians
             min_scale_x ... max_scale_z float32, range of their log scales
             min_r ... max_b             float32, range of their colours; absent: 0..1
    vertex   packed_position  uint32     11, 10, 11 bits of x, y, z within the box
             packed_rotation  uint32     2 bits: index in w, x, y, z of the largest component, which
                                         is omitted; 3 x 10 bits: the other components, each
                                         (value / 1023 - 1/2) sqrt 2
             packed_scale     uint32     11, 10, 11 bits within the range
             packed_color     uint32     8 bits each of red, green, blue, opacity
    sh       f_rest_0 ...     uint8      harmonics -4..4, in the order of a PLY; absent: degree 0

The axes are x right, y down, as in a 3DGS PLY.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import SH_C0
from phy124.io.content import DEGREE_4, LARGEST_SH, Content, check_count, content_of, refusal
from phy124.io.formats.quantise import restore_largest
from phy124.io.ply import COEFFICIENTS, describe_unread, read_comments
from phy124.io.plyheader import Element, Header, read_header

KIND = "PLY"
CHUNK = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
SCALE_AXES = ("scale_x", "scale_y", "scale_z")
BOXES = [f"{end}_{axis}" for axis in (*"xyz", *SCALE_AXES) for end in ("min", "max")]


def is_compressed(header: Header) -> bool:
    """Whether the rows of a PLY file are compressed."""
    return "packed_position" in (header.row.names or ())


def read(path: Path) -> Content:
    """Read the Gaussians of a compressed PLY file.

    Raises:
        InputError: If the file is missing or cut short, or its elements contradict each other.
    """
    header = read_header(path)
    size = path.stat().st_size
    check_count(KIND, path, header.count, header.row.itemsize, size)
    rows = {element.name: _rows(path, element, size) for element in _elements(path, header)}
    _check(path, header, rows)
    vertex, chunk = rows["vertex"], rows["chunk"]
    which = np.arange(header.count) // CHUNK
    colour = _split(vertex["packed_color"], (8, 8, 8, 8))
    if "min_r" in (chunk.dtype.names or ()):
        colour[:, :3] = _within(colour[:, :3], chunk, which, "rgb")
    scales = _split(vertex["packed_scale"], (11, 10, 11))
    with np.errstate(over="ignore", invalid="ignore"):
        raw = {
            "means": _within(_split(vertex["packed_position"], (11, 10, 11)), chunk, which, "xyz"),
            "quats": _rotations(vertex["packed_rotation"]),
            "scales": np.exp(_within(scales, chunk, which, SCALE_AXES)),
            "opacities": colour[:, 3],
            "sh": _harmonics((colour[:, :3] - 0.5) / SH_C0, rows.get("sh")),
        }
    axes, antialiased = read_comments(header.comments)
    higher = len(rows["sh"].dtype.names or ()) if "sh" in rows else 0
    notes = [DEGREE_4] if higher > 3 * (LARGEST_SH - 1) else []
    notes += describe_unread(name for name in vertex.dtype.names or () if name not in PACKED)
    return content_of(KIND, path, raw, axes, antialiased=antialiased, notes=notes)


def _elements(path: Path, header: Header) -> list[Element]:
    wanted = [element for element in header.elements if element.name in ("chunk", "vertex", "sh")]
    if header.ascii or len({element.name for element in wanted}) < len(wanted):
        raise refusal(KIND, path, "its packed elements do not have the layout of SuperSplat.")
    return wanted


def _rows(path: Path, element: Element, size: int) -> NDArray[Any]:
    there = element.start + element.count * element.row.itemsize <= size
    rows = np.fromfile(path, element.row, element.count if there else 0, offset=element.start)
    if len(rows) < element.count:  # also refuses a file that becomes shorter while it is read
        raise refusal(KIND, path, f"it is cut short: its element {element.name} is incomplete.")
    return rows


def _check(path: Path, header: Header, rows: dict[str, NDArray[Any]]) -> None:
    names = {name: set(table.dtype.names or ()) for name, table in rows.items()}
    if not set(PACKED) <= names["vertex"] or not set(BOXES) <= names.get("chunk", set()):
        raise refusal(KIND, path, "some of its packed columns or boxes are missing.")
    if any(header.row[name].kind != "u" or header.row[name].itemsize != 4 for name in PACKED):
        raise refusal(KIND, path, "its packed columns are not of type uint.")
    if len(rows["chunk"]) != -(-header.count // CHUNK):
        raise refusal(
            KIND, path, f"it has {len(rows['chunk'])} boxes for {header.count} Gaussians."
        )
    colours = names["chunk"] & {f"{end}_{c}" for c in "rgb" for end in ("min", "max")}
    rest = len(names.get("sh", ()))
    harmonics = rest in [3 * (k - 1) for k in COEFFICIENTS] and (
        not rest or names["sh"] == {f"f_rest_{i}" for i in range(rest)}
    )
    if (
        len(colours) not in (0, 6)
        or not harmonics
        or len(rows.get("sh", rows["vertex"])) != len(rows["vertex"])
    ):
        raise refusal(
            KIND, path, "its colours are incomplete, or do not match the number of Gaussians."
        )


def _split(packed: NDArray, bits: tuple[int, ...]) -> NDArray[np.float32]:
    """Unpack the bit fields of integers, highest bits first, to fractions 0..1 [N,len(bits)]."""
    out = np.empty((len(packed), len(bits)), np.float32)
    shift = sum(bits)
    for i, width in enumerate(bits):
        shift -= width
        mask = (1 << width) - 1
        out[:, i] = ((packed >> np.uint32(shift)) & np.uint32(mask)) / np.float32(mask)
    return out


def _within(
    fractions: NDArray, chunk: NDArray[Any], which: NDArray, axes: str | tuple[str, ...]
) -> NDArray[np.float64]:
    """Map fractions 0..1 to the range that is stated for each chunk, in double precision."""
    out = np.empty(fractions.shape)
    for i, axis in enumerate(axes):
        low, high = (chunk[f"{end}_{axis}"].astype(np.float64)[which] for end in ("min", "max"))
        out[:, i] = low * (1 - fractions[:, i]) + high * fractions[:, i]
    return out


def _rotations(packed: NDArray) -> NDArray[np.float32]:
    others = (_split(packed & np.uint32((1 << 30) - 1), (10, 10, 10)) - 0.5) * np.sqrt(2)
    return restore_largest(others, packed >> np.uint32(30))


def _harmonics(first: NDArray, table: NDArray[Any] | None) -> NDArray[np.float32]:
    if table is None or not table.dtype.names:
        return first[:, None].astype(np.float32)
    count = len(table.dtype.names)
    values = np.stack([table[f"f_rest_{i}"] for i in range(count)], axis=1)
    # A byte represents the middle of its bin, but 0 and 255 represent the ends of the range.
    inside = (values.astype(np.float32) + 0.5) / 256
    inside[values == 0], inside[values == 255] = 0, 1
    rest = ((inside - 0.5) * 8).reshape(len(values), 3, count // 3).transpose(0, 2, 1)
    kept = rest[:, : LARGEST_SH - 1]
    return np.concatenate([first[:, None], kept], axis=1, dtype=np.float32)
