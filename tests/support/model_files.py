"""PLY files of any columns, and GLB files with another description."""

import json
import struct
from pathlib import Path

import numpy as np

NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int", "u2": "ushort"}


def ply_of(path: Path, columns: dict, *, kinds=None, ascii=False, comments=()) -> Path:
    """Write a PLY file with some columns; a column is an array or one value for all rows.

    Args:
        columns: Values by name.
        kinds: NumPy types by name; the default is float32.
    """
    count = max(np.size(values) for values in columns.values())
    types = [(name, "<" + (kinds or {}).get(name, "f4")) for name in columns]
    rows = np.empty(count, types)
    for name, values in columns.items():
        rows[name] = values
    head = ["ply", f"format {'ascii' if ascii else 'binary_little_endian'} 1.0"]
    head += [f"comment {comment}" for comment in comments] + [f"element vertex {count}"]
    head += [f"property {NAMES[kind[1:]]} {name}" for name, kind in types]
    body = rows.tobytes()
    if ascii:
        body = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()).encode()
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + body)
    return path


def edited(data: bytes, change) -> bytes:
    """Return a GLB with another JSON description."""
    (size,) = struct.unpack_from("<I", data, 12)
    tree = json.loads(data[20 : 20 + size])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return head + struct.pack("<II", len(text), 0x4E4F534A) + text + rest
