"""Lists the kernels of a run on lattices, so that they can be compiled before the run."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from phy124.kernels.diagnostics import make_totals
from phy124.kernels.lattice import nodes as node_kernels
from phy124.kernels.lattice import points as point_kernels
from phy124.kernels.lattice import simd
from phy124.kernels.lattice.stress import make_lattice_measure, make_shock, make_stress
from phy124.lattice import solids, walls
from phy124.lattice.walls import Boundary


def of_bodies(
    materials: Iterable[Any],
    boundaries: Sequence[Boundary],
    shapes: Iterable[str],
    real: Any,
    device: str,
    *,
    dx: float,
    several: bool,
) -> Iterator[Any]:
    """Yield the kernels of bodies on lattices, and of their contact with walls and solids.

    Args:
        materials: Materials of the bodies.
        boundaries: Boundaries of the run.
        shapes: Shapes of the freely moving rigid solids.
        real: wp.float32 or wp.float64.
        device: Name of the device.
        dx: Side of a cell [m].
        several: Whether there are several bodies.
    """
    laws = {
        section.device_law.name: (section.device_law, math.isfinite(section.viscous_limit(dx)))
        for section in materials
    }
    yield from of_workers(list(laws.values()), real, device)
    yield from walls.kernels(boundaries, real, device, several=several)
    yield from solids.kernels_of(shapes, real, device)


def of_workers(model_laws: Sequence[tuple[Any, bool]], real: Any, device: str) -> Iterator[Any]:
    """Yield the kernels of a run; `model_laws` contains each law, and whether it is viscous."""
    vectors = simd.usable(real, device)
    if vectors:
        yield from (simd.make_kick_simd(), simd.make_drift_simd(), simd.make_follow_simd())
        yield simd.make_shock_simd()
    else:
        yield from (node_kernels.make_kick(real), node_kernels.make_drift(real))
        yield from (point_kernels.make_follow(real), make_shock(real))
    yield node_kernels.make_node_totals(real)
    yield from (node_kernels.make_try(real), node_kernels.make_compare(real))
    for law, viscous in model_laws:
        if vectors and simd.has_stress(law):
            yield from (simd.make_stress_simd(law, viscous), simd.make_totals_simd(law))
            yield simd.make_measure_simd()
            continue
        yield from (make_stress(law, real, viscous), make_lattice_measure(real))
        yield make_totals(law, real, on_lattice=True)
