"""Parses the header of a PLY file (Turk 1994): the elements, and the data type of their rows."""

import re
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from phy124.errors import InputError
from phy124.io import content

MAX_BYTES = 65536
"""Size of the longest header that is accepted [bytes]; headers usually have about 1500 bytes."""
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
MOST_DIGITS = 30
LINE_ENDS = rb"\r\n|\n|\r"
"""Byte sequences that end a line; `str.splitlines` would also split at other characters."""
SPLATS = "Keep the file unchanged: `phy124 convert`, `phy124 simulate` and other commands read it."
refusal = partial(content.refusal, "PLY")
CONVERT = "Convert it with `npx @playcanvas/splat-transform IN OUT.ply` and give OUT.ply."


@dataclass(frozen=True)
class Element:
    """A PLY element: its name, and the number, the data type and the position of its rows."""

    name: str
    count: int
    row: np.dtype[Any]
    """Data type of one row of the element, without padding, in the file's byte order."""
    start: int


@dataclass(frozen=True)
class Header:
    """Position and data type of the rows of element `vertex`, and the elements before it."""

    ascii: bool
    count: int
    row: np.dtype[Any]
    """Data type of one row of `vertex`, without padding, in the file's byte order."""
    start: int
    """Offset [bytes] of the first row of `vertex`, or of all data in an ascii file."""
    skip_lines: int
    """Number of lines of other elements before `vertex` in an ascii file."""
    elements: tuple[Element, ...]
    """The elements that come before the first element with list properties."""
    comments: tuple[str, ...] = ()


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    has_list: bool = False


def read_header(path: Path) -> Header:
    """Parse the header of a PLY file.

    Raises:
        InputError: If the file is missing, is not a PLY file, or has an invalid header.
    """
    lines, start = _header_lines(path)
    words = [line for line in lines if line and line[0] not in ("comment", "obj_info")]
    encoding = words[1][1] if len(words) > 1 and words[1][0] == "format" else None
    if encoding not in ORDERS:
        raise refusal(
            path, "its header does not state whether it is ascii or binary.", "Export it again."
        )
    try:
        elements = _elements(words[2:])
        vertex = next((i for i, e in enumerate(elements) if e.name == "vertex"), None)
        if vertex is None:
            raise refusal(path, "it has no element vertex.", "Give a Gaussian splatting PLY.")
        if any(e.has_list for e in elements[: vertex + 1]):
            raise refusal(
                path, "it has list properties before or in its vertices.", "Export Gaussians alone."
            )
        before, wanted = elements[:vertex], elements[vertex]
        after = takewhile(lambda e: e.properties and not e.has_list, elements[vertex + 1 :])
        located = _locate([*before, wanted, *after], ORDERS[encoding], start)
    except (IndexError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise refusal(path, f"its header is malformed ({error}).", "Export it again.") from error
    return Header(
        ascii=encoding == "ascii",
        count=wanted.count,
        row=located[vertex].row,
        start=start if encoding == "ascii" else located[vertex].start,
        skip_lines=sum(e.count for e in before),
        elements=located,
        comments=tuple(" ".join(line[1:]) for line in lines if line[:1] == ["comment"]),
    )


def _header_lines(path: Path) -> tuple[list[list[str]], int]:
    content.check_opens("PLY", path)
    with open(path, "rb") as file:
        head = file.read(MAX_BYTES)
    if not head:
        raise refusal(path, "it is empty (0 bytes).", "Copy or download the file again.")
    if head[:4] in (b"NGSP", b"glTF") or head[:2] in (b"\x1f\x8b", b"PK"):
        raise refusal(path, "it is an SPZ, SOG, GLB or zip file, not a PLY.", SPLATS)
    if head[:4] not in (b"ply\n", b"ply\r"):
        raise refusal(path, "it is not a PLY file: it does not begin with `ply`.", CONVERT)
    lines, start = [], 0
    # If lines end in \r alone, a \n after the last line is the first byte of the data.
    ends = LINE_ENDS if head[3:5] == b"\r\n" or head[3:4] == b"\n" else b"\r"
    for end in re.finditer(ends, head):
        words = head[start : end.start()].split()
        start = end.end()
        if words == [b"end_header"]:
            return lines, start
        lines.append([word.decode("utf-8", "replace") for word in words])
    if len(head) < MAX_BYTES:
        raise refusal(
            path, "it is cut short within its header.", "Copy or download the file again."
        )
    raise refusal(path, f"its header is longer than {MAX_BYTES:,} bytes.", "Export it again.")


def _elements(words: list[list[str]]) -> list[_Element]:
    elements: list[_Element] = []
    for line in words:
        if line[0] == "element":
            if not (line[2].isascii() and line[2].isdigit() and len(line[2]) <= MOST_DIGITS):
                raise ValueError(f"element {line[1][:40]} counts {line[2][:40]} rows")
            elements.append(_Element(line[1], int(line[2])))
        elif line[0] == "property" and line[1] == "list":
            elements[-1].has_list = True
        elif line[0] == "property":
            if line[1] not in TYPES:
                raise ValueError(f"unknown type {line[1][:40]}")
            elements[-1].properties.append((line[2], TYPES[line[1]]))
        else:
            raise ValueError(f"unknown word {line[0][:40]}")
    return elements


def _locate(elements: list[_Element], order: str, start: int) -> tuple[Element, ...]:
    located = []
    for element in elements:
        if not element.properties:
            raise ValueError(f"element {element.name} has no properties")
        row = np.dtype([(name, order + kind) for name, kind in element.properties])
        located.append(Element(element.name, element.count, row, start))
        start += element.count * row.itemsize
    return tuple(located)
