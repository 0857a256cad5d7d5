"""The kernels of lattice/stress.py for neo-Hookean bodies, with vector instructions of a CPU.

A thread processes a block of sixteen cells. `order` [blocks,16] lists the cells of each block, full
cells first. In the list of all cells, the cells of a block are `APART` cells apart, so that no two
cells write to the same node at nearly the same time. `packed` [blocks,8,4,16] stores the three
components of `offset`, and the volume, of each point.
"""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import Doubles, Ints
from phy124.kernels.build import build_once
from phy124.kernels.diagnostics import ELASTIC, POWER
from phy124.kernels.elastic import neo_hookean, neo_hookean_damped
from phy124.kernels.lattice.nodes import make_drift, make_kick
from phy124.kernels.lattice.points import PER_CELL
from phy124.kernels.lattice.stress import QUADRATIC, STEEPEST
from phy124.kernels.native import code, constants, native_kernel
from phy124.kernels.transfer import Law

CELLS = 16
"""Number of cells that a thread handles."""
APART = 4
"""Distance between the cells of a block in the list of all cells, which is sorted along z."""
NODES = 256
"""Number of nodes that a thread handles."""
GAUSS = 1 + np.array(list(itertools.product((-1, 1), repeat=3))) / math.sqrt(12)
"""Positions of the Gauss points relative to a cell's first node [8,3], cells; in the order of the
integration points.
"""
ALIGNED = 1e-4
"""Largest distance of an integration point of a full cell from a Gauss point [cells]."""
MOTION = "lattice", "lattice:strains", "lattice:rates"
"""Names of the C++ snippets that compute strains and strain rates."""


def usable(real: Any, device: str) -> bool:
    """Return whether vectorised kernels exist for a precision and a device."""
    return real is wp.float32 and device == "cpu"


def has_stress(law: Law) -> bool:
    """Return whether a vectorised stress kernel exists for a constitutive law."""
    return law.stress in (neo_hookean, neo_hookean_damped)


class Blocks(NamedTuple):
    """Cells of a lattice, grouped in blocks of sixteen."""

    order: NDArray[np.int32]
    """Cells in each block [blocks,16]."""
    packed: NDArray[np.float32]
    """Constants of the integration points [blocks,8,4,16]; missing cells have no volume."""
    full: int
    """Number of blocks in which all cells are full; these blocks come first."""


