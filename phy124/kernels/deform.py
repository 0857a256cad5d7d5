"""Device code of `phy124.motion.deform`: Gaussians follow the material, all in float64.

One-sided Jacobi rotations (Hestenes 1958; high relative accuracy: Demmel, Veselic 1992) of A = F R0
S0 V make the columns of A orthogonal by plane rotations of at most 45 degrees: their directions are
the axes of F Sigma0 F^T, their lengths the scales. The iteration starts from V of the previous
frame. Columns that are already orthogonal to within `TOLERANCE` are left alone, so axes of equal
length move with the material instead of flickering. The thin axes of needle-shaped Gaussians stay
accurate; they would be lost if Sigma itself were decomposed. Quaternions are in wxyz order.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.native import code, constants, native_func
from phy124.kernels.spectral import to_double

MODULE = "phy124_deform"
SWEEPS = wp.constant(24)
TOLERANCE = wp.constant(wp.float64(4e-6))
EXACT = wp.constant(wp.float64(1e-14))
IDENTITY_ZONE = wp.constant(wp.float64(2.414))
"""Trace above which a rotation is below 45 degrees: then no relabelling of axes is closer."""
LARGEST = wp.constant(wp.float64(3.0e38))
TINY = wp.constant(wp.float64(1e-12))
SOUND_SHAPE = wp.constant(wp.float64(1.5))
ROUND_SHAPE = wp.constant(wp.float64(4.0))
"""Elongations of a Gaussian of plastic or fluid material, relative to rest: above `SOUND_SHAPE` it
becomes rounder, from `ROUND_SHAPE` on it is a ball.
"""

ARM = wp.constant(wp.float64(2.0))
"""Largest distance of a Gaussian of plastic or fluid material from a particle that carries it,
relative to their distance at rest.
"""


@wp.func
def matrix_of(q: wp.vec4d) -> wp.mat33d:
    """Return the rotation matrix of a wxyz quaternion of any non-zero length."""
    two = wp.float64(2.0)
    unit = wp.float64(1.0)
    u = q / wp.length(q)
    w, x, y, z = u[0], u[1], u[2], u[3]
    return wp.mat33d(
        unit - two * (y * y + z * z),
        two * (x * y - w * z),
        two * (x * z + w * y),
        two * (x * y + w * z),
        unit - two * (x * x + z * z),
        two * (y * z - w * x),
        two * (x * z - w * y),
        two * (y * z + w * x),
        unit - two * (x * x + y * y),
    )


@wp.func
def quaternion_of(r: wp.mat33d) -> wp.vec4d:
    """Return the unit wxyz quaternion of a rotation matrix (Shepperd's method)."""
    unit = wp.float64(1.0)
    t = r[0, 0] + r[1, 1] + r[2, 2]
    q = wp.vec4d(unit + t, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1])
    best = t
    if r[0, 0] > best:
        best = r[0, 0]
        q = wp.vec4d(q[1], unit + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0])
    if r[1, 1] > best:
        best = r[1, 1]
        q = wp.vec4d(
            r[0, 2] - r[2, 0],
            r[0, 1] + r[1, 0],
            unit + r[1, 1] - r[0, 0] - r[2, 2],
            r[1, 2] + r[2, 1],
        )
    if r[2, 2] > best:
        q = wp.vec4d(
            r[1, 0] - r[0, 1],
            r[0, 2] + r[2, 0],
            r[1, 2] + r[2, 1],
            unit + r[2, 2] - r[0, 0] - r[1, 1],
        )
    return q / wp.length(q)


@wp.func
def column(m: wp.mat33d, j: int) -> wp.vec3d:
    """Return column j of a matrix."""
    return wp.vec3d(m[0, j], m[1, j], m[2, j])


