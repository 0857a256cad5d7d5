"""Transfers between particles and the grid: MLS-MPM with APIC velocities and quadratic B-splines.

See Hu et al. 2018 (eqs. 16-19, 22) and Jiang et al. 2015. The grid is a flat array of four-vectors:
(momentum, mass) after the scatter, (velocity, mass) after the grid update. `window[0]` is the
window's lowest node, and `window[1]` its extent. `lattice` is (origin x, y, z, dx). `clock` is
(kick, drift, time): the kick is the mean of two successive substeps, and the drift is the current
substep, so that free fall is exact.

By default, stress and strain are computed with the affine velocity C. The option "spline" uses the
gradients of the weights instead: F follows grad v = sum v_i (grad w_i)^T, and the force on a node
is -sum V tau grad w_i (Sulsky et al. 1994; Stomakhin et al. 2013, eq. 6). docs/design/physics.md
compares both.

The functions of all laws have these arguments: F, the deformation gradient; C, the velocity
gradient [1/s]; h, the history variables of the particle; theta, the parameters of the law; dt, the
length of the substep [s].
"""

from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.native import code
from phy124.kernels.reduction import add, load, run_of, store


class Law(NamedTuple):
    """The device functions of a constitutive law."""

    name: str
    """Unique name, which is part of the names of compiled modules."""
    stress: Any
    """`(F, C, history, theta) -> tau`, Kirchhoff stress [Pa]."""
    modulus: Any
    """`(F, history, theta) -> A`, upper bound of the eigenvalues of d tau / d ln sigma [Pa]."""
    width: int
    """Number of parameters in `theta`."""
    project: Any = None
    """`(F, history, theta, dt) -> (F, history)`, the return mapping; None for an elastic law."""
    energy: Any = None
    """`(F, history, theta) -> psi`, elastic energy per rest volume [J/m^3]."""
    barrier: bool = False
    """Whether the energy rises steeply as det F approaches 0, so that the pressure stays positive
    for det F < 0. Otherwise the stress of an inverted element follows from its energy.
    """


NOWHERE = wp.constant(-1e9)
"""Replaces a grid coordinate that is NaN; this value is outside every window."""


@wp.func
def lowest_node(g: Any):
    """Return the lowest of the three nodes of a particle along an axis; the coordinate may be NaN.

    GPUs and some CPUs convert NaN to 0, which is a valid node.
    """
    start = g - type(g)(0.5)
    return int(wp.floor(wp.where(start > type(g)(NOWHERE), start, type(g)(NOWHERE))))


@wp.func
def first_node(g: Any):
    """Return the lowest node that a particle at the grid coordinates g touches."""
    return wp.vec3i(lowest_node(g[0]), lowest_node(g[1]), lowest_node(g[2]))


@wp.func
def place_in(x: Any, lattice: Any, window: wp.array(dtype=wp.vec3i)):
    """Return the first node of a particle in the window, and the particle's offset from this node
    [cells].
    """
    g = (x - wp.vector(lattice[0], lattice[1], lattice[2])) / lattice[3]
    low = first_node(g)
    node = wp.vector(type(g[0])(low[0]), type(g[0])(low[1]), type(g[0])(low[2]))
    return low - window[0], g - node


@wp.func
def in_window(first: wp.vec3i, size: wp.vec3i):
    """Return whether all 27 nodes of a particle are inside the window.

    Adding to `first` could overflow, since distant positions give the smallest or largest integer.
    """
    return (
        first[0] >= 0
        and first[1] >= 0
        and first[2] >= 0
        and first[0] <= size[0] - 3
        and first[1] <= size[1] - 3
        and first[2] <= size[2] - 3
    )


@wp.func
def member(chosen: wp.array(dtype=int), i: int):
    """Return the index of the i-th chosen particle, or i if the list is empty."""
    if chosen.shape[0] > 0:
        return chosen[i]
    return i


