"""Lists the kernels of the steps of a liquid, so that they can be compiled before a run."""

from collections.abc import Iterator, Sequence
from typing import Any

from phy124.boundaries import Boundary
from phy124.kernels.liquid import (
    active,
    bodies,
    energies,
    faces,
    films,
    impulses,
    mixture,
    packing,
    pressure,
    shapes,
    spread,
    surface,
    transfer,
)
from phy124.kernels.liquid.solids import make_push
from phy124.liquid import projection
from phy124.liquid.solids import solid_kernels
from phy124.liquid.viscosity import viscosity_kernels
from phy124.liquid.walls import wall_kernels


def kernels(
    boundaries: Sequence[Boundary],
    solids: Sequence[str],
    real: Any,
    form: str,
    device: str = "cpu",
    *,
    mixed: bool = False,
    pushed: bool = False,
) -> Iterator[Any]:
    """Yield the kernels of a liquid's steps, except the kernels of forces on particles.

    Args:
        boundaries: The walls.
        solids: Shapes of the freely moving rigid solids.
        real: wp.float32 or wp.float64.
        form: Implementation of the transfers, "plain" or "simd".
        device: Name of the device.
        mixed: Whether other materials move in the liquid.
        pushed: Whether forces act on particles.
    """
    if pushed:
        yield energies.make_push_work(real)
        if boundaries:
            yield impulses.make_gains(real)
    yield from wall_kernels(boundaries, solids, real)
    if mixed:
        yield from _of_bodies(real)
    if mixed and solids:
        yield make_push(real)
    if solids or mixed:
        yield from solid_kernels(real)
    yield from _of_phases(real, form)
    yield from projection.kernels(device)


def _of_bodies(real: Any) -> Iterator[Any]:
    yield from (make(real) for make in (bodies.make_moments, bodies.make_yield, bodies.make_answer))
    yield from (bodies.make_body_change(real), bodies.make_body_gather(real))
    yield from (make(real) for make in (bodies.make_body_push, shapes.make_body_scatter))
    yield from (make(real) for make in (shapes.make_body_level, shapes.make_body_volume))
    yield from (make(real) for make in (shapes.make_body_distance, shapes.make_body_openings))
    yield from (shapes.make_body_push_out(real), films.make_contact(real), films.make_layers(real))
    yield from (films.make_head(real), films.make_film(real))


def _of_phases(real: Any, form: str) -> Iterator[Any]:
    yield from (make(real, form) for make in (transfer.make_scatter, transfer.make_scatter_volume))
    yield from (make(real, form) for make in (transfer.make_gather, transfer.make_displace))
    yield from (faces.make_sum_copies(real, width) for width in (2, 8))
    yield from (make(real) for make in (faces.make_extent, active.make_sweep))
    yield from (active.make_count_active(real), active.make_list_active(real))
    yield from (active.widen, active.make_forget(real), mixture.make_mix(real))
    yield mixture.make_meeting(real)
    yield from (make(real) for make in (surface.make_levels, surface.make_refill))
    yield from (make(real) for make in (pressure.make_assemble, pressure.make_divergence))
    yield from (make(real) for make in (pressure.make_gradient, impulses.make_wall_impulses))
    yield from (spread.make_spread(real, form), spread.make_slide(real))
    yield from (packing.make_excess(real), impulses.settle)
    yield from viscosity_kernels(real)
