"""Evaluates implicit surfaces F = 0, projects points onto a surface, and spreads the points evenly.

Lengths are in pixels of the picture. All values are in float64.
"""

from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.build import kernel

Fields = wp.array3d[wp.float64]
REACH = wp.constant(wp.float64(1.25))
"""Distance up to which neighbours repel each other, relative to the target spacing."""
STRENGTH = wp.constant(wp.float64(0.45))
"""In a round, points that are too close move apart by this fraction of the missing distance."""
SAME_SIDE = wp.constant(wp.float64(0.3))
"""Points with a smaller cosine between their normals are on opposite sides of a thin part."""
COUNTED = wp.constant(6)
"""Number of nearest neighbours whose mean distance is the spacing of a point."""
LEAST, MOST = wp.constant(wp.float64(0.6)), wp.constant(wp.float64(1.6))
"""Smallest and largest spacing of points, relative to the target spacing."""


@wp.struct
class Inflated:
    """A surface F(x, y, z) = 0 with F = w(x, y) - (z - m(x, y))^2."""

    fields: Fields
    """w, m, and the slopes of w and m along x and y [H,W,6]."""


@wp.struct
class Hull:
    """A surface F = 0 with F = w(x, y) + s(z, y), but F < 0 beyond two end planes normal to y."""

    front: Fields
    """w and its slopes along x and y [H,W,3]; x = 0 is at the middle column of the front view."""
    side: Fields
    """s and its slopes along z and y [H,D,3]; z = 0 is at the middle column of the side view."""
    first: wp.float64
    """The y coordinate of the first row of `front` and `side`."""
    pitch: wp.float64
    """Distance between rows of `front` and `side` [px]."""
    planes: wp.array[wp.vec3d]
    """Sign, y position and steepness of each end plane."""


@wp.struct
class Corner:
    """Position between four pixels: the upper left pixel, and the offset from this pixel."""

    row: int
    column: int
    down: wp.float64
    right: wp.float64


@wp.func
def corner(fields: Fields, x: wp.float64, y: wp.float64) -> Corner:
    """Return the pixel at the upper left of a point, and the point's offset from this pixel."""
    last_row, last_column = fields.shape[0] - 1, fields.shape[1] - 1
    x = wp.clamp(x, wp.float64(0.0), wp.float64(last_column))
    y = wp.clamp(y, wp.float64(0.0), wp.float64(last_row))
    at = Corner()
    # The last pixel has no next pixel for the interpolation.
    at.row = wp.clamp(int(y), 0, last_row - 1)
    at.column = wp.clamp(int(x), 0, last_column - 1)
    at.down = y - wp.float64(at.row)
    at.right = x - wp.float64(at.column)
    return at


@wp.func
def sample(fields: Fields, at: Corner, channel: int) -> wp.float64:
    """Return one channel of a field, interpolated bilinearly."""
    above = wp.lerp(
        fields[at.row, at.column, channel], fields[at.row, at.column + 1, channel], at.right
    )
    below = wp.lerp(
        fields[at.row + 1, at.column, channel], fields[at.row + 1, at.column + 1, channel], at.right
    )
    return wp.lerp(above, below, at.down)


@wp.func
def evaluate_inflated(surface: Inflated, p: wp.vec3d) -> wp.vec4d:
    """Return F and its gradient at a point."""
    at = corner(surface.fields, p[0], p[1])
    z = p[2] - sample(surface.fields, at, 1)
    return wp.vec4d(
        sample(surface.fields, at, 0) - z * z,
        sample(surface.fields, at, 2) + wp.float64(2.0) * z * sample(surface.fields, at, 4),
        sample(surface.fields, at, 3) + wp.float64(2.0) * z * sample(surface.fields, at, 5),
        wp.float64(-2.0) * z,
    )


