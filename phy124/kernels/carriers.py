"""Finds the particles that carry each Gaussian: the nearest neighbours, with smooth weights."""

import warp as wp

from phy124.kernels.build import kernel

CARRIERS = 8
"""Number of particles that carry each Gaussian."""
CHOSEN = wp.constant(CARRIERS)
FAR = wp.constant(wp.float64(1e300))
"""Stands for the squared distance of a neighbour that does not exist."""
SPARE = wp.constant(wp.float64(1e-9))
"""Lower bound of a particle's weight. Without this bound, particles at equal distances from a
Gaussian would all have weight 0.
"""


@wp.func
def outwards(step: int) -> int:
    """Return 0, 1, -1, 2, -2, ... for `step` = 0, 1, 2, 3, 4, ..."""
    half = (step + 1) / 2
    return wp.where(step % 2 == 1, half, -half)


@wp.func
def within(at: wp.float64, low: int, high: int) -> int:
    """Return the cell that contains a coordinate [cells], clamped to the cells `low` to `high`."""
    return int(wp.clamp(wp.floor(at), wp.float64(low), wp.float64(high)))


@wp.func
def gap(at: wp.float64, cell: int) -> wp.float64:
    """Return the distance from a coordinate to the nearest point of a grid cell [cells]."""
    zero = wp.float64(0.0)
    return wp.max(zero, wp.max(wp.float64(cell) - at, at - wp.float64(cell + 1)))


@wp.func
def margin(at: wp.float64, first: int, last: int, count: int) -> wp.float64:
    """Return the distance from a coordinate to the nearest end of a range of cells [cells].

    Ends at the border of the grid are ignored.
    """
    room = wp.float64(1e100)
    if first > 0:
        room = wp.min(room, at - wp.float64(first))
    if last < count - 1:
        room = wp.min(room, wp.float64(last + 1) - at)
    return room


@kernel("phy124_carriers", seconds=0.8)
def find_carriers(
    points: wp.array(dtype=wp.vec3),
    # particles sorted by cell, their indices before sorting, and the first particle of each cell
    particles: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=int),
    starts: wp.array(dtype=int),
    shape: wp.vec3i,
    low: wp.vec3d,
    cell: wp.float64,
    farthest: wp.float64,
    # out: particles from near to far, and their weights
    neighbours_out: wp.array2d(dtype=int),
    weights_out: wp.array2d(dtype=float),
):
    """Find the nearest particles of each point, with weights (1 - (d / R)^2)^2, normalised to sum
    1.

    R is the distance to the nearest particle that was not chosen, within limits (see
    `phy124.motion.binding.find_carriers`). Missing particles have weight 0.
    """
    n = wp.tid()
    point = points[n]
    zero, unit = wp.float64(0.0), wp.float64(1.0)
    x, y, z = wp.float64(point[0]), wp.float64(point[1]), wp.float64(point[2])
    u, v, w = (x - low[0]) / cell, (y - low[1]) / cell, (z - low[2]) / cell
    i = within(u, 0, shape[0] - 1)
    j = within(v, 0, shape[1] - 1)
    k = within(w, 0, shape[2] - 1)
    square = wp.zeros(shape=9, dtype=wp.float64)
    index = wp.zeros(shape=9, dtype=int)
    reach = int(1)
    searching = bool(True)
    while searching:
        for m in range(CHOSEN + 1):
            square[m] = FAR
            index[m] = -1
        i0, i1 = wp.max(i - reach, 0), wp.min(i + reach, shape[0] - 1)
        j0, j1 = wp.max(j - reach, 0), wp.min(j + reach, shape[1] - 1)
        k0, k1 = wp.max(k - reach, 0), wp.min(k + reach, shape[2] - 1)
        # Rows of cells are visited from the middle outwards, so that distant rows can be skipped.
        for p in range(2 * reach + 1):
            a = i + outwards(p)
            du = gap(u, a)
            for q in range(2 * reach + 1):
                b = j + outwards(q)
                dv = gap(v, b)
                left = square[CHOSEN] / (cell * cell) - du * du - dv * dv
                if a >= i0 and a <= i1 and b >= j0 and b <= j1 and left > zero:
                    row = (a * shape[1] + b) * shape[2]
                    along = wp.sqrt(left)
                    first = within(w - along, k0, k1 + 1)
                    last = within(w + along, first - 1, k1)
                    for s in range(starts[row + first], starts[row + last + 1]):
                        there = particles[s]
                        dx = wp.float64(there[0]) - x
                        dy = wp.float64(there[1]) - y
                        dz = wp.float64(there[2]) - z
                        d = dx * dx + dy * dy + dz * dz
                        if d < square[CHOSEN]:
                            m = int(CHOSEN)
                            while m > 0 and square[wp.max(m - 1, 0)] > d:
                                square[m] = square[m - 1]
                                index[m] = index[m - 1]
                                m -= 1
                            square[m] = d
                            index[m] = s
        sure = wp.min(margin(u, i0, i1, shape[0]), margin(v, j0, j1, shape[1]))
        sure = cell * wp.min(sure, margin(w, k0, k1, shape[2]))
        searching = sure < wp.float64(1e90) and (sure < zero or square[CHOSEN] > sure * sure)
        reach = 2 * reach
    outermost = int(0)
    for m in range(CHOSEN):
        if index[m] >= 0:
            outermost = m
    radius = wp.sqrt(square[CHOSEN])
    radius = wp.min(radius, wp.float64(2.0) * wp.sqrt(square[outermost]))
    radius = wp.min(radius, wp.max(farthest, wp.float64(2.0) * wp.sqrt(square[0])))
    total = zero
    for m in range(CHOSEN):
        weight = zero
        if index[m] >= 0:
            ratio = zero
            if radius > ratio:
                ratio = wp.min(wp.sqrt(square[m]) / radius, unit)
            weight = unit - ratio * ratio
            weight = weight * weight + SPARE
        square[m] = weight
        total += weight
    for m in range(CHOSEN):
        neighbours_out[n, m] = order[wp.max(index[m], 0)]
        weights_out[n, m] = float(square[m] / total)
