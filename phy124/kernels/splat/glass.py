"""Draws boundaries as glass: intersects rays with solids, and computes the faces' opacities.

The shaders of the player (phy124/io/viewer/stage.js) contain the same functions.
"""

import warp as wp

from phy124.kernels.native import code, constants

FACE = wp.constant(0.10)
"""Opacity of a flat face."""
LINE = wp.constant(0.45)
"""Opacity of an edge."""
RIM = wp.constant(0.50)
"""Opacity of a round face seen at a grazing angle."""
WIDTH = wp.constant(1.5)
"""Width of an edge, and of the soft outline of a face [px]."""
NEARLY = wp.constant(0.9999)
"""If the distance of a face is more than this fraction of the distance of the surface behind the
face, face and surface almost coincide, and the ray ignores the face.
"""
TINT = wp.constant(wp.vec3(0.36, 0.44, 0.52))


@wp.struct
class Solid:
    """A box with its own axes, or a capsule along its first axis; a ball is a short capsule."""

    centre: wp.vec3  # [m]
    axes: wp.mat33  # a unit vector in each row
    half: wp.vec3  # half sizes [m]; for a capsule, (half the length of its axis, 0, 0)
    radius: float  # radius of a capsule [m]; 0 for a box


@wp.struct
class Outline:
    """A convex polygon on the screen that contains a solid."""

    sides: wp.types.matrix(shape=(6, 3), dtype=float)  # inside: a x + b y + c >= 0 [px]
    planes: wp.types.matrix(shape=(6, 3), dtype=float)  # normals n; inside: n . ray >= 0
    count: int  # number of sides; 0 if the solid may be anywhere on the screen
    nearest: float  # smallest depth of the corners of the solid's box [m]


@wp.struct
class Hit:
    """The segment of a ray inside a solid, and the opacities of the faces at the segment's ends."""

    enters: float
    leaves: float  # smaller than `enters` if the ray misses
    first: float  # opacity of the face at which it enters
    second: float  # opacity of the face at which it leaves


@wp.func
def edge(solid: Solid, at: wp.vec3, pixel: float) -> float:
    """Return the opacity of a box's face at a point in the box's axes; edges are more opaque."""
    a = wp.abs(solid.half[0] - wp.abs(at[0]))
    b = wp.abs(solid.half[1] - wp.abs(at[1]))
    c = wp.abs(solid.half[2] - wp.abs(at[2]))
    second = wp.max(wp.min(a, b), wp.min(wp.max(a, b), c))
    return FACE + (LINE - FACE) * wp.clamp(1.0 - second / (WIDTH * pixel), 0.0, 1.0)


@wp.func
def box_hit(solid: Solid, origin: wp.vec3, ray: wp.vec3, pixel: float) -> Hit:
    """Intersect a ray and a box; `pixel` is the size of a pixel at distance 1 along the ray [m]."""
    o = solid.axes * (origin - solid.centre)
    d = solid.axes * ray
    hit = Hit()
    hit.enters = float(-1.0e30)
    hit.leaves = float(1.0e30)
    for k in range(3):
        step = d[k]
        if wp.abs(step) < 1.0e-9:
            step = 1.0e-9
        a = (-solid.half[k] - o[k]) / step
        b = (solid.half[k] - o[k]) / step
        hit.enters = wp.max(hit.enters, wp.min(a, b))
        hit.leaves = wp.min(hit.leaves, wp.max(a, b))
    if hit.leaves > wp.max(hit.enters, 0.0):
        hit.first = edge(solid, o + hit.enters * d, hit.enters * pixel)
        hit.second = edge(solid, o + hit.leaves * d, hit.leaves * pixel)
    return hit


@wp.func
def rim(towards: wp.vec3, ray: wp.vec3) -> float:
    """Return the opacity of a round face; `towards` is the normal of the face, of any length."""
    facing = wp.abs(wp.dot(towards, ray)) / (wp.length(towards) * wp.length(ray))
    grazing = 1.0 - facing
    return 0.6 * FACE + (RIM - 0.6 * FACE) * grazing * grazing * grazing


@wp.func
def from_axis(solid: Solid, point: wp.vec3) -> wp.vec3:
    """Return the vector from the nearest point of a capsule's axis to a point."""
    axis = solid.axes[0]
    away = point - solid.centre
    return away - wp.clamp(wp.dot(away, axis), -solid.half[0], solid.half[0]) * axis