@wp.func
def between(x: Any, low: Any, high: Any):
    """Return whether a point is inside the box with two corners."""
    return (
        x[0] >= low[0]
        and x[1] >= low[1]
        and x[2] >= low[2]
        and x[0] <= high[0]
        and x[1] <= high[1]
        and x[2] <= high[2]
    )


@wp.func
def spline(f: Any):
    """Return B-spline weights of three nodes; f in [0.5, 1.5) is the offset from the first node."""
    half = type(f)(0.5)
    a = type(f)(1.5) - f
    b = f - type(f)(1.0)
    c = f - half
    return wp.vector(half * a * a, type(f)(0.75) - b * b, half * c * c)


@wp.func
def slope(f: Any):
    """Return the derivatives of `spline` with respect to the position of the particle, per cell."""
    return wp.vector(f - type(f)(1.5), type(f)(2.0) - type(f)(2.0) * f, f - type(f)(0.5))


@wp.func
def offsets(f: Any):
    """Return the vector (0, 1, 2) in the precision of f.

    Casting a loop index instead would change the type of the index itself.
    """
    return wp.vector(type(f)(0.0), type(f)(1.0), type(f)(2.0))


@wp.func
def scatter_with_stress(
    grid: wp.array(dtype=Any),
    size: wp.vec3i,
    first: wp.vec3i,
    f: Any,
    base: Any,
    column_x: Any,
    column_y: Any,
    column_z: Any,
    force_x: Any,
    force_y: Any,
    force_z: Any,
):
    """Add w (base + i X + j Y + k Z) + (dw/dx) S + (dw/dy) T + (dw/dz) U to 27 nodes."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    sx = slope(f[0])
    sy = slope(f[1])
    sz = slope(f[2])
    step = offsets(f[0])
    run = run_of((first[0] * size[1] + first[1]) * size[2] + first[2])
    for i in range(3):
        for j in range(3):
            w = wx[i] * wy[j]
            low = w * (base + step[i] * column_x + step[j] * column_y)
            low += (sx[i] * wy[j]) * force_x + (wx[i] * sy[j]) * force_y
            rise = w * column_z
            turn = w * force_z
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            add(grid, n, wz[0] * low + sz[0] * turn, run)
            add(grid, n + 1, wz[1] * (low + rise) + sz[1] * turn, run)
            add(grid, n + 2, wz[2] * (low + rise + rise) + sz[2] * turn, run)


@wp.func
def gather_slopes(grid: wp.array(dtype=Any), size: wp.vec3i, first: wp.vec3i, f: Any):
    """Return rows sum (dw/dx) v, sum (dw/dy) v, sum (dw/dz) v over the 27 nodes, per cell."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    sx = slope(f[0])
    sy = slope(f[1])
    sz = slope(f[2])
    by_x = wp.vector(length=4, dtype=type(f[0]))
    by_y = wp.vector(length=4, dtype=type(f[0]))
    by_z = wp.vector(length=4, dtype=type(f[0]))
    for i in range(3):
        for j in range(3):
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            low = load(grid, n)
            middle = load(grid, n + 1)
            last = load(grid, n + 2)
            row = wz[0] * low + wz[1] * middle + wz[2] * last
            by_x += (sx[i] * wy[j]) * row
            by_y += (wx[i] * sy[j]) * row
            by_z += (wx[i] * wy[j]) * (sz[0] * low + sz[1] * middle + sz[2] * last)
    return wp.matrix_from_rows(by_x, by_y, by_z)


