"""All kernels that a GPU may run, grouped by their purpose."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import warp as wp

from phy124.kernels import (
    ballistic,
    collide,
    contacts,
    deform,
    diagnostics,
    forces,
    grid,
    measure,
    profile,
    timestep,
    transfer,
    work,
)
from phy124.kernels.splat import blend, project, shadow, stage
from phy124.kernels.splat.arrange import arrange
from phy124.kernels.transfer import Law
from phy124.materials import LAWS, Material

MATERIALS: list[Material] = [
    kind(**values)
    for kind in LAWS.by_name.values()
    for values in ({}, {"damping": 1.0})
    if values.keys() <= kind.model_fields.keys()
]
Named = tuple[str, Any]


def laws() -> dict[str, Law]:
    """All laws by name; rigid bodies use the kernels of neo-Hookean solids."""
    return {name_of(section): section.device_law for section in MATERIALS}


def name_of(section: Any) -> str:
    """Name of the kernel in tables."""
    return section.law + (", damped" if getattr(section, "damping", 0) else "")


def main(law: Law, real: Any = wp.float32) -> dict[str, Any]:
    """Yield the kernels that take nearly all of the time of a substep."""
    return {
        "p2g": transfer.make_p2g(law, real, "plain"),
        "g2p": transfer.make_g2p(law, real, "plain"),
    }


def of_law(law: Law, real: Any = wp.float32) -> dict[str, Any]:
    """Yield all kernels that are built for a law."""
    return {
        **main(law, real),
        "measure": measure.make_measure(law, real),
        "totals": diagnostics.make_totals(law, real),
        "energies": diagnostics.make_energies(law, real),
    }


def others(real: Any = wp.float32) -> Iterator[Named]:
    """Yield the kernels for all laws, and those of walls."""
    makers = (
        grid.make_update, grid.make_merge, grid.make_grid_speed, profile.make_sampler,
        measure.make_measure_speeds, timestep.make_timestep,
        diagnostics.make_reset, diagnostics.make_limit_total,
        diagnostics.make_apart, ballistic.make_hide, ballistic.make_fly,
        contacts.make_contact_copy, contacts.make_contact_reach, contacts.make_contacts,
        work.make_push_copy, work.make_push_sums,
        work.make_push_sums_v, work.make_wall_copy,
        work.make_wall_sums, work.make_uniform_sums,
        forces.make_zone, forces.make_drag, forces.make_attract, forces.make_set_velocity,
        deform.make_carry, deform.make_follow, deform.make_count_broken,
        diagnostics.make_neighbours_lost,
    )  # fmt: skip
    for make in makers:
        yield make.__name__.removeprefix("make_"), make(real)
    yield "accelerate", forces.make_accelerate(real, True)
    for shape, response in product(collide.SHAPES, ("separate", "sticky")):
        yield f"contact {shape}, {response}", collide.make_contact(shape, response, real)
    for shape in ("box", "cylinder", "half_space"):
        yield f"contact {shape}, held", collide.make_contact(shape, "held", real)
    yield "collide box, slip", collide.make_collider("box", "slip", real)
    lists = project.sum_columns, project.count_splats, project.start_lists, project.bin_parallel
    for module in (project.project, *lists, blend.blend_pixels, blend.quantise):
        yield module.key, module
    yield stage.draw_setting.key, stage.draw_setting
    yield arrange.key, arrange
    yield shadow.cover.key, shadow.cover
