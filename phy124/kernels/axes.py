"""Makes the columns of a matrix orthogonal by Jacobi rotations; converts columns to a rotation.

The rotations are one-sided (Hestenes 1958) and at most 45 degrees; their relative accuracy is high
(Demmel, Veselic 1992). Everything is in float64; quaternions are in wxyz order.
"""

import warp as wp

SWEEPS = wp.constant(24)
IDENTITY_ZONE = wp.constant(wp.float64(2.414))
"""Trace of a rotation by 45 degrees. If a Gaussian has rotated by a smaller angle since the
previous frame, its axes keep their order.
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
    """Return the cosine and the sine of the rotation that makes two columns orthogonal."""
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
    """Return (A W, V W), where the rotation W makes the columns of the product A W orthogonal."""
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
    """Return the unit vector normal to `e` that is nearest to `wanted`.

    If `wanted` is along `e`, `spare` is used instead.
    """
    u = wanted - wp.dot(e, wanted) * e
    if wp.length(u) <= wp.float64(1e-3) * wp.length(wanted):
        u = spare - wp.dot(e, spare) * e
    return u / wp.length(u)


@wp.func
def orientation(a: wp.mat33d, lengths: wp.vec3d, previous: wp.mat33d) -> wp.mat33d:
    """Return the proper rotation whose axes are along the (nearly) orthogonal columns of A.

    The axis along the longest column has exactly this column's direction. For a column of zero
    length, the axis of `previous` is used.
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
    """Return the signed permutation W, with determinant 1, for which U W is closest to
    `previous`.
    """
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