@wp.func
def scatter(
    grid: wp.array(dtype=Any),
    size: wp.vec3i,
    first: wp.vec3i,
    f: Any,
    base: Any,
    column_x: Any,
    column_y: Any,
    column_z: Any,
):
    """Add w (base + i X + j Y + k Z) to the 27 nodes around a particle."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    step = offsets(f[0])
    run = run_of((first[0] * size[1] + first[1]) * size[2] + first[2])
    for i in range(3):
        for j in range(3):
            w = wx[i] * wy[j]
            low = w * (base + step[i] * column_x + step[j] * column_y)
            rise = w * column_z
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            add(grid, n, wz[0] * low, run)
            add(grid, n + 1, wz[1] * (low + rise), run)
            add(grid, n + 2, wz[2] * (low + rise + rise), run)


@wp.func
def gather(grid: wp.array(dtype=Any), size: wp.vec3i, first: wp.vec3i, f: Any):
    """Return rows sum w v, sum w i v, sum w j v, sum w k v over the 27 nodes."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    step = offsets(f[0])
    mean = wp.vector(length=4, dtype=type(f[0]))
    by_x = wp.vector(length=4, dtype=type(f[0]))
    by_y = wp.vector(length=4, dtype=type(f[0]))
    by_z = wp.vector(length=4, dtype=type(f[0]))
    for i in range(3):
        for j in range(3):
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            w = wx[i] * wy[j]
            middle = (w * wz[1]) * load(grid, n + 1)
            last = (w * wz[2]) * load(grid, n + 2)
            row = (w * wz[0]) * load(grid, n) + middle + last
            mean += row
            by_x += step[i] * row
            by_y += step[j] * row
            by_z += middle + last + last
    return wp.matrix_from_rows(mean, by_x, by_y, by_z)


@wp.func
def columns4(a: Any, s: Any):
    """Return the columns of s times a 3x3 matrix, as four-vectors with a mass component of zero."""
    z = type(s)(0.0)
    return (
        s * wp.vector(a[0, 0], a[1, 0], a[2, 0], z),
        s * wp.vector(a[0, 1], a[1, 1], a[2, 1], z),
        s * wp.vector(a[0, 2], a[1, 2], a[2, 2], z),
    )


@wp.func_native(code("transfer", "transfer:scatter"))
def scatter_rows(
    grid: wp.array(dtype=wp.vec4),
    size: wp.vec3i,
    first: wp.vec3i,
    f: wp.vec3,
    base: wp.vec4,
    column_x: wp.vec4,
    column_y: wp.vec4,
    column_z: wp.vec4,
):
    """Version of `scatter` in float32, with vector instructions of a CPU."""
    ...


@wp.func_native(code("transfer", "transfer:gather"))
def gather_rows(
    grid: wp.array(dtype=wp.vec4), size: wp.vec3i, first: wp.vec3i, f: wp.vec3
) -> wp.mat44:
    """Version of `gather` in float32, with vector instructions of a CPU."""
    ...


@wp.func
def motion_of(s: Any, f: Any, dx: Any):
    """Return a particle's velocity and velocity gradient, from the rows s that `gather` returns."""
    v = wp.vector(s[0, 0], s[0, 1], s[0, 2])
    k = type(dx)(4.0) / dx
    C = k * wp.matrix_from_cols(
        wp.vector(s[1, 0], s[1, 1], s[1, 2]) - f[0] * v,
        wp.vector(s[2, 0], s[2, 1], s[2, 2]) - f[1] * v,
        wp.vector(s[3, 0], s[3, 1], s[3, 2]) - f[2] * v,
    )
    return v, C


SCATTERS = {"plain": scatter, "simd": scatter_rows, "spline": scatter}
GATHERS = {"plain": gather, "simd": gather_rows, "spline": gather}
""""plain" is scalar code, which GPUs use; "simd" is float32 code for CPUs. "spline" computes stress
and strain with the gradients of the weights (`scatter_with_stress`).
"""


