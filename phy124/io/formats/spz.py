"""Reads and writes SPZ (Niantic), versions 1 to 4: 16 to 64 bytes per Gaussian before compression.

    header, 16 bytes        magic "NGSP", version, count (uint32 each), degree of the harmonics,
                            fractional bits of the centres, flags (1: antialiased,
                            2: there are extensions), reserved
    version 4, 16 more      "reserved" is the number of streams; offset of their table (uint32), 0
    table (version 4)       sizes of each stream (uint64): compressed, raw

    section     bytes      meaning
    centres     6          version 1: 3 x float16
                9          later: 3 x int24, / 2^bits
    opacity     1          / 255
    colour      3          degree 0: (value / 255 - 1/2) / 0.15
    scale       3          logarithm: value / 16 - 10
    rotation    3          versions 1 and 2: x, y, z: value / 127.5 - 1; w follows from the length 1
                4          later: 2 bits: index in x, y, z, w of the largest component, which is
                           omitted; for each other component a sign and 9 bits, / 511 sqrt 2
    harmonics   9, 24, 45  of degree 1 to 3: coefficient by coefficient, (value - 128) / 128

In versions 1 to 3, the file is compressed with gzip. In version 4, each section is a separate
Zstandard stream. Extensions follow the sections, or precede the table in version 4. The axes are x
right, y up, z towards the viewer, unless an extension states other axes. As in Niantic's program,
harmonics are written with 5 bits for degree 1, and with 4 bits for higher degrees.
"""

import struct
import zlib
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, mirror_signs
from phy124.io.content import (
    DEGREE_4,
    LARGEST_SH,
    Content,
    check_count,
    content_of,
    read_whole_file,
    refusal,
)
from phy124.io.formats.quantise import drop_largest, restore_largest

RECORD = struct.Struct("<II")
AXES = 0xADBE0003
SYSTEMS = (
    *(x + y + z for z in "BF" for y in "DU" for x in "LR"),
    *(x + y + z for y in "FB" for z in "DU" for x in "LR"),
)
"""Coordinate systems number 1 to 16; the letters are the directions of x, y and z."""
USUAL = "RUB"
"""The coordinate system of a file that does not state one."""
DIRECTIONS = {"R": (1, 0, 0), "U": (0, 1, 0), "B": (0, 0, 1)}
DIRECTIONS |= {"L": (-1, 0, 0), "D": (0, -1, 0), "F": (0, 0, -1)}
MOST_NAMED = 8


class Extensions(NamedTuple):
    """The supported extensions of a file, and notes about other extensions."""

    system: str = USUAL
    """Directions of x, y and z, as letters: right, left, up, down, back or front."""
    notes: tuple[str, ...] = ()

    @property
    def axes(self) -> tuple[str, str]:
        """Axes of the file that point up and to the viewer, whom the object faces."""
        return _axis(self.system, "UD"), _axis(self.system, "BF")

    @property
    def left_handed(self) -> bool:
        """Whether the axes are left-handed and the file must be mirrored."""
        return bool(np.linalg.det([DIRECTIONS[letter] for letter in self.system]) < 0)


def read_extensions(data: bytes) -> Extensions:
    """Read the extensions of an SPZ file; a note reports a damaged record, which is ignored."""
    system, notes, unknown, at = None, [], [], 0
    while at < len(data):
        kind, size = RECORD.unpack_from(data, at) if at + RECORD.size <= len(data) else (0, 1 << 32)
        at += RECORD.size
        payload = data[at : at + size]
        at += size
        if at > len(data):
            notes.append("The file ends inside an extension; this extension was ignored.")
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
        notes.insert(0, f"Unknown extensions were ignored: {listed}.")
    extensions = Extensions(system or USUAL)
    if extensions.left_handed:
        notes.append(f"Its axes are left-handed ({system}): it was mirrored along x.")
    return extensions._replace(notes=tuple(notes))


def _axis(system: str, letters: str) -> str:
    (at,) = (i for i, letter in enumerate(system) if letter in letters)
    return "xyz"[at] if system[at] == letters[0] else f"-{'xyz'[at]}"


