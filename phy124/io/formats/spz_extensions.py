"""Extensions of SPZ: records of a type, a length (uint32 each) and that many bytes.

Niantic's text knows one that changes the Gaussians, Adobe's 0xADBE0003: which way the axes of the
file point (uint32). Its names have a letter for x, y and z: left or right, up or down, front (away
from the viewer) or back. Half of these systems are left-handed. Others, such as the limits of a
viewer's camera, are passed over.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

RECORD = struct.Struct("<II")
AXES = 0xADBE0003
SYSTEMS = (
    "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF",
    "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU",
)  # fmt: skip
"""Names of the systems 1 to 16."""
USUAL = "RUB"
"""The system of a file that does not name one."""
DIRECTIONS = {
    "R": (1, 0, 0), "U": (0, 1, 0), "B": (0, 0, 1),
    "L": (-1, 0, 0), "D": (0, -1, 0), "F": (0, 0, -1),
}  # fmt: skip
MOST_NAMED = 8


class Extensions(NamedTuple):
    """What the extensions of a file say."""

    system: str = USUAL
    """Where x, y and z point."""
    notes: tuple[str, ...] = ()

    @property
    def axes(self) -> tuple[str, str]:
        """Directions of the file that point up and to the front of the object, to the viewer."""
        return _axis(self.system, "UD"), _axis(self.system, "BF")

    @property
    def left_handed(self) -> bool:
        """Whether a file must be mirrored to be seen as it was meant."""
        return bool(np.linalg.det([DIRECTIONS[letter] for letter in self.system]) < 0)


def read_extensions(data: bytes) -> Extensions:
    """What the records in the bytes of a file say; damaged ones are passed over, with a note."""
    system, notes, unknown, at = None, [], [], 0
    while at < len(data):
        kind, size = RECORD.unpack_from(data, at) if at + RECORD.size <= len(data) else (0, 1 << 32)
        at += RECORD.size
        payload = data[at : at + size]
        at += size
        if at > len(data):
            notes.append("Its extensions are cut short; what is left of them was passed over.")
        elif kind == AXES:
            (value,) = struct.unpack("<I", payload) if size == 4 else (0,)
            if 1 <= value <= len(SYSTEMS):
                system = system or SYSTEMS[value - 1]
            else:
                notes.append(f"Its system of axes, {value}, is unknown: {USUAL} is assumed.")
        else:
            unknown.append(f"{kind:#010x}")
    if unknown:
        listed = ", ".join(list(dict.fromkeys(unknown))[:MOST_NAMED])
        notes.insert(0, f"Extensions that are not known were passed over: {listed}.")
    found = Extensions(system or USUAL)
    if found.left_handed:
        notes.append(f"Its axes are left-handed ({system}): it was mirrored along x.")
    return found._replace(notes=tuple(notes))


def _axis(system: str, letters: str) -> str:
    """The axis that points as the first of two opposite letters, with its sign."""
    (at,) = (i for i, letter in enumerate(system) if letter in letters)
    return "xyz"[at] if system[at] == letters[0] else f"-{'xyz'[at]}"