@build_once
def make_p2g(law: Law, real: Any, form: str):
    """Kernel: computes the stress, then scatters momentum and mass to the grid."""
    t = types(real)
    stress = law.stress
    spread = SCATTERS[form]
    has_history = law.project is not None
    name = f"phy124_p2g_{law.name}_{real.__name__}_{form}"

    @kernel(name, real, width=law.width, seconds=0.6)
    def p2g(chosen, mass, volume, theta, lattice, window, clock, x, v, C, F, history, grid_out):
        p = member(chosen, wp.tid())
        dx = lattice[3]
        size = window[1]
        first, f = place_in(x[p], lattice, window)
        if in_window(first, size):
            h = t.vec2()
            if wp.static(has_history):
                h = history[p]
            m = mass[p]
            tau = stress(F[p], C[p], h, theta[wp.min(p, theta.shape[0] - 1)])
            affine = m * C[p]
            if wp.static(form != "spline"):
                affine -= (real(4.0) * clock[0] * volume[p] / (dx * dx)) * tau
            cx, cy, cz = columns4(affine, dx)
            mv = m * v[p]
            base = wp.vector(mv[0], mv[1], mv[2], m) - f[0] * cx - f[1] * cy - f[2] * cz
            if wp.static(form == "spline"):
                sx, sy, sz = columns4(tau, -clock[0] * volume[p] / dx)
                scatter_with_stress(grid_out, size, first, f, base, cx, cy, cz, sx, sy, sz)
            else:
                spread(grid_out, size, first, f, base, cx, cy, cz)

    return p2g


@build_once
def make_g2p(law: Law, real: Any, form: str):
    """Kernel: gathers velocities from the grid, then updates x and F.

    A particle outside the window is not changed, and `missed_out` is set: the particle is ballistic
    (kernels/ballistic.py), or the run is unstable. Plastic laws also update F_total, which the
    Gaussians follow. Thread i also clears the nodes i + k `stride`, k < `each`, of `momenta_out`.
    """
    project, collect = law.project, GATHERS[form]
    plastic = project is not None
    owner = law.name if plastic else f"elastic{law.width}"
    name = f"phy124_g2p_{owner}_{real.__name__}_{form}"

    @kernel(name, real, width=law.width, seconds=0.5)
    def g2p(
        chosen,
        each,
        stride,
        theta,
        lattice,
        window,
        clock,
        grid,
        x_out,
        residue_out,
        v_out,
        C_out,
        F_out,
        history_out,
        total_out,
        missed_out: Ints,
        momenta_out: wp.array(dtype=types(real).vec4),
    ):
        for turn in range(each):
            n = wp.tid() + turn * stride
            if n < momenta_out.shape[0]:
                momenta_out[n] = wp.vector(real(0.0), real(0.0), real(0.0), real(0.0))
        p = member(chosen, wp.tid())
        dx = lattice[3]
        size = window[1]
        first, f = place_in(x_out[p], lattice, window)
        if in_window(first, size):
            v, C = motion_of(collect(grid, size, first, f), f, dx)
            dt = clock[1]
            # Kahan's compensated summation; otherwise, rounding in float32 would stop a slow
            # motion.
            change = dt * v - residue_out[p]
            moved = x_out[p] + change
            residue_out[p] = (moved - x_out[p]) - change
            x_out[p] = moved
            v_out[p] = v
            store(C_out, p, C)
            L = C
            if wp.static(form == "spline"):
                slopes = gather_slopes(grid, size, first, f)
                L = (real(1.0) / dx) * wp.matrix_from_cols(
                    wp.vector(slopes[0, 0], slopes[0, 1], slopes[0, 2]),
                    wp.vector(slopes[1, 0], slopes[1, 1], slopes[1, 2]),
                    wp.vector(slopes[2, 0], slopes[2, 1], slopes[2, 2]),
                )
            trial = F_out[p] + dt * (L * F_out[p])
            if wp.static(plastic):
                store(total_out, p, total_out[p] + dt * (L * total_out[p]))
                row = wp.min(p, theta.shape[0] - 1)
                elastic, h = project(trial, history_out[p], theta[row], dt)
                store(F_out, p, elastic)
                history_out[p] = h
            else:
                store(F_out, p, trial)
                # If any material of the run is plastic, all Gaussians follow `total` instead of F.
                if total_out.shape[0] > 0:
                    store(total_out, p, trial)
        else:
            wp.atomic_max(missed_out, 0, 1)

    return g2p
