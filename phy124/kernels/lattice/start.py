"""Decides which points touch a surface at the start of a run.

The surfaces of bodies are known to within one cell only, so surfaces that should touch may start at
some distance. Round bodies touch in a small area only; a larger contact area would make them too
stiff.
"""

from typing import Any

import warp as wp

PARALLEL, NEAR = wp.constant(0.98), wp.constant(0.75)
"""Where two surfaces are parallel, points up to `NEAR` [cells] from the other surface touch it. The
cosine between the surfaces' opposite normals is then at least `PARALLEL`. The surfaces of two boxes
of 48 cells that stand side by side are up to 0.64 cells apart.
"""
FACING, CLOSE = wp.constant(0.9), wp.constant(0.2)
"""Points up to `CLOSE` [cells] from the other surface touch it if the cosine is at least `FACING`.
Otherwise, no points might touch at the tips of round bodies.
"""
INSIDE = wp.constant(1e-3)
"""Depth inside the surface at which such points start [cells]. Points outside a surface that were
never pressed could leave it.
"""


@wp.func
def touches_at_start(gap: Any, cosine: Any):
    """Return whether a point touches a surface at the distance `gap` [cells].

    `cosine` is the cosine of the angle between the surface's normal and the reversed normal at the
    point.
    """
    reach = type(gap)(0.0)
    if cosine >= type(gap)(FACING):
        reach = type(gap)(CLOSE)
    if cosine >= type(gap)(PARALLEL):
        reach = type(gap)(NEAR)
    return gap > type(gap)(0.0) and gap < reach
