"""The kernels of lattice/stress.py for neo-Hookean bodies on the vector units of a CPU.

A thread processes a block of sixteen cells. A cell has eight integration points, and a point has
five constants: the three components of `offset`, the volume and the density. `packed`
[blocks,8,5,16] stores each constant of each point for all sixteen cells of a block in a row.
"""

from functools import cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice.points import PER_CELL
from phy124.kernels.lattice.stress import FLATTEST
from phy124.kernels.native import code, constants, native_kernel
from phy124.kernels.transfer import Law

CELLS = 16
"""Number of cells of a thread."""
Vectors = wp.array(dtype=wp.vec3)
Numbers = wp.array(dtype=wp.float32)


def usable(law: Law, real: Any, device: str) -> bool:
    """Return whether a law, precision and device have kernels for vector units."""
    return law.name.startswith("neo_hookean") and real is wp.float32 and device == "cpu"


def pack(offset: NDArray, volume: NDArray, mass: NDArray) -> NDArray[np.float32]:
    """Return the constants of points, in blocks of sixteen cells.

    Args:
        offset: Positions of the points relative to their cell's first node [P,3], cells.
        volume: Volumes of the points [P], m^3.
        mass: Masses of the points [P], kg.

    Returns:
        An array [blocks,8,5,16]; points beyond the last cell have no volume.
    """
    columns = [offset, volume[:, None], (mass / volume)[:, None]]
    rows = np.concatenate(columns, axis=1).reshape(-1, PER_CELL, 5)
    missing = -len(rows) % CELLS
    last = np.repeat(rows[-1:], missing, axis=0)
    last[:, :, 3] = 0
    blocks = np.concatenate([rows, last]).reshape(-1, CELLS, PER_CELL, 5)
    return np.ascontiguousarray(np.moveaxis(blocks, 1, -1), dtype=np.float32)


@cache
def make_stress_simd(law: Law, viscous: bool):
    """Kernel over blocks of sixteen cells: works like `make_stress`, for float32 on a CPU."""
    kind = "viscous" if viscous else "elastic"
    pieces = ["lattice", *(["lattice:rates"] if viscous else []), f"lattice:{kind}"]
    body = f"const int width = {law.width};\n" + code(*pieces, "lattice:stress")

    @native_kernel(f"phy124_lattice_{law.name}_{kind}_simd", body, seconds=1.0)
    def lattice_stress_simd(
        start_cell: int,
        end_cell: int,
        first: int,
        low: int,
        dx: float,
        theta: wp.array(dtype=wp.types.vector(law.width, wp.float32)),
        packed: Numbers,
        rows: wp.array(dtype=int),
        u: Vectors,
        v: Vectors,
        force_out: Vectors,
    ):
        """Add the forces of the points of sixteen cells to the nodes."""

    return lattice_stress_simd


@cache
def make_measure_simd(law: Law, viscous: bool):
    """Kernel over blocks of sixteen cells: works like `make_lattice_measure`, for float32 on a CPU.

    The squared least stretch is up to 2 % too small.
    """
    kind = "shortened" if viscous else "lossless"
    head = f"const int width = {law.width};\n" + constants("float", FLATTEST=float(FLATTEST))
    body = head + code("lattice", "lattice:rates", f"lattice:{kind}", "lattice:measure")

    @native_kernel(f"phy124_lattice_measure_{law.name}_{kind}_simd", body, seconds=1.0)
    def lattice_measure_simd(
        start_cell: int,
        end_cell: int,
        first: int,
        low: int,
        dx: float,
        length: float,
        theta: wp.array(dtype=wp.types.vector(law.width, wp.float32)),
        packed: Numbers,
        rows: wp.array(dtype=int),
        u: Vectors,
        v: Vectors,
        bound_out: Numbers,
        maxima_out: Numbers,
        stray_out: wp.array(dtype=int),
    ):
        """Raise the maxima of speed, rate of strain and stiffness over sixteen cells."""

    return lattice_measure_simd
