"""Computes the shapes of a liquid's Gaussians: discs on its surface, balls of spray and foam.

`phy124.rendering.liquid` describes the method. Positions and lengths are in cells of the grid of
`phy124.kernels.splat.fields`, unless stated otherwise. phi is the filled fraction.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.fields import Grid, distribute, interpolate, nearest
from phy124.kernels.splat.screen import MIN_ALPHA

HIDDEN = wp.constant(0)
DISC = wp.constant(1)
"""Kind of a Gaussian that is drawn as a disc on the surface."""
BALL = wp.constant(2)
"""Kind of a Gaussian in dense spray."""
DROP = wp.constant(3)
FLECK = wp.constant(4)
"""Kind of a Gaussian that is drawn as a fleck of foam."""
BLUR = wp.constant(0.85)
"""Standard deviation of the filter that smooths fields."""
FINE = wp.constant(0.6)
"""Standard deviation of the filter that smooths sums over discs. With a wider filter, opacities
would not compensate for gaps and clusters of particles, and liquids would look blotchy.
"""
COUNTED = wp.constant(0.8)
"""Fraction of a layer of discs that is counted by two samples, one cell apart along the normal."""
LEVEL = wp.constant(0.45)
"""Filled fraction at the liquid's surface."""
AHEAD = wp.constant(1.2)
"""Distance outwards from a disc at which phi shows whether the disc is inside the liquid."""
FILLED = wp.constant(wp.vec2(0.22, 0.42))
"""If phi at the distance `AHEAD` is above the first value, a disc begins to fade; from the second
value on, it is invisible.
"""
STEEP = wp.constant(wp.vec2(0.2, 0.35))
"""Up to the first of these gradients of phi, divided by phi [1/cell], discs are invisible; from the
second on, discs do not fade.
"""
MOVES = wp.constant(wp.vec2(-0.35, 0.9))
"""Largest displacements onto the surface: inwards and outwards."""
OVERLAP = wp.constant(0.95)
"""Radius of a disc, relative to the distance between neighbouring discs."""
NARROW = wp.constant(0.4)
"""Lower bound of the radius of a disc."""
BROAD = wp.constant(0.55)
"""Lower bound of the radius of a disc in a film on a wall."""
WIDEST = wp.constant(0.7)
"""Upper bound of the radius of a disc."""
STRETCHED = wp.constant(1.1)
"""Upper bound of the radius of a disc in an evenly stretched film on a wall."""
FLAT = wp.constant(0.3)
"""Thickness of a disc, relative to its radius."""
EVEN = wp.constant(0.3)
"""Largest distance of a Gaussian from the midpoint between its two neighbours in an evenly
stretched liquid, relative to the distance between rows of Gaussians.
"""
CLOSED = wp.constant(0.5)
"""Smallest radius of discs, relative to the distance between rows of Gaussians."""
TOUCH = wp.constant(0.75)
"""Largest distance from a wall at which Gaussians are drawn on the wall."""
FILM = wp.constant(wp.vec2(1.5, 2.5))
"""A film's face on the wall begins to appear at the first of these thicknesses, and is complete at
the second.
"""
EDGE = wp.constant(0.5)
"""Smallest depth below the free surface at which Gaussians are drawn on a wall."""
WETTED = wp.constant(0.6)
"""Smallest phi at which a liquid touches a wall."""
WET = wp.constant(0.03)
"""Adjacent cells along an axis form an interval of liquid if their phi exceeds this value."""
LEAST_LENGTH = wp.constant(0.1)
"""Lower bound of the length of an interval of liquid along an axis [cells]."""
LONG = wp.constant(3.0)
"""Upper bound of the liquid's thickness at a disc, relative to the shortest of the three intervals
of liquid through the disc's cell.
"""
RIM = wp.constant(0.3)
"""Length of the normals of discs at the rim of the liquid on a wall. Short normals reduce the gloss
of the rim, where normals differ from disc to disc.
"""
ALONE = wp.constant(0.4)
"""Largest phi at the centre of a drop, relative to the volume of the drop."""
SIZE = wp.constant(0.42)
"""Standard deviation of a drop's Gaussian, relative to the edge of a cube of equal volume."""
TORN = wp.constant(0.62)
"""A liquid is a jet only where its spread is below this value. The spread is the factor by which
smoothing lowers phi.
"""
THINNER = wp.constant(0.85)
"""A liquid is a jet only where the ratio of spread to spread at rest is below this value."""
KEPT = wp.constant(0.6)
"""Fraction of the Gaussians of a jet that are not drawn."""
GOLDEN = wp.constant(wp.float64(0.618034))
"""Golden ratio minus 1; its multiples are evenly distributed modulo 1."""
OPAQUE = wp.constant(6.0)
"""Largest optical depth of a Gaussian on the surface."""
LEAST = wp.constant(0.35)
"""Smallest opacity of a Gaussian on the surface."""
LEAST_DEPTH = wp.constant(0.4307829)
"""Optical depth of the opacity `LEAST`: -log(1 - LEAST)."""
PALE = wp.constant(wp.vec3(0.9, 0.97, 1.0))
"""Colour of thin layers and of spray."""
THIN = wp.constant(0.2)
"""Largest fraction of `PALE` in the colour of a thin layer."""
SPRAY = wp.constant(0.6)
"""Fraction of `PALE` in the colour of a drop."""
FAST = wp.constant(wp.vec2(0.6, 1.5))
"""Foam begins to appear at the first of these speeds [m/s], and is complete at the second. Water
entrains air above a speed of about this order of magnitude (Chanson 1996).
"""
THINNED = wp.constant(wp.vec2(0.72, 0.92))
"""Foam begins to disappear at the first of these ratios of the spread to the spread at rest, and is
gone at the second.
"""
ALOFT = wp.constant(wp.vec2(0.75, 1.5))
"""Foam begins to appear at the first of these distances from a wall, and is complete at the second.
"""
FOAM = wp.constant(wp.vec3(0.96, 0.98, 1.0))
WHITE = wp.constant(0.9)
"""In a Gaussian that consists of foam only, this fraction of the colour is the foam's colour."""
MILKY = wp.constant(0.5)
"""Smallest opacity of a disc that consists of foam only."""
THICK = wp.constant(0.65)
"""Thickness of a disc that consists of foam only, relative to the disc's radius. Such a disc is
drawn without gloss.
"""
FLECKED = wp.constant(wp.vec2(0.25, 0.9))
"""Flecks begin to appear at the first of these fractions of foam, and have their full number at the
second.
"""
FLECKS = wp.constant(0.7)
"""Largest fraction of the Gaussians in foam that are drawn as flecks."""
LITTLE = wp.constant(wp.vec2(0.07, 0.21))
"""Standard deviations of the smallest and of the largest fleck of foam."""
FAR = wp.constant(1.0e9)
"""Distance from the nearest wall if there are no walls."""