KIND = "SPZ"
MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
FOURTH = struct.pack("<I", 4)
HEADER = struct.Struct("<4sIIBBBB")
MORE = struct.Struct("<I12x")
ENTRY = struct.Struct("<QQ")
ANTIALIASED, EXTENDED = 1, 2
MOST_RECORDS = 1 << 20
"""Largest number of bytes of the extensions that are read; the rest is ignored."""
COLOUR = 0.15
FINENESS = 16
"""An object of 1 m has 2^16 steps of the centres. Smaller objects have as many steps if possible,
and larger objects have this step if their coordinates fit into 24 bits.
"""
MOST_BITS = 23
"""Largest number of fractional bits of the centres."""
REACH = (1 << 23) - 1
GZIP_LEVEL = 4
"""gzip level for writing; level 6 would take twice as long and save 1 %."""
LEVEL = 9
"""Zstandard level for writing; higher levels would take longer and hardly save space."""
WINDOW = 1 << 27
"""Largest window of a Zstandard stream that is read [bytes]."""
HARMONIC_BITS = (5, 4, 4)
"""Numbers of bits with which harmonics of degree 1, 2 and 3 are written."""


class Head(NamedTuple):
    """The fields in the first 16 bytes of an SPZ file."""

    magic: bytes
    version: int
    gaussians: int
    degree: int
    bits: int
    flags: int
    streams: int

    @property
    def sizes(self) -> list[int]:
        """Sizes of the sections that are not empty [bytes]."""
        centre, rotation = 6 if self.version < 2 else 9, 3 if self.version < 3 else 4
        harmonics = 3 * ((self.degree + 1) ** 2 - 1)
        rows = (centre, 1, 3, 3, rotation, harmonics)
        return [self.gaussians * row for row in rows if row]


def read(path: Path) -> Content:
    """Read the Gaussians of an SPZ file.

    Raises:
        InputError: If the file is missing, cut short, damaged or of an unsupported version.
    """
    data = read_whole_file(KIND, path)
    in_streams = data[:4] == MAGIC and data[4:8] == FOURTH
    head, body, records = _streams(path, data) if in_streams else _whole(path, data)
    n, at = head.gaussians, np.cumsum([0, *head.sizes])
    sections = [body[a:b].reshape(n, -1) for a, b in pairwise(at)]
    centres, opacity, colour, scale, rotation, *rest = sections
    raw = {
        "means": _places(head, centres),
        "quats": (_from_three(rotation) if head.version < 3 else _from_four(rotation)),
        "scales": np.exp(scale / np.float32(16) - 10),
        "opacities": opacity[:, 0] / np.float32(255),
        "sh": ((colour / np.float32(255) - np.float32(0.5)) / np.float32(COLOUR))[:, None],
    }
    if rest:
        higher = rest[0].reshape(n, -1, 3)[:, : LARGEST_SH - 1].astype(np.float32)
        raw["sh"] = np.concatenate([raw["sh"], (higher - 128) / 128], axis=1)
    extensions = read_extensions(records)
    if extensions.left_handed:
        _mirror(raw)
    notes = [*extensions.notes, *([DEGREE_4] if head.degree > 3 else [])]
    antialiased = bool(head.flags & ANTIALIASED)
    return content_of(KIND, path, raw, extensions.axes, antialiased=antialiased, notes=notes)