@wp.func
def ball_hit(centre: wp.vec3, radius: float, origin: wp.vec3, ray: wp.vec3) -> wp.vec2:
    """Return the distances at which a ray enters and leaves a ball; (1, -1) if the ray misses."""
    o = origin - centre
    a = wp.dot(ray, ray)
    b = wp.dot(o, ray)
    # Computing the discriminant from the distance at the closest approach avoids cancellation far
    # away.
    closest = o - (b / a) * ray
    rest = radius * radius - wp.dot(closest, closest)
    if rest <= 0.0:
        return wp.vec2(1.0, -1.0)
    reach = wp.sqrt(rest / a)
    return wp.vec2(-b / a - reach, -b / a + reach)


@wp.func
def capsule_hit(solid: Solid, origin: wp.vec3, ray: wp.vec3) -> Hit:
    """Intersect a ray and a capsule, the union of two balls and the tube between them."""
    hit = Hit()
    axis = solid.axes[0]
    ends = ball_hit(solid.centre - solid.half[0] * axis, solid.radius, origin, ray)
    other = ball_hit(solid.centre + solid.half[0] * axis, solid.radius, origin, ray)
    if ends[1] < ends[0]:
        ends = other
    elif other[1] >= other[0]:
        ends = wp.vec2(wp.min(ends[0], other[0]), wp.max(ends[1], other[1]))
    # The tube is the intersection of a disc, perpendicular to the axis, and a slab along the axis.
    o = origin - solid.centre
    along = wp.dot(ray, axis)
    across = ray - along * axis
    if solid.half[0] > 0.0 and wp.dot(across, across) > 1.0e-12:
        start = wp.dot(o, axis)
        tube = ball_hit(wp.vec3(), solid.radius, o - start * axis, across)
        if wp.abs(along) < 1.0e-9:
            along = 1.0e-9
        a = (-solid.half[0] - start) / along
        b = (solid.half[0] - start) / along
        low = wp.max(tube[0], wp.min(a, b))
        high = wp.min(tube[1], wp.max(a, b))
        if high > low:
            if ends[1] < ends[0]:
                ends = wp.vec2(low, high)
            else:
                ends = wp.vec2(wp.min(ends[0], low), wp.max(ends[1], high))
    hit.enters = ends[0]
    hit.leaves = ends[1]
    if hit.leaves > wp.max(hit.enters, 0.0):
        hit.first = rim(from_axis(solid, origin + hit.enters * ray), ray)
        hit.second = rim(from_axis(solid, origin + hit.leaves * ray), ray)
    return hit


@wp.func
def veil(solid: Solid, origin: wp.vec3, ray: wp.vec3, limit: float, pixel: float) -> float:
    """Return a solid's opacity along a ray up to `limit`, where the ray meets a surface."""
    hit = Hit()
    if solid.radius > 0.0:
        hit = capsule_hit(solid, origin, ray)
    else:
        hit = box_hit(solid, origin, ray, pixel)
    if hit.leaves <= wp.max(hit.enters, 0.0) or hit.enters >= limit:
        return 0.0
    clear = float(1.0)
    if hit.enters > 0.0:
        clear *= 1.0 - hit.first
    if hit.leaves < NEARLY * limit:
        clear *= 1.0 - hit.second
    # The solid becomes transparent towards its outline, where rays only graze it.
    chord = (hit.leaves - wp.max(hit.enters, 0.0)) * wp.length(ray)
    return (1.0 - clear) * wp.clamp(chord / (WIDTH * pixel * hit.leaves), 0.0, 1.0)


@wp.func
def within(outline: Outline, x: float, y: float) -> bool:
    """Return whether a solid may be visible at a position on the screen [px]."""
    for k in range(outline.count):
        if outline.sides[k, 0] * x + outline.sides[k, 1] * y + outline.sides[k, 2] < 0.0:
            return False
    return True


VEIL = constants(
    "float", FACE=FACE, LINE=LINE, RIM=RIM, WIDTH=WIDTH, NEARLY=NEARLY, TINT=TINT
) + code("stage:veil")
"""C++ code of `veil`, for sixteen rays from `view`."""