@wp.func
def plane_rotation(a: wp.vec3d, b: wp.vec3d, tolerance: wp.float64) -> wp.vec2d:
    """Return cosine and sine of the rotation that makes two columns orthogonal, or (1, 0)."""
    unit = wp.float64(1.0)
    turn = wp.vec2d(unit, wp.float64(0.0))
    p = wp.dot(a, a)
    q = wp.dot(b, b)
    c = wp.dot(a, b)
    if c * c > tolerance * tolerance * p * q:
        zeta = (q - p) / (wp.float64(2.0) * c)
        t = unit / (wp.abs(zeta) + wp.sqrt(unit + zeta * zeta))
        if zeta < wp.float64(0.0):
            t = -t
        cosine = unit / wp.sqrt(unit + t * t)
        turn = wp.vec2d(cosine, cosine * t)
    return turn


@wp.func
def orthogonal_columns(a: wp.mat33d, v: wp.mat33d, tolerance: wp.float64):
    """Return (A W, V W) for the rotation W that makes the columns of A W orthogonal."""
    zero = wp.float64(0.0)
    a0, a1, a2 = column(a, 0), column(a, 1), column(a, 2)
    v0, v1, v2 = column(v, 0), column(v, 1), column(v, 2)
    turning = int(1)
    sweep = int(0)
    while turning == 1 and sweep < SWEEPS:
        turning = int(0)
        sweep += 1
        t = plane_rotation(a0, a1, tolerance)
        if t[1] != zero:
            turning = int(1)
            e = t[0] * a0 - t[1] * a1
            a1 = t[1] * a0 + t[0] * a1
            a0 = e
            e = t[0] * v0 - t[1] * v1
            v1 = t[1] * v0 + t[0] * v1
            v0 = e
        t = plane_rotation(a0, a2, tolerance)
        if t[1] != zero:
            turning = int(1)
            e = t[0] * a0 - t[1] * a2
            a2 = t[1] * a0 + t[0] * a2
            a0 = e
            e = t[0] * v0 - t[1] * v2
            v2 = t[1] * v0 + t[0] * v2
            v0 = e
        t = plane_rotation(a1, a2, tolerance)
        if t[1] != zero:
            turning = int(1)
            e = t[0] * a1 - t[1] * a2
            a2 = t[1] * a1 + t[0] * a2
            a1 = e
            e = t[0] * v1 - t[1] * v2
            v2 = t[1] * v1 + t[0] * v2
            v1 = e
    return wp.matrix_from_cols(a0, a1, a2), wp.matrix_from_cols(v0, v1, v2)


@wp.func
def across(e: wp.vec3d, wanted: wp.vec3d, spare: wp.vec3d) -> wp.vec3d:
    """Return a unit vector orthogonal to e, in the plane of e and `wanted`, else e and `spare`."""
    u = wanted - wp.dot(e, wanted) * e
    if wp.length(u) <= wp.float64(1e-3) * wp.length(wanted):
        u = spare - wp.dot(e, spare) * e
    return u / wp.length(u)


@wp.func
def orientation(a: wp.mat33d, lengths: wp.vec3d, previous: wp.mat33d) -> wp.mat33d:
    """Return the proper rotation along the (nearly) orthogonal columns of A.

    The longest axis is exact; the shortest is the cross product, whose sign also removes
    reflections. Columns of zero length are replaced by the previous axes, made orthogonal to the
    others.
    """
    i = int(0)
    if lengths[1] > lengths[i]:
        i = int(1)
    if lengths[2] > lengths[i]:
        i = int(2)
    j = (i + 1) % 3
    k = (i + 2) % 3
    if lengths[k] > lengths[j]:
        j = (i + 2) % 3
        k = (i + 1) % 3
    out = previous
    # Lengths below 1e-150 cannot be squared and have no direction.
    if lengths[i] > wp.float64(1e-150):
        longest = column(a, i) / lengths[i]
        wanted = column(a, j)
        if lengths[j] <= wp.float64(1e-15) * lengths[i]:
            wanted = column(previous, j)
        middle = across(longest, wanted, across(longest, column(previous, k), column(previous, i)))
        shortest = wp.cross(longest, middle)
        if j == (i + 2) % 3:
            shortest = -shortest
        for r in range(3):
            out[r, i] = longest[r]
            out[r, j] = middle[r]
            out[r, k] = shortest[r]
    return out