@wp.struct
class Shape:
    """Kind and shape of a Gaussian, with the surface next to it (from `find_surface`)."""

    kind: int
    normal: wp.vec3
    """Outward unit normal of the liquid's surface."""
    gloss: wp.vec3
    """Normal for reflections; a Gaussian with a normal shorter than 1 reflects less light."""
    move: float
    """Distance from the Gaussian to the surface, along the normal."""
    fade: float
    """Factor on the opacity of a disc."""
    lower: float
    """How far the liquid's face on the wall has appeared, 0..1 (`FILM`)."""
    here: float
    """phi at the Gaussian."""
    foam: float
    """Fraction of foam in the liquid around the Gaussian."""


@wp.func
def smoothstep(x: float, ends: wp.vec2) -> float:
    """Return a smooth cubic step: 0 up to the first of two values, and 1 from the second on."""
    t = wp.clamp((x - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@kernel("phy124_discs", seconds=1.5)
def measure_lengths(
    cells: Grid, axis: int, field: wp.array(dtype=float), lengths_out: wp.array(dtype=wp.vec3)
):
    """Compute the length of liquid along an axis through each cell, one thread per column."""
    column = wp.tid()
    second = (axis + 1) % 3
    third = (axis + 2) % 3
    stride = wp.vec3i(cells.size[1] * cells.size[2], cells.size[2], 1)
    first = (
        column // cells.size[third] * stride[second] + column % cells.size[third] * stride[third]
    )
    start = int(0)
    length = float(0.0)
    for k in range(cells.size[axis] + 1):
        phi = float(0.0)
        if k < cells.size[axis]:
            phi = wp.min(field[first + k * stride[axis]], 1.0)
        if phi > WET:
            length += phi
        else:
            for wet in range(start, k):
                lengths_out[first + wet * stride[axis]][axis] = wp.max(length, LEAST_LENGTH)
            if k < cells.size[axis]:
                lengths_out[first + k * stride[axis]][axis] = LEAST_LENGTH
            start = k + 1
            length = 0.0


@wp.func
def thickness(lengths: wp.vec3, normal: wp.vec3) -> float:
    """Return the thickness of the liquid at a disc, along the normal of the disc.

    The result is limited, so that the edge of a film is as pale as the rest of the film.
    """
    total = float(0.0)
    for axis in range(3):
        total += normal[axis] * normal[axis] / lengths[axis]
    return wp.min(1.0 / wp.max(total, 1.0e-6), LONG * wp.min(lengths))


@kernel("phy124_discs", seconds=1.5)
def find_surface(
    cells: Grid,
    planes: wp.array(dtype=wp.vec4),  # unit normal of each wall, and offset along it [m]
    per_cell: float,  # optical depth of a cell of liquid
    means: wp.array(dtype=wp.vec3),  # m
    volumes: wp.array(dtype=float),  # m^3
    largest: float,  # largest volume [m^3]
    rest: wp.array(dtype=float),  # spread at rest
    speeds: wp.array(dtype=float),  # m/s
    phi: wp.array(dtype=float),  # filled fraction of the space in front of walls
    filled: wp.array(dtype=float),  # filled fraction of cells
    slopes: wp.array(dtype=wp.vec3),  # gradient of phi
    calm: wp.array(dtype=wp.vec3),  # gradient of phi that determines the gloss
    spreads: wp.array(dtype=float),  # factor by which smoothing lowers phi
    lengths: wp.array(dtype=wp.vec3),
    shapes_out: wp.array(dtype=Shape),
    # sums over the discs in each cell: volume relative to `largest`, and optical depth
    counts_out: wp.array(dtype=float),
    depths_out: wp.array(dtype=float),
):
    """Decide how each Gaussian is drawn, and find the surface next to it."""
    n = wp.tid()
    at = (means[n] - cells.corner) / cells.cell
    share = volumes[n] / (cells.cell * cells.cell * cells.cell)
    place = nearest(cells, at)
    gap = float(FAR)
    facing = wp.vec3()
    for wall in range(planes.shape[0]):
        plane = planes[wall]
        normal = wp.vec3(plane[0], plane[1], plane[2])
        away = (wp.dot(means[n], normal) - plane[3]) / cells.cell
        if away < gap:
            gap = away
            facing = normal
    close = gap < TOUCH
    here = interpolate(cells, phi, at)
    outwards = wp.vec3()
    steep = float(0.0)
    ahead = here
    if here < 0.98 or close:
        slope = interpolate(cells, slopes, at)
        steep = wp.length(slope)
        outwards = slope / -wp.max(steep, 1.0e-9)
        ahead = interpolate(cells, filled, at + AHEAD * outwards)
    depth = AHEAD * (here - LEVEL) / wp.max(here - ahead, 1.0e-6)
    upright = wp.dot(outwards, facing)
    # Sheets in the air have two faces.
    lower = float(1.0)
    if upright > 0.5:
        lower = smoothstep(gap + depth, FILM)
    thin = close and lower == 0.0
    rim = gap + depth < FILM[0] and upright < 0.9
    wet = False
    if close and not thin and depth > wp.max(gap, EDGE):
        wet = interpolate(cells, phi, at - gap * facing) > WETTED
    move = wp.max(wp.clamp(depth, MOVES[0], MOVES[1]), -gap)
    if wet:
        outwards = -facing
        steep = here
        ahead = 0.0
        move = gap
    spread = spreads[place]
    torn = spread < TORN and spread < THINNER * rest[n] and gap > TOUCH
    foam = 1.0 - smoothstep(spread / rest[n], THINNED)
    foam *= smoothstep(speeds[n], FAST) * smoothstep(gap, ALOFT)
    alone = here < ALONE * share or (torn and chance(n) > KEPT)
    fade = float(0.0)
    if not (alone or torn):
        fade = 1.0 - smoothstep(ahead, FILLED)
        fade *= smoothstep(steep / wp.max(here, 1.0e-6), STEEP)
        if wet:
            fade *= lower
    shape = Shape()
    shape.here = here
    shape.lower = lower
    shape.fade = fade
    shape.move = move
    shape.normal = outwards
    shape.foam = foam
    shape.gloss = outwards
    if fade > 0.0 and not wet:
        slope = interpolate(cells, calm, at)
        shape.gloss = slope / -wp.max(wp.length(slope), 1.0e-9)
    shape.gloss *= 1.0 - foam
    if rim and not wet:
        shape.gloss *= RIM
    if alone:
        shape.kind = DROP
    elif not torn and not thin and fade < 0.5 and here < LEVEL:
        shape.kind = BALL
    elif fade > 0.0 and chance(n) < FLECKS * smoothstep(foam, FLECKED):
        shape.kind = FLECK
    elif fade > 0.0:
        shape.kind = DISC
        # A cell behind a wall is empty, although Gaussians may have sunk into it.
        before = nearest(cells, at + wp.max(0.5 - gap, 0.0) * facing)
        depth = thickness(lengths[before], outwards) * per_cell / (1.0 + lower)
        weight = fade * volumes[n] / largest
        distribute(cells, at + move * outwards, weight, counts_out)
        distribute(cells, at + move * outwards, weight * wp.min(depth, OPAQUE), depths_out)
    shapes_out[n] = shape


@wp.func
def chance(n: int) -> float:
    """Return a pseudo-random number between 0 and 1 that depends on the index of a Gaussian."""
    multiple = GOLDEN * wp.float64(n)
    return float(multiple - wp.floor(multiple))


@wp.func
def row_distance(means: wp.array(dtype=wp.vec3), rows: wp.array3d(dtype=int), n: int) -> float:
    """Return the largest distance [m] between a Gaussian and its neighbours in the rows at rest.

    Two neighbours count only if the Gaussian is still near their midpoint: only then has the liquid
    been stretched evenly.
    """
    apart = float(0.0)
    for axis in range(3):
        before = means[rows[axis, 0, n]]
        after = means[rows[axis, 1, n]]
        along = 0.5 * wp.length(after - before)
        if wp.length(0.5 * (after + before) - means[n]) < EVEN * along:
            apart = wp.max(apart, along)
    return apart


@wp.func
def turn_to(normal: wp.vec3) -> wp.vec4:
    """Return the shortest rotation wxyz from the z axis to a normal; for -z, rotate about x."""
    x = float(1.0)
    if normal[2] > -0.9999:
        x = -normal[1]
    return wp.normalize(wp.vec4(1.0 + normal[2], x, normal[0], 0.0))


@kernel("phy124_discs", seconds=1.5)
def shape_gaussians(
    cells: Grid,
    per_cell: float,  # optical depth of a cell of liquid
    means: wp.array(dtype=wp.vec3),  # m
    volumes: wp.array(dtype=float),  # m^3
    largest: float,  # largest volume [m^3]
    rows: wp.array3d(dtype=int),  # neighbours at rest
    rgb: wp.array(dtype=wp.vec3),
    shapes: wp.array(dtype=Shape),
    counts: wp.array(dtype=float),  # smoothed volume of discs, relative to `largest`
    depths: wp.array(dtype=float),  # smoothed optical depth of discs
    means_out: wp.array(dtype=wp.vec3),
    quats_out: wp.array(dtype=wp.vec4),
    scales_out: wp.array(dtype=wp.vec3),
    opacities_out: wp.array(dtype=float),
    rgb_out: wp.array(dtype=wp.vec3),
    normals_out: wp.array(dtype=wp.vec3),
):
    """Compute the Gaussians that are drawn; their shapes were chosen by `find_surface`."""
    n = wp.tid()
    shape = shapes[n]
    mean = means[n]
    normal = wp.vec3()
    quat = wp.vec4(1.0, 0.0, 0.0, 0.0)
    scale = 0.1 * wp.vec3(1.0, 1.0, 1.0)
    opacity = float(0.0)
    pale = float(0.0)
    if shape.kind == DISC:
        below = (mean - cells.corner) / cells.cell + (shape.move - 0.5) * shape.normal
        above = below + shape.normal
        around = interpolate(cells, counts, below) + interpolate(cells, counts, above)
        layer = around / COUNTED  # discs per cell of the surface
        narrow = CLOSED * row_distance(means, rows, n) / cells.cell
        widest = STRETCHED + shape.lower * (WIDEST - STRETCHED)
        narrow = wp.clamp(narrow, BROAD + shape.lower * (NARROW - BROAD), widest)
        radius = wp.clamp(OVERLAP / wp.sqrt(wp.max(layer, 1.0e-6)), narrow, wp.max(narrow, WIDEST))
        # Without averaging over neighbouring discs, stretched rows of particles would appear as
        # stripes.
        depth = interpolate(cells, depths, below) + interpolate(cells, depths, above)
        depth /= wp.max(around, 1.0e-6)
        overlapping = wp.max(2.0 * wp.pi * radius * radius * layer, 0.5) * largest / volumes[n]
        opacity = 1.0 - wp.exp(-wp.max(depth, LEAST_DEPTH) / overlapping)
        # Drawing omits alphas below MIN_ALPHA, as if opacities were lower by MIN_ALPHA.
        opacity = wp.min(shape.fade * wp.max(opacity, MILKY * shape.foam) + MIN_ALPHA, 1.0)
        pale = THIN * wp.exp(-2.0 * depth)
        scale = radius * wp.vec3(1.0, 1.0, FLAT + shape.foam * (THICK - FLAT))
        quat = turn_to(shape.normal)
        normal = shape.gloss
        mean += shape.move * cells.cell * shape.normal
    elif shape.kind == FLECK:
        opacity = 0.9
        size = LITTLE[0] + chance(n) / FLECKS * (LITTLE[1] - LITTLE[0])
        scale = size * wp.vec3(1.0, 1.0, 1.0)
        mean += shape.move * cells.cell * shape.normal
    elif shape.kind != HIDDEN:
        share = volumes[n] / (cells.cell * cells.cell * cells.cell)
        uneven = 0.6 + 0.8 * wp.pow(chance(n), 3.0)
        size = SIZE * wp.cbrt(share) * uneven
        opacity = 0.9
        pale = SPRAY
        if shape.kind == BALL:
            # Overlapping balls absorb as much light as their volume of liquid.
            size = wp.min(0.6 * wp.cbrt(share / wp.max(shape.here, 1.0e-3)), WIDEST)
            column = wp.min(share / (2.0 * wp.pi * size * size) * per_cell, OPAQUE)
            opacity = wp.max(1.0 - wp.exp(-column), 0.5 * LEAST)
            pale = 0.5 * SPRAY
        scale = size * wp.vec3(1.0, 1.0, 1.0)
    means_out[n] = mean
    quats_out[n] = quat
    scales_out[n] = cells.cell * scale
    opacities_out[n] = opacity
    colour = rgb[n] + pale * (PALE - rgb[n])
    rgb_out[n] = colour + WHITE * shape.foam * (FOAM - colour)
    normals_out[n] = normal
