"""Device code of `phy124.motion.deform`: makes Gaussians follow the material, in float64.

Jacobi rotations (see `axes`) make the columns of A = F R0 S0 V orthogonal. The directions of the
columns are then the axes of F Sigma0 F^T, and their lengths are the scales. Columns that are
orthogonal to within `TOLERANCE` are not changed, so axes of equal length move with the material
instead of flickering. If Sigma itself were decomposed, rounding would destroy the thin axes of
needle-shaped Gaussians.
"""

from typing import Any

import warp as wp

from phy124.kernels.axes import (
    IDENTITY_ZONE,
    SWEEPS,
    column,
    matrix_of,
    nearest_labels,
    orientation,
    orthogonal_columns,
    quaternion_of,
)
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.native import code, constants, native_func
from phy124.kernels.spectral import to_double

MODULE = "phy124_deform"
TOLERANCE = wp.constant(wp.float64(4e-6))
EXACT = wp.constant(wp.float64(1e-14))
LARGEST = wp.constant(wp.float64(3.0e38))
TINY = wp.constant(wp.float64(1e-12))
SOUND_SHAPE = wp.constant(wp.float64(1.5))
ROUND_SHAPE = wp.constant(wp.float64(4.0))
"""A Gaussian of plastic or fluid material becomes a ball if its elongation, relative to rest,
reaches this value.
"""

ARM = wp.constant(wp.float64(2.0))
"""Upper bound of the distance between a Gaussian of plastic or fluid material and a particle that
carries it, relative to their distance at rest.
"""
SEPARATE = wp.constant(wp.float64(4.0))
"""A Gaussian of plastic or fluid material follows only its nearest particle if the mean over all
particles that carry it is at least this far away from the position that the nearest particle gives.
The unit is the distance between the nearest and the farthest of these particles at rest.
"""


@wp.func
def round_lengths(lengths: wp.vec3d, rest: wp.vec3d):
    """Return the axis lengths of a Gaussian of plastic or fluid material, made rounder if
    elongated.

    A ball of radius sqrt(a b), where a and b are the two longest axes, covers the same area of an
    image as the Gaussian.
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
    """Return F, with its logarithmic strain scaled down if the largest stretch exceeds `limit`.

    F = U S V^T becomes U S^p V^T with p = log(limit) / log(s_1), where s_1 is the largest stretch.
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
def deform_shape(
    i: int,
    quats0: wp.array(dtype=wp.vec4f),
    scales0: wp.array(dtype=wp.vec3f),
    holds: wp.array(dtype=wp.float64),
    limits: wp.array(dtype=wp.float64),
    rounds: wp.array(dtype=bool),
    quats: wp.array(dtype=wp.vec4f),
    deformation: wp.array(dtype=wp.mat33d),
    inner_out: wp.array(dtype=wp.vec4f),
    quats_out: wp.array(dtype=wp.vec4f),
    scales_out: wp.array(dtype=wp.vec3f),
):
    """Compute V, the quaternion and the scales of a Gaussian with covariance F Sigma0 F^T.

    V and the quaternion start from the previous frame, so that axes do not change order.
    """
    s0 = wp.vec3d(scales0[i])
    last = wp.vec4d(quats[i])
    previous = matrix_of(last)
    v = matrix_of(wp.vec4d(inner_out[i]))
    a = within(deformation[i], holds[i]) * matrix_of(wp.vec4d(quats0[i])) * wp.diag(s0) * v
    a, v = orthogonal_columns(a, v, TOLERANCE)
    lengths = wp.vec3d(wp.length(column(a, 0)), wp.length(column(a, 1)), wp.length(column(a, 2)))
    u = orientation(a, lengths, previous)
    labels = nearest_labels(u, previous)
    q = quaternion_of(u * labels)
    if wp.dot(q, last) < wp.float64(0.0):
        q = -q
    limit = wp.min(LARGEST, limits[i] * wp.max(s0))
    lengths = wp.transpose(labels) * lengths
    if rounds[i]:
        lengths = round_lengths(
            wp.vec3d(wp.abs(lengths[0]), wp.abs(lengths[1]), wp.abs(lengths[2])), s0
        )
    s = wp.vec3f()
    for k in range(3):
        s[k] = wp.float32(wp.min(wp.abs(lengths[k]), limit))
    inner_out[i] = wp.vec4f(quaternion_of(v * labels))
    quats_out[i] = wp.vec4f(q)
    scales_out[i] = s