def encode(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """Return the bytes of an SPZ file in format version 3, which most programs read."""
    head, sections = _pack(gaussians, 3, antialiased=antialiased)
    return _gzip(HEADER.pack(*head) + b"".join(sections))


def encode_v4(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """Return the bytes of an SPZ file in format version 4."""
    head, sections = _pack(gaussians, 4, antialiased=antialiased)
    streams = [zstandard.ZstdCompressor(level=LEVEL).compress(section) for section in sections]
    start = HEADER.size + MORE.size
    table = [ENTRY.pack(len(a), len(b)) for a, b in zip(streams, sections, strict=True)]
    return b"".join([HEADER.pack(*head), MORE.pack(start), *table, *streams])


def begins(data: bytes) -> bool:
    """Return whether a file with these first bytes is an SPZ file."""
    if data[:4] == MAGIC:
        return True
    try:
        return data[:2] == GZIP and zlib.decompressobj(31).decompress(data, 4) == MAGIC
    except zlib.error:
        return False


def _mirror(raw: dict[str, NDArray[np.float32]]) -> None:
    raw["means"] *= np.array([-1, 1, 1], np.float32)
    # Mirroring along x reverses rotations about y and z.
    raw["quats"] *= np.array([1, 1, -1, -1], np.float32)
    raw["sh"] *= mirror_signs(raw["sh"].shape[1]).astype(np.float32)[:, None]


def _whole(path: Path, data: bytes) -> tuple[Head, NDArray[np.uint8], bytes]:
    if data[:4] == MAGIC:
        # Browsers unpack a file if the server declares it as compressed by gzip.
        data = _gzip(data, level=0)
    packer = zlib.decompressobj(31)
    try:
        first = packer.decompress(data, HEADER.size)
        head = _head(path, first, len(data), versions=(1, 2, 3))
        wanted = sum(head.sizes)
        body = packer.decompress(packer.unconsumed_tail, wanted)
        records = packer.decompress(packer.unconsumed_tail, MOST_RECORDS)
    except zlib.error as error:
        raise refusal(KIND, path, f"its compressed part is damaged ({error}).") from error
    # The stream ends with a checksum, which is verified only if the end is reached.
    if len(body) < wanted or (len(records) < MOST_RECORDS and not packer.eof):
        raise _short(path)
    return head, np.frombuffer(body, np.uint8), records if head.flags & EXTENDED else b""


def _streams(path: Path, data: bytes) -> tuple[Head, NDArray[np.uint8], bytes]:
    head = _head(path, data[: HEADER.size], len(data), versions=(4,))
    if len(data) < HEADER.size + MORE.size:
        raise _short(path)
    (at,) = MORE.unpack_from(data, HEADER.size)
    sizes = head.sizes
    start = at + ENTRY.size * len(sizes)
    if head.streams != len(sizes) or start > len(data):
        raise refusal(KIND, path, f"its table of {head.streams} streams exceeds the file.")
    parts = []
    for i, wanted in enumerate(sizes):
        size, raw = ENTRY.unpack_from(data, at + ENTRY.size * i)
        if raw != wanted:
            raise refusal(
                KIND, path, f"its header states an impossible size ({raw:,} bytes) for stream {i}."
            )
        if start + size > len(data):
            raise _short(path)
        parts.append(_unpack(path, data[start : start + size], wanted))
        start += size
    records = data[HEADER.size + MORE.size : at][:MOST_RECORDS] if head.flags & EXTENDED else b""
    return head, np.frombuffer(b"".join(parts), np.uint8), records


def _unpack(path: Path, stream: bytes, wanted: int) -> bytes:
    try:
        announced = zstandard.frame_content_size(stream)
        if announced in (-1, wanted):
            unpacker = zstandard.ZstdDecompressor(max_window_size=WINDOW)
            body = unpacker.decompress(stream, max_output_size=wanted)
            if len(body) == wanted:
                return body
    except zstandard.ZstdError as error:
        raise refusal(KIND, path, f"its compressed part is damaged ({error}).") from error
    raise refusal(KIND, path, "one of its streams is longer or shorter than its header states.")


def _head(path: Path, data: bytes, size: int, versions: tuple[int, ...]) -> Head:
    if len(data) < HEADER.size:
        raise _short(path)
    head = Head(*HEADER.unpack(data))
    if head.magic != MAGIC:
        raise refusal(
            KIND, path, "it does not begin with the header of an SPZ file.", "Give an SPZ file."
        )
    if head.version not in versions:
        limit = f"its format version is {head.version}, but only versions 1 to 4 can be read."
        raise refusal(KIND, path, limit, "Export the file again as version 3 or 4.")
    if head.degree > 4 or head.bits > 23:
        raise refusal(KIND, path, "its header is damaged.")
    check_count(KIND, path, head.gaussians, sum(head.sizes) // max(head.gaussians, 1), size)
    return head


def _short(path: Path) -> Exception:
    return refusal(KIND, path, "it is cut short.")


def _places(head: Head, data: NDArray[np.uint8]) -> NDArray[np.float32]:
    if head.version < 2:
        return np.ascontiguousarray(data).view("<f2").astype(np.float32)
    return _read_24_bits(data) / np.float32(2**head.bits)


def _read_24_bits(data: NDArray[np.uint8]) -> NDArray[np.float32]:
    wide = np.zeros((len(data), 3, 4), np.uint8)
    wide[..., 1:] = data.reshape(-1, 3, 3)
    return (wide.view("<i4")[..., 0] >> 8).astype(np.float32)


def _from_three(data: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Decode quaternions of SPZ format versions 1 and 2; return them in wxyz order."""
    vector = data.astype(np.float32) / np.float32(127.5) - 1
    scalar = np.sqrt(np.maximum(1 - np.square(vector).sum(axis=1, keepdims=True), 0))
    return np.concatenate([scalar, vector], axis=1)


def _from_four(data: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Decode quaternions of SPZ format version 3 and later; return them in wxyz order."""
    packed = np.ascontiguousarray(data).view("<u4")
    fields = (packed >> np.array([20, 10, 0], np.uint32)) & np.uint32(1023)
    size = (fields & 511).astype(np.float32) / np.float32(511 * np.sqrt(2))
    others = np.where(fields >> 9, -size, size)
    return np.roll(restore_largest(others, packed[:, 0] >> 30), 1, axis=1)


def _pack(gaussians: Gaussians, version: int, *, antialiased: bool) -> tuple[Head, list[bytes]]:
    bits = _bits(gaussians.means)
    steps = np.rint(gaussians.means.astype(np.float64) * 2**bits).clip(-REACH, REACH)
    centres = steps.astype("<i4").view(np.uint8).reshape(-1, 3, 4)[..., :3]
    scales = np.log(np.maximum(gaussians.scales, 1e-30))
    sections = [
        centres,
        _byte(gaussians.opacities * 255),
        _byte((gaussians.sh[:, 0] * COLOUR + 0.5) * 255),
        _byte((scales + 10) * 16),
        _to_four(gaussians.quats),
        _harmonics(gaussians.sh[:, 1:]),
    ]
    kept = [section.tobytes() for section in sections if section.size]
    flags = ANTIALIASED if antialiased else 0
    streams = len(kept) if version == 4 else 0
    return Head(MAGIC, version, len(gaussians), gaussians.sh_degree, bits, flags, streams), kept


def _bits(means: NDArray) -> int:
    """Return the number of fractional bits of the centres, which must fit into 24 bits."""
    reach = float(np.abs(means).max(initial=1e-30))
    size = float(np.ptp(means, axis=0).max(initial=1e-30))
    fitting = np.floor(np.log2(REACH / reach))
    wanted = max(FINENESS, FINENESS - np.floor(np.log2(size)))
    return int(np.clip(min(fitting, wanted), 0, MOST_BITS))


def _byte(values: NDArray) -> NDArray[np.uint8]:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def _to_four(quats: NDArray) -> NDArray[np.uint8]:
    others, which = drop_largest(np.roll(quats, -1, axis=1))
    size = np.rint(np.abs(others) * (511 * np.sqrt(2))).clip(0, 511).astype("<u4")
    fields = size | np.where(others < 0, np.uint32(512), np.uint32(0))
    packed = fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2] | which.astype("<u4") << 30
    return packed.astype("<u4")[:, None].view(np.uint8)


def _harmonics(rest: NDArray) -> NDArray[np.uint8]:
    count = rest.shape[1]
    bits = np.repeat(HARMONIC_BITS, (3, 5, 7))[:count, None]
    step = (1 << (8 - bits)).astype(np.int16)
    values = np.rint(rest * 128).clip(-128, 127).astype(np.int16) + 128
    return ((values + step // 2) // step * step).clip(0, 255).astype(np.uint8)


def _gzip(data: bytes, level: int = GZIP_LEVEL) -> bytes:
    packer = zlib.compressobj(level, wbits=31)
    return packer.compress(data) + packer.flush()
