"""What a kernel takes of a GPU: compiled for it here, read from the machine code, nothing run.

NVRTC comes with Warp and makes the very code that a GPU of that generation would be given. How many
registers a thread has and how many bytes of stack stands in the code's ELF section .nv.info. The
stack holds arrays that are indexed by what is computed, which the PTX declares, and registers that
were spilled: what is more than declared is spilled.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import warp as wp

ARCHITECTURES = {75: "Turing", 80: "A100", 86: "A40, RTX 30", 90: "H100", 120: "RTX 50"}
"""Compute capability -> cards that have it."""
REGISTERS, STACK = 0x2F, 0x11
"""Attributes of a function in .nv.info."""


class Usage(NamedTuple):
    """Of one thread of a kernel."""

    registers: int
    stack: int
    """Bytes of local memory."""
    spilled: int
    """Bytes of it that hold registers for which there was no room."""


def usage(kernel: Any, architecture: int) -> dict[str, Usage]:
    """What the kernels of a module take, by kernel, when compiled for an architecture."""
    with TemporaryDirectory() as folder:
        code = _compiled(kernel.module, architecture, folder, ptx=False)
        result = dict(_functions(code))
        declared = 0
        if any(stack for _, stack in result.values()):
            declared = _declared(_compiled(kernel.module, architecture, folder, ptx=True))
    return {
        name: Usage(registers, stack, max(0, stack - declared))
        for name, (registers, stack) in result.items()
    }


def registers(kernel: Any, architecture: int) -> int:
    """Registers per thread, most of all kernels in its module."""
    return max(taken.registers for taken in usage(kernel, architecture).values())


def _compiled(module: Any, architecture: int, folder: str, *, ptx: bool) -> bytes:
    (path,) = wp.compile_aot_module(module, arch=architecture, module_dir=folder, use_ptx=ptx)
    return Path(path).read_bytes()


def _declared(ptx: bytes) -> int:
    """Bytes of arrays in local memory that PTX declares, over all its functions."""
    return sum(int(size) for size in re.findall(rb"__local_depot\d+\[(\d+)\]", ptx))


def _functions(code: bytes) -> Iterator[tuple[str, tuple[int, int]]]:
    """Name, registers and bytes of stack of each kernel."""
    sections = dict(_sections(code))
    symbols, names = sections[".symtab"][0], sections[".strtab"][0]
    taken: dict[int, dict[int, int]] = {}
    for attribute, symbol, value in _attributes(code, *sections[".nv.info"]):
        taken.setdefault(symbol, {})[attribute] = value
    for symbol, values in taken.items():
        if REGISTERS in values:
            (name,) = struct.unpack_from("<I", code, symbols + 24 * symbol)
            yield _text(code, names + name), (values[REGISTERS], values.get(STACK, 0))


def _attributes(code: bytes, at: int, length: int) -> Iterator[tuple[int, int, int]]:
    """Attribute, symbol and value of each entry with two numbers."""
    end = at + length
    while at < end:
        form, attribute, extent = struct.unpack_from("<BBH", code, at)
        sized = form == 4
        if sized and extent == 8:
            yield attribute, *struct.unpack_from("<II", code, at + 4)
        at += 4 + (extent if sized else 0)


def _sections(code: bytes) -> Iterator[tuple[str, tuple[int, int]]]:
    """Name, place and length of each section of an ELF file of 64 bits."""
    (start,) = struct.unpack_from("<Q", code, 0x28)
    size, count, names = struct.unpack_from("<HHH", code, 0x3A)
    result = [struct.unpack_from("<IIQQQQ", code, start + i * size) for i in range(count)]
    for name, _, _, _, at, length in result:
        yield _text(code, result[names][4] + name), (at, length)


def _text(code: bytes, at: int) -> str:
    return code[at : code.index(b"\0", at)].decode()