@kernel(MODULE, wp.float64, seconds=1.5)
def deform_shapes(
    quats0, scales0, holds, limits, rounds, quats, deformation, inner_out, quats_out, scales_out
):
    """Compute the covariances Sigma_t = F Sigma0 F^T of a frame, as quaternions and scales."""
    deform_shape(
        wp.tid(), quats0, scales0, holds, limits, rounds, quats, deformation, inner_out,
        quats_out, scales_out,
    )  # fmt: skip


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
"""Deforms the Gaussians `8 thread` to `8 thread + 7`. Returns one bit per Gaussian, which is set if
the vectorised code cannot handle the Gaussian.
"""


@kernel("phy124_deform_simd", wp.float64, seconds=1.5)
def deform_shapes_simd(
    quats0, scales0, holds, limits, rounds, quats, deformation, inner_out, quats_out, scales_out
):
    """Deform eight Gaussians per thread."""
    group = wp.tid()
    left = shapes_of_eight(
        group, quats0, scales0, holds, limits, rounds, quats, deformation, inner_out,
        quats_out, scales_out,
    )  # fmt: skip
    i = int(8 * group)
    while left > 0:
        if (left & 1) == 1:
            deform_shape(
                i, quats0, scales0, holds, limits, rounds, quats, deformation, inner_out,
                quats_out, scales_out,
            )  # fmt: skip
        left = left >> 1
        i += 1


@kernel(MODULE, seconds=1.5)
def turn_of_material(
    deformation: wp.array(dtype=wp.mat33d),
    # in place: read from the previous frame, written for this frame
    rotations_out: wp.array(dtype=wp.vec4f),
):
    """Compute the rotation closest to F; if det F > 0, this is the polar rotation."""
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
    """Kernel: computes the centres and the deformation gradients F of Gaussians.

    x_g = sum w_i (x_i + F_i (X_g - X_i)), F_g = sum w_i F_i over the carrying particles i. In
    plastic or fluid material F grows without bound, so the length of F_i (X_g - X_i) is limited.

    When such material mixes, the particles i separate, and the mean moves towards the middle of the
    material. The Gaussian then follows its nearest particle instead. `alone_out` is 0 if the
    Gaussian follows the mean, and 1 if it follows only its nearest particle.
    """

    @kernel(f"phy124_carry_{real.__name__}", real, seconds=0.4)
    def carry(
        neighbours: wp.array2d(dtype=wp.int32),
        weights: wp.array2d(dtype=wp.float32),
        means0: wp.array(dtype=wp.vec3f),
        flows: wp.array(dtype=wp.bool),
        rest: wp.array(dtype=wp.vec3f),
        position,
        deformation,
        means_out: wp.array(dtype=wp.vec3f),
        deformation_out: wp.array(dtype=wp.mat33d),
        alone_out: wp.array(dtype=float),
    ):
        i = wp.tid()
        home = wp.vec3d(means0[i])
        x = wp.vec3d()
        f = wp.mat33d()
        total = wp.float64(0.0)
        nearest = wp.vec3d()
        across = wp.vec3d()
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
            place = wide(position[j]) + arm
            if k == 0:
                nearest = place
            across = wp.vec3d(rest[j]) - wp.vec3d(rest[neighbours[i, 0]])
            x += w * place
            f += w * g
            total += w
        part = wp.float64(1.0) / total
        x *= part
        alone = wp.float64(0.0)
        if flows[i]:
            back = nearest - x
            most = wp.max(SEPARATE * SEPARATE * wp.length_sq(across), TINY)
            near = wp.max(wp.float64(1.0) - wp.length_sq(back) / most, wp.float64(0.0))
            alone = wp.float64(1.0) - near * near
            x += alone * back
        means_out[i] = wp.vec3f(x)
        deformation_out[i] = part * f
        alone_out[i] = wp.float32(alone)

    return carry


@build_once
def make_follow(real: Any):
    """Kernel: copies x and F of the particle that represents each Gaussian."""

    @kernel(f"phy124_follow_{real.__name__}", real, seconds=0.2)
    def follow(
        particle: wp.array(dtype=wp.int32),
        position,
        deformation,
        means_out: wp.array(dtype=wp.vec3f),
        deformation_out: wp.array(dtype=wp.mat33d),
    ):
        i = wp.tid()
        means_out[i] = wp.vec3f(position[particle[i]])
        deformation_out[i] = to_double(deformation[particle[i]])

    return follow


@build_once
def make_count_broken(real: Any):
    """Kernel: counts particles with a non-finite position, and particles with a non-finite F."""

    @kernel(f"phy124_broken_{real.__name__}", real, seconds=0.2)
    def count_broken(position, deformation, counts_out: wp.array(dtype=wp.int32)):
        p = wp.tid()
        if not wp.isfinite(position[p]):
            wp.atomic_add(counts_out, 0, 1)
        if not wp.isfinite(deformation[p]):
            wp.atomic_add(counts_out, 1, 1)

    return count_broken