@wp.func
def evaluate_hull(surface: Hull, p: wp.vec3d) -> wp.vec4d:
    """Return F and its gradient at a point."""
    zero = wp.float64(0.0)
    row = (p[1] - surface.first) / surface.pitch
    front = corner(surface.front, p[0] + wp.float64(surface.front.shape[1] // 2), row)
    side = corner(surface.side, p[2] + wp.float64(surface.side.shape[1] // 2), row)
    result = wp.vec4d(
        sample(surface.front, front, 0) + sample(surface.side, side, 0),
        sample(surface.front, front, 1),
        sample(surface.front, front, 2) + sample(surface.side, side, 2),
        sample(surface.side, side, 1),
    )
    for index in range(surface.planes.shape[0]):
        plane = surface.planes[index]
        value = plane[2] * plane[0] * (plane[1] - p[1])
        if value < result[0]:
            result = wp.vec4d(value, zero, -plane[0] * plane[2], zero)
    return result


class Kernels(NamedTuple):
    """The kernels for a kind of implicit surface."""

    evaluate: Any
    """`(surface, points)`: F and its gradient at the points."""
    orient: Any
    """`(surface, points)`: outward unit normals at the points."""
    project: Any
    """`(surface, rounds, points)`: moves points onto the surface, in Newton steps up to 1 px."""


def _kernels(name: str, Surface: Any, gradient: Any) -> Kernels:
    module = f"phy124_implicit_{name}"

    @kernel(module, seconds=0.5)
    def evaluate(
        surface: Surface,
        points: wp.array[wp.vec3d],
        values_out: wp.array[wp.float64],
        gradients_out: wp.array[wp.vec3d],
    ):
        i = wp.tid()
        surface_at = gradient(surface, points[i])
        values_out[i] = surface_at[0]
        gradients_out[i] = wp.vec3d(surface_at[1], surface_at[2], surface_at[3])

    @kernel(module, seconds=0.5)
    def orient(surface: Surface, points: wp.array[wp.vec3d], normals_out: wp.array[wp.vec3d]):
        i = wp.tid()
        surface_at = gradient(surface, points[i])
        slope = wp.vec3d(surface_at[1], surface_at[2], surface_at[3])
        normals_out[i] = -slope / wp.max(wp.length(slope), wp.float64(1e-12))

    @kernel(module, seconds=0.5)
    def project(surface: Surface, rounds: int, points_out: wp.array[wp.vec3d]):
        i = wp.tid()
        p = points_out[i]
        for _ in range(rounds):
            surface_at = gradient(surface, p)
            slope = wp.vec3d(surface_at[1], surface_at[2], surface_at[3])
            step = -(surface_at[0] / wp.max(wp.dot(slope, slope), wp.float64(1e-9))) * slope
            p += step / wp.max(wp.float64(1.0), wp.length(step))
        points_out[i] = p

    return Kernels(evaluate, orient, project)


INFLATED = _kernels("inflated", Inflated, evaluate_inflated)
HULL = _kernels("hull", Hull, evaluate_hull)


@kernel("phy124_implicit_push", seconds=0.4)
def push(
    points: wp.array[wp.vec3d],
    normals: wp.array[wp.vec3d],
    wanted: wp.array[wp.float64],
    near: wp.array2d[wp.int32],
    moved_out: wp.array[wp.vec3d],
    spacings_out: wp.array[wp.float64],
):
    """Move points along the surface and away from neighbours that are too close.

    Args:
        points: Positions [N].
        normals: Unit normals at the points [N].
        wanted: The target distance of neighbours [N].
        near: Neighbours of each point [N,K], nearest first.
        moved_out: Receives the new positions [N].
        spacings_out: Receives the mean distance of each point's neighbours [N].
    """
    i = wp.tid()
    p, n, far = points[i], normals[i], wanted[i]
    move = wp.vec3d()
    total, count = wp.float64(0.0), int(0)
    for k in range(near.shape[1]):
        other = near[i, k]
        if wp.dot(n, normals[other]) > SAME_SIDE:
            apart = p - points[other]
            distance = wp.length(apart)
            missing = wp.max(wp.float64(0.0), wp.float64(1.0) - distance / (REACH * far)) * far
            move += (STRENGTH * missing / wp.max(distance, wp.float64(1e-9))) * apart
            if k < COUNTED:
                total += distance
                count += 1
    spacing = far
    if total > wp.float64(0.0):
        spacing = total / wp.float64(count)
    moved_out[i] = p + move - wp.dot(move, n) * n
    spacings_out[i] = wp.clamp(spacing, LEAST * far, MOST * far)