@wp.func
def nearest_labels(u: wp.mat33d, previous: wp.mat33d) -> wp.mat33d:
    """Return the signed permutation W, of 24 proper ones, with U W closest to `previous`."""
    unit = wp.float64(1.0)
    m = wp.transpose(previous) * u
    best = wp.identity(n=3, dtype=wp.float64)
    if m[0, 0] + m[1, 1] + m[2, 2] < IDENTITY_ZONE:
        top = wp.float64(-4.0)
        for choice in range(6):
            odd = choice / 3
            p0 = choice % 3
            p1 = (p0 + 1 + odd) % 3
            p2 = (p0 + 2 - odd) % 3
            d = wp.vec3d(m[0, p0], m[1, p1], m[2, p2])
            s = wp.vec3d(wp.sign(d[0]), wp.sign(d[1]), wp.sign(d[2]))
            parity = unit - wp.float64(2.0) * wp.float64(odd)
            if s[0] * s[1] * s[2] * parity < wp.float64(0.0):
                weak = int(0)
                if wp.abs(d[1]) < wp.abs(d[weak]):
                    weak = int(1)
                if wp.abs(d[2]) < wp.abs(d[weak]):
                    weak = int(2)
                s[weak] = -s[weak]
            trace = wp.dot(s, d)
            if trace > top:
                top = trace
                best = wp.mat33d()
                best[p0, 0] = s[0]
                best[p1, 1] = s[1]
                best[p2, 2] = s[2]
    return best


@wp.func
def round_lengths(lengths: wp.vec3d, rest: wp.vec3d):
    """Return the axis lengths of a plastic or fluid Gaussian, made more equal the longer it is.

    A ball of radius sqrt(a b), where a and b are the two longest axes, covers as much of a frame as
    the Gaussian does.
    """
    unit = wp.float64(1.0)
    longest = wp.max(lengths)
    shortest = wp.max(wp.min(lengths), TINY * longest)
    middle = lengths[0] + lengths[1] + lengths[2] - longest - wp.min(lengths)
    drawn = longest / shortest * wp.min(rest) / wp.max(rest)
    w = wp.clamp((drawn - SOUND_SHAPE) / (ROUND_SHAPE - SOUND_SHAPE), wp.float64(0.0), unit)
    ball = wp.sqrt(longest * wp.max(middle, shortest))
    return (unit - w) * lengths + w * wp.vec3d(ball, ball, ball)


@wp.func
def within(f: wp.mat33d, limit: wp.float64) -> wp.mat33d:
    """Return F with its logarithmic strain scaled down until its largest stretch is `limit`.

    F = U S V^T becomes U S^p V^T with p = log(limit) / log(s_1). The result is continuous as s_1
    passes the limit and keeps the rotation; the Gaussian is stretched as if the material were not
    torn.
    """
    if wp.ddot(f, f) <= limit * limit:
        return f
    us, v = orthogonal_columns(f, wp.identity(n=3, dtype=wp.float64), EXACT)
    s = wp.vec3d(wp.length(column(us, 0)), wp.length(column(us, 1)), wp.length(column(us, 2)))
    longest = wp.max(s)
    if longest <= limit:
        return f
    power = wp.log(limit) / wp.log(longest) - wp.float64(1.0)
    for k in range(3):
        s[k] = wp.pow(wp.max(s[k], TINY * longest), power)
    return us * wp.diag(s) * wp.transpose(v)


