"""Computes outlines of glass solids on the screen, and their depth order with the Gaussians."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.reduction import finite
from phy124.kernels.splat.arguments import DRAWN
from phy124.kernels.splat.glass import Outline, Solid
from phy124.kernels.splat.screen import View

BEFORE = wp.constant(0)
"""Glass in front of all Gaussians."""
AMONG = wp.constant(1)
"""Glass that may have Gaussians both in front of it and behind it."""
BEHIND = wp.constant(2)
"""Glass behind all Gaussians."""
THIN = wp.constant(0.2)
"""A box counts as a plate if its thickness is less than this fraction of its width."""
GIVE = wp.constant(0.3)
"""The thickness of a plate is reduced by this fraction, so that an object that barely enters the
plate counts as outside.
"""


@wp.func
def rank(solid: Solid, eye: wp.vec3, low: wp.vec3, high: wp.vec3) -> int:
    """Return the rank of a solid seen from `eye`: before, among or behind the contents of a box.

    The rank is BEFORE or BEHIND if the plane of one of the solid's faces separates the solid from
    the box. If the eye is on the box's side of the plane, the solid is behind the box.
    """
    if not (finite(low[0] + low[1] + low[2]) and finite(high[0] + high[1] + high[2])):
        return AMONG
    sizes = solid.half + wp.vec3(solid.radius, solid.radius, solid.radius)
    to_box = solid.axes * (0.5 * (low + high) - solid.centre)
    to_eye = solid.axes * (eye - solid.centre)
    order = int(AMONG)
    for axis in range(3):
        reach = 0.5 * wp.dot(wp.abs(solid.axes[axis]), high - low)
        size = sizes[axis]
        if size < THIN * wp.max(sizes):
            size *= 1.0 - GIVE
        if wp.abs(to_box[axis]) - reach > size:
            if wp.sign(to_box[axis]) * to_eye[axis] > sizes[axis]:
                return BEHIND
            order = BEFORE
    return order


@wp.func
def corner_on_screen(view: View, solid: Solid, corner: int) -> wp.vec3:
    """Return a corner of a solid's box: its position on the screen [px] and its depth [m].

    Each bit of the corner's index tells on which side of the centre the corner lies along one axis.
    """
    away = solid.half + wp.vec3(solid.radius, solid.radius, solid.radius)
    for axis in range(3):
        if (corner >> axis) & 1 == 0:
            away[axis] = -away[axis]
    p = view.rotation * (solid.centre + wp.transpose(solid.axes) * away) + view.translation
    return wp.vec3(
        view.focal * p[0] / p[2] + view.centre[0], view.focal * p[1] / p[2] + view.centre[1], p[2]
    )


@wp.func
def faces_camera(view: View, solid: Solid, axis: int, upper: bool) -> bool:
    """Return whether a face of a solid's box faces the camera."""
    along = wp.dot(solid.axes[axis], view.eye - solid.centre)
    reach = solid.half[axis] + solid.radius
    if upper:
        return along > reach
    return along < -reach


@wp.func
def outline(view: View, solid: Solid) -> Outline:
    """Return the outline of a solid on the screen, half a pixel outside its edges.

    A box that contains the camera, or is partly behind the camera, has no outline.
    """
    seen = Outline()
    seen.nearest = float(1.0e30)
    middle = wp.vec3()
    for corner in range(8):
        at = corner_on_screen(view, solid, corner)
        seen.nearest = wp.min(seen.nearest, at[2])
        middle += 0.125 * at
    if seen.nearest <= 1.0e-3:
        return seen
    for edge in range(12):
        # Four edges along each axis, between faces that are perpendicular to the other two axes.
        axis = edge / 4
        second = (axis + 1) % 3
        third = (axis + 2) % 3
        up = edge & 1
        far = (edge >> 1) & 1
        if faces_camera(view, solid, second, up == 1) != faces_camera(view, solid, third, far == 1):
            corner = (up << second) | (far << third)
            start = corner_on_screen(view, solid, corner)
            along = corner_on_screen(view, solid, corner | (1 << axis)) - start
            inwards = wp.normalize(wp.vec2(-along[1], along[0]))
            reach = wp.dot(inwards, wp.vec2(middle[0] - start[0], middle[1] - start[1]))
            if reach < 0.0:
                inwards = -inwards
            c = 0.5 - wp.dot(inwards, wp.vec2(start[0], start[1]))
            seen.sides[seen.count] = wp.vec3(inwards[0], inwards[1], c)
            # The half plane in space is a x + b y + c at the screen position of a ray, times the
            # ray's depth.
            seen.planes[seen.count] = wp.transpose(view.rotation) * wp.vec3(
                view.focal * inwards[0],
                view.focal * inwards[1],
                inwards[0] * view.centre[0] + inwards[1] * view.centre[1] + c,
            )
            seen.count += 1
    return seen


@kernel("phy124_arrange", types=DRAWN)
def arrange(view, low, high, solids, arranged_out: wp.array(dtype=Solid), outlines_out, counts_out):
    """Sort the solids by rank and compute their outlines, one thread per solid.

    `low` and `high` are the corners of a box around all Gaussians; `counts_out` receives the
    numbers of solids before, among and behind the Gaussians.
    """
    k = wp.tid()
    own_rank = rank(solids[k], view.eye, low, high)
    place = int(0)
    counts = wp.vec3i()
    for other in range(solids.shape[0]):
        other_rank = rank(solids[other], view.eye, low, high)
        counts[other_rank] += 1
        if other_rank < own_rank or (other_rank == own_rank and other < k):
            place += 1
    arranged_out[place] = solids[k]
    outlines_out[place] = outline(view, solids[k])
    if k == 0:
        for at in range(3):
            counts_out[at] = counts[at]
