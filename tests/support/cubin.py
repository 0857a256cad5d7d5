"""Reads the resources that a kernel needs on a GPU from the machine code, without running it.

NVRTC, which comes with Warp, generates the machine code for a GPU generation. The ELF section
.nv.info of the code states the registers and the bytes of stack per thread. The stack contains
arrays with computed indices, which are declared in the PTX. All other bytes of the stack are
spilled registers.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import warp as wp

ARCHITECTURES = {75: "Turing", 80: "A100", 86: "A40, RTX 30", 90: "H100", 120: "RTX 50"}
"""Cards by compute capability."""
REGISTERS, STACK = 0x2F, 0x11
"""Attributes of a function in .nv.info."""


class Usage(NamedTuple):
    """Resources of one thread of a kernel."""

    registers: int
    stack: int
    """Bytes of local memory."""
    spilled: int
    """Bytes of local memory that contain spilled registers."""


def usage(kernel: Any, architecture: int) -> dict[str, Usage]:
    """Return the resources of each kernel of a module, compiled for an architecture."""
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
    """Return the largest number of registers per thread of the kernels in a module."""
    return max(taken.registers for taken in usage(kernel, architecture).values())


def _compiled(module: Any, architecture: int, folder: str, *, ptx: bool) -> bytes:
    (path,) = wp.compile_aot_module(module, arch=architecture, module_dir=folder, use_ptx=ptx)
    return Path(path).read_bytes()


def _declared(ptx: bytes) -> int:
    """Return the bytes of arrays in local memory that all functions of a PTX text declare."""
    return sum(int(size) for size in re.findall(rb"__local_depot\d+\[(\d+)\]", ptx))


def _functions(code: bytes) -> Iterator[tuple[str, tuple[int, int]]]:
    """Return name, registers and bytes of stack of each kernel."""
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
    """Yield attribute, symbol and value of each entry with two numbers."""
    end = at + length
    while at < end:
        form, attribute, extent = struct.unpack_from("<BBH", code, at)
        sized = form == 4
        if sized and extent == 8:
            yield attribute, *struct.unpack_from("<II", code, at + 4)
        at += 4 + (extent if sized else 0)


def _sections(code: bytes) -> Iterator[tuple[str, tuple[int, int]]]:
    """Return name, position and length of each section of a 64-bit ELF file."""
    (start,) = struct.unpack_from("<Q", code, 0x28)
    size, count, names = struct.unpack_from("<HHH", code, 0x3A)
    result = [struct.unpack_from("<IIQQQQ", code, start + i * size) for i in range(count)]
    for name, _, _, _, at, length in result:
        yield _text(code, result[names][4] + name), (at, length)


def _text(code: bytes, at: int) -> str:
    return code[at : code.index(b"\0", at)].decode()