@wp.func
def shape_of(
    f: wp.mat33d,
    quat0: wp.vec4f,
    scale0: wp.vec3f,
    hold: wp.float64,
    max_stretch: wp.float64,
    becomes_ball: bool,
    inner: wp.vec4f,
    quat: wp.vec4f,
):
    """Return V, quaternion and scales of a deformed Gaussian, Sigma_t = F Sigma0 F^T.

    V and the quaternion continue those of the previous frame.
    """
    s0 = wp.vec3d(scale0)
    last = wp.vec4d(quat)
    previous = matrix_of(last)
    v = matrix_of(wp.vec4d(inner))
    a = within(f, hold) * matrix_of(wp.vec4d(quat0)) * wp.diag(s0) * v
    a, v = orthogonal_columns(a, v, TOLERANCE)
    lengths = wp.vec3d(wp.length(column(a, 0)), wp.length(column(a, 1)), wp.length(column(a, 2)))
    u = orientation(a, lengths, previous)
    labels = nearest_labels(u, previous)
    q = quaternion_of(u * labels)
    if wp.dot(q, last) < wp.float64(0.0):
        q = -q
    limit = wp.min(LARGEST, max_stretch * wp.max(s0))
    lengths = wp.transpose(labels) * lengths
    if becomes_ball:
        lengths = round_lengths(
            wp.vec3d(wp.abs(lengths[0]), wp.abs(lengths[1]), wp.abs(lengths[2])), s0
        )
    s = wp.vec3f()
    for k in range(3):
        s[k] = wp.float32(wp.min(wp.abs(lengths[k]), limit))
    return wp.vec4f(quaternion_of(v * labels)), wp.vec4f(q), s


@kernel(MODULE, seconds=1.5)
def deform_shapes(
    quats0: wp.array(dtype=wp.vec4f),
    scales0: wp.array(dtype=wp.vec3f),
    holds: wp.array(dtype=wp.float64),
    max_stretch: wp.array(dtype=wp.float64),
    rounds: wp.array(dtype=wp.bool),
    # of the previous frame
    quats: wp.array(dtype=wp.vec4f),
    deformation: wp.array(dtype=wp.mat33d),
    # in place: read for the previous frame, written for this one
    inner_out: wp.array(dtype=wp.vec4f),
    quats_out: wp.array(dtype=wp.vec4f),
    scales_out: wp.array(dtype=wp.vec3f),
):
    """Compute one frame's Sigma_t = F Sigma0 F^T as quaternions and scales."""
    i = wp.tid()
    inner, quat, scale = shape_of(
        deformation[i],
        quats0[i],
        scales0[i],
        holds[i],
        max_stretch[i],
        rounds[i],
        inner_out[i],
        quats[i],
    )
    inner_out[i] = inner
    quats_out[i] = quat
    scales_out[i] = scale


shapes_of_eight = native_func(
    constants(
        "double",
        SWEEPS=SWEEPS,
        TOLERANCE=TOLERANCE.value,
        IDENTITY_ZONE=IDENTITY_ZONE.value,
        LARGEST=LARGEST.value,
        TINY=TINY.value,
        SOUND_SHAPE=SOUND_SHAPE.value,
        ROUND_SHAPE=ROUND_SHAPE.value,
    )
    + code("deform"),
    deform_shapes.func,
    "shapes_of_eight",
    returns=int,
)
"""Deforms the Gaussians `8 thread` to `8 thread + 7`; returns one bit for each that is unusual."""


@kernel("phy124_deform_simd", seconds=1.5)
def deform_shapes_simd(
    quats0: wp.array(dtype=wp.vec4f),
    scales0: wp.array(dtype=wp.vec3f),
    holds: wp.array(dtype=wp.float64),
    max_stretch: wp.array(dtype=wp.float64),
    rounds: wp.array(dtype=wp.bool),
    # of the previous frame
    quats: wp.array(dtype=wp.vec4f),
    deformation: wp.array(dtype=wp.mat33d),
    # in place: read for the previous frame, written for this one
    inner_out: wp.array(dtype=wp.vec4f),
    quats_out: wp.array(dtype=wp.vec4f),
    scales_out: wp.array(dtype=wp.vec3f),
):
    """Deform eight Gaussians per thread; `shape_of` handles the unusual ones."""
    group = wp.tid()
    left = shapes_of_eight(
        group,
        quats0,
        scales0,
        holds,
        max_stretch,
        rounds,
        quats,
        deformation,
        inner_out,
        quats_out,
        scales_out,
    )
    i = int(8 * group)
    while left > 0:
        if (left & 1) == 1:
            inner, quat, scale = shape_of(
                deformation[i],
                quats0[i],
                scales0[i],
                holds[i],
                max_stretch[i],
                rounds[i],
                inner_out[i],
                quats[i],
            )
            inner_out[i] = inner
            quats_out[i] = quat
            scales_out[i] = scale
        left = left >> 1
        i += 1