def pack(offset: NDArray, volume: NDArray, cells: NDArray) -> Blocks:
    """Group cells of a lattice into blocks.

    Args:
        offset: Positions of the cells' points relative to the first node of their cell [8C,3],
            cells.
        volume: Volumes of the points [8C], m^3.
        cells: Indices of the cells, sorted [C].
    """
    rows = np.concatenate([offset, volume[:, None]], axis=1).reshape(-1, PER_CELL, 4)
    wrong = np.abs(rows[:, :, :3] - GAUSS)
    whole = wrong.max(axis=(1, 2)) < ALIGNED
    parts, constants = [], []
    for chosen in (np.flatnonzero(whole), np.flatnonzero(~whole)):
        blocks = -(-len(chosen) // CELLS)
        missing = blocks * CELLS - len(chosen)
        filled = np.concatenate([chosen, np.repeat(chosen[-1:], missing)])
        values = rows[filled]
        values[len(chosen) :, :, 3] = 0
        runs = np.split(np.arange(len(filled)), range(APART * CELLS, len(filled), APART * CELLS))
        places = np.concatenate([run.reshape(CELLS, -1).T for run in runs])
        parts.append(filled[places])
        constants.append(np.moveaxis(values[places], 1, -1))
    order = cells[np.concatenate(parts)].astype(np.int32)
    packed = np.ascontiguousarray(np.concatenate(constants), dtype=np.float32)
    return Blocks(np.ascontiguousarray(order), packed, len(parts[0]))


@build_once
def make_stress_simd(law: Law, viscous: bool):
    """Kernel over blocks of sixteen cells, equivalent to `make_stress`, for float32 on a CPU.

    If the law is viscous, the kernel also updates the maxima of `make_measure_simd`.
    """
    kind = "viscous" if viscous else "elastic"
    motion = (*MOTION, "lattice:survey") if viscous else MOTION[:2]
    pieces = f"lattice:{kind}", "lattice:laws", "lattice:stress", "lattice:scatter"
    body = f"const int width = {law.width};\n" + code(*motion, *pieces)

    @native_kernel(
        f"phy124_lattice_{law.name}_{kind}_simd", body, wp.float32, width=law.width, seconds=1.0
    )
    def lattice_stress_simd(
        full_blocks,
        first,
        low,
        dx,
        theta,
        order,
        packed,
        rows,
        u,
        v,
        force_out,
        maxima_out,
        stray_out,
    ):
        """Add the forces of the points of sixteen cells to the nodes."""

    return lattice_stress_simd


@build_once
def make_shock_simd():
    """Kernel over blocks of sixteen cells, equivalent to `make_shock`, for float32."""
    pieces = *MOTION, "lattice:shock", "lattice:scatter"
    body = constants("float", QUADRATIC=QUADRATIC, STEEPEST=STEEPEST) + code(*pieces)

    @native_kernel("phy124_lattice_shock_simd", body, wp.float32, seconds=1.0)
    def lattice_shock_simd(full_blocks, low, dx, mass, order, packed, rows, clock, u, v, force_out):
        """Add the forces of the artificial viscosity in sixteen cells to the nodes."""

    return lattice_shock_simd


@build_once
def make_measure_simd():
    """Kernel over blocks of sixteen cells, equivalent to `make_lattice_measure`, for float32."""

    @native_kernel(
        "phy124_lattice_measure_simd",
        code(*MOTION, "lattice:survey", "lattice_points:measure"),
        wp.float32,
        seconds=1.0,
    )
    def lattice_measure_simd(full_blocks, dx, order, packed, rows, u, v, maxima_out, stray_out):
        """Update the maxima of speed and strain rate with the values of sixteen cells."""

    return lattice_measure_simd


@build_once
def make_totals_simd(law: Law):
    """Kernel over blocks of sixteen cells: computes the energy sums of `make_totals`."""
    numbers = f"const int width = {law.width}, ELASTIC = {ELASTIC}, POWER = {POWER};\n"

    @native_kernel(
        f"phy124_lattice_totals_{law.name}_simd",
        numbers + code(*MOTION, "lattice:laws", "lattice_points:totals"),
        wp.float32,
        width=law.width,
        seconds=1.0,
    )
    def lattice_totals_simd(
        full_blocks,
        first,
        dx,
        theta,
        order,
        packed,
        rows,
        u,
        v,
        sums_out,
        range_out: Doubles,
        counts_out,
        first_out: Ints,
    ):
        """Sum the energy and the power of the points of sixteen cells."""

    return lattice_totals_simd


@build_once
def make_follow_simd():
    """Kernel over blocks of sixteen cells, equivalent to `make_follow`, for float32."""

    @native_kernel(
        "phy124_lattice_follow_simd",
        code(*MOTION, "lattice_points:places", "lattice_points:follow"),
        wp.float32,
        seconds=1.0,
    )
    def lattice_follow_simd(
        full_blocks, dx, order, packed, rows, rest, u, v, x_out, v_out, C_out, F_out
    ):
        """Compute x, v, C and F of the points of sixteen cells."""

    return lattice_follow_simd


@build_once
def make_locate_simd():
    """Kernel over blocks of sixteen cells, equivalent to `make_locate`, for float32."""

    @native_kernel(
        "phy124_lattice_locate_simd",
        code("lattice", "lattice_points:places", "lattice_points:locate"),
        wp.float32,
        seconds=0.6,
    )
    def lattice_locate_simd(
        full_blocks, dx, order, packed, rows, rest, u, v, x_out, v_out, v_kept_out
    ):
        """Compute x and v of the points of sixteen cells."""

    return lattice_locate_simd


@build_once
def make_kick_simd():
    """Kernel over groups of `NODES` nodes, equivalent to `make_kick`, for float32."""
    return native_kernel("phy124_lattice_kick_simd", code("lattice_nodes:kick"), seconds=0.3)(
        make_kick(wp.float32).func
    )


@build_once
def make_drift_simd():
    """Kernel over groups of `NODES` nodes, equivalent to `make_drift`, for float32."""
    return native_kernel("phy124_lattice_drift_simd", code("lattice_nodes:drift"), seconds=0.3)(
        make_drift(wp.float32).func
    )