@kernel(MODULE, seconds=1.5)
def turn_of_material(
    deformation: wp.array(dtype=wp.mat33d),
    # in place: read for the previous frame, written for this one
    rotations_out: wp.array(dtype=wp.vec4f),
):
    """Compute the rotation closest to F (the polar rotation if det F > 0)."""
    i = wp.tid()
    last = wp.vec4d(rotations_out[i])
    a, v = orthogonal_columns(deformation[i], wp.identity(n=3, dtype=wp.float64), EXACT)
    lengths = wp.vec3d(wp.length(column(a, 0)), wp.length(column(a, 1)), wp.length(column(a, 2)))
    u = orientation(a, lengths, matrix_of(last) * v)
    q = quaternion_of(u * wp.transpose(v))
    if wp.dot(q, last) < wp.float64(0.0):
        q = -q
    rotations_out[i] = wp.vec4f(q)


@build_once
def make_carry(real: Any):
    """Kernel: computes centres and F of the Gaussians from particles of one precision.

    x_g = sum w_i (x_i + F_i (X_g - X_i)), F_g = sum w_i F_i over the carrying particles i. The F of
    plastic or fluid material grows without bound, so for such material the arms F_i (X_g - X_i) are
    limited.
    """
    t = types(real)

    @kernel(f"phy124_carry_{real.__name__}", real, seconds=0.4)
    def carry(
        neighbours: wp.array2d(dtype=wp.int32),
        weights: wp.array2d(dtype=wp.float32),
        means0: wp.array(dtype=wp.vec3f),
        flows: wp.array(dtype=wp.bool),
        rest: wp.array(dtype=wp.vec3f),
        position: t.vec3s,
        deformation: t.mat33s,
        means_out: wp.array(dtype=wp.vec3f),
        deformation_out: wp.array(dtype=wp.mat33d),
    ):
        i = wp.tid()
        home = wp.vec3d(means0[i])
        x = wp.vec3d()
        f = wp.mat33d()
        total = wp.float64(0.0)
        for k in range(neighbours.shape[1]):
            j = neighbours[i, k]
            w = wp.float64(weights[i, k])
            g = to_double(deformation[j])
            at_rest = home - wp.vec3d(rest[j])
            arm = g * at_rest
            if flows[i]:
                longest = ARM * wp.length(at_rest)
                if wp.length(arm) > longest:
                    arm *= longest / wp.length(arm)
            x += w * (wide(position[j]) + arm)
            f += w * g
            total += w
        part = wp.float64(1.0) / total
        means_out[i] = wp.vec3f(part * x)
        deformation_out[i] = part * f

    return carry


@build_once
def make_follow(real: Any):
    """Kernel: gives each Gaussian the position and F of its own particle, of one precision."""
    t = types(real)

    @kernel(f"phy124_follow_{real.__name__}", real, seconds=0.2)
    def follow(
        particle: wp.array(dtype=wp.int32),
        position: t.vec3s,
        deformation: t.mat33s,
        means_out: wp.array(dtype=wp.vec3f),
        deformation_out: wp.array(dtype=wp.mat33d),
    ):
        i = wp.tid()
        means_out[i] = wp.vec3f(position[particle[i]])
        deformation_out[i] = to_double(deformation[particle[i]])

    return follow


@build_once
def make_count_broken(real: Any):
    """Kernel: counts the particles whose position, and those whose F, is not finite."""
    t = types(real)

    @kernel(f"phy124_broken_{real.__name__}", real, seconds=0.2)
    def count_broken(
        position: t.vec3s, deformation: t.mat33s, counts_out: wp.array(dtype=wp.int32)
    ):
        p = wp.tid()
        if not wp.isfinite(position[p]):
            wp.atomic_add(counts_out, 0, 1)
        if not wp.isfinite(deformation[p]):
            wp.atomic_add(counts_out, 1, 1)

    return count_broken
