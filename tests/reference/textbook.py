"""A simple MLS-MPM in Warp, written directly from the papers, with which the solver is compared.

Hu et al. 2018 with fixed corotated elasticity (Stomakhin et al. 2012) by singular values, a dense
grid, one launch from Python per stage, a sticky floor (nodes below it stand still). No window, no
SIMD, no adaptive substep.
"""

import warp as wp
from numpy.typing import NDArray


@wp.func
def weights(f: wp.vec3):
    """The three quadratic B-spline weights along each axis, as columns."""
    a = wp.vec3(1.5) - f
    b = f - wp.vec3(1.0)
    c = f - wp.vec3(0.5)
    return wp.matrix_from_cols(
        0.5 * wp.cw_mul(a, a), wp.vec3(0.75) - wp.cw_mul(b, b), 0.5 * wp.cw_mul(c, c)
    )


@wp.func
def corner(x: wp.vec3, dx: float):
    return wp.vec3i(
        int(wp.floor(x[0] / dx - 0.5)),
        int(wp.floor(x[1] / dx - 0.5)),
        int(wp.floor(x[2] / dx - 0.5)),
    )


@wp.func
def stress(F: wp.mat33, mu: float, lam: float):
    """Kirchhoff stress of the fixed corotated law."""
    U, _, V = wp.svd3(F)
    R = U * wp.transpose(V)
    J = wp.determinant(F)
    identity = wp.identity(n=3, dtype=float)
    return 2.0 * mu * (F - R) * wp.transpose(F) + lam * (J - 1.0) * J * identity


@wp.kernel(enable_backward=False)
def p2g(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    C: wp.array(dtype=wp.mat33),
    F: wp.array(dtype=wp.mat33),
    mass: float,
    volume: float,
    mu: float,
    lam: float,
    dx: float,
    kick: float,
    momentum: wp.array3d(dtype=wp.vec3),
    weight: wp.array3d(dtype=float),
):
    p = wp.tid()
    base = corner(x[p], dx)
    f = x[p] / dx - wp.vec3(float(base[0]), float(base[1]), float(base[2]))
    w = weights(f)
    affine = mass * C[p] - (4.0 * kick * volume / (dx * dx)) * stress(F[p], mu, lam)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                d = (wp.vec3(float(i), float(j), float(k)) - f) * dx
                fraction = w[0, i] * w[1, j] * w[2, k]
                a, b, c = base[0] + i, base[1] + j, base[2] + k
                wp.atomic_add(momentum, a, b, c, fraction * (mass * v[p] + affine * d))
                wp.atomic_add(weight, a, b, c, fraction * mass)


@wp.kernel(enable_backward=False)
def update(
    momentum: wp.array3d(dtype=wp.vec3),
    weight: wp.array3d(dtype=float),
    g: wp.vec3,
    kick: float,
    floor: int,
):
    i, j, k = wp.tid()
    if weight[i, j, k] > 0.0:
        v = momentum[i, j, k] / weight[i, j, k] + kick * g
        if k <= floor:
            v = wp.vec3()
        momentum[i, j, k] = v


@wp.kernel(enable_backward=False)
def g2p(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    C: wp.array(dtype=wp.mat33),
    F: wp.array(dtype=wp.mat33),
    dx: float,
    dt: float,
    velocity: wp.array3d(dtype=wp.vec3),
):
    p = wp.tid()
    base = corner(x[p], dx)
    f = x[p] / dx - wp.vec3(float(base[0]), float(base[1]), float(base[2]))
    w = weights(f)
    mean = wp.vec3()
    affine = wp.mat33()
    for i in range(3):
        for j in range(3):
            for k in range(3):
                d = (wp.vec3(float(i), float(j), float(k)) - f) * dx
                u = w[0, i] * w[1, j] * w[2, k] * velocity[base[0] + i, base[1] + j, base[2] + k]
                mean += u
                affine += (4.0 / (dx * dx)) * wp.outer(u, d)
    v[p] = mean
    C[p] = affine
    x[p] = x[p] + dt * mean
    F[p] = F[p] + dt * affine * F[p]


class Textbook:
    """A body of equal particles in a cube from the origin to `size` [m] with `cells` cells."""

    def __init__(
        self,
        x: NDArray,
        volume: float,
        *,
        cells: int,
        size: float,
        E: float,
        nu: float,
        density: float,
        floor: float,
    ) -> None:
        count = len(x)
        self.x = wp.array(x, dtype=wp.vec3, device="cpu")
        self.v = wp.zeros(count, dtype=wp.vec3, device="cpu")
        self.C = wp.zeros(count, dtype=wp.mat33, device="cpu")
        self.F = wp.full(count, wp.mat33(1, 0, 0, 0, 1, 0, 0, 0, 1), device="cpu")
        self.dx, self.floor = size / cells, int(floor * cells / size)
        self.momentum = wp.zeros((cells,) * 3, dtype=wp.vec3, device="cpu")
        self.weight = wp.zeros((cells,) * 3, dtype=float, device="cpu")
        mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
        self.model = [density * volume, volume, mu, lam, self.dx]
        self.substeps = 0

    def step(self, dt: float) -> None:
        """Take a substep; the first kick has half the length, as in the solver."""
        kick = dt if self.substeps else dt / 2
        state = [self.x, self.v, self.C, self.F]
        self.momentum.zero_()
        self.weight.zero_()
        scatter = [*state, *self.model, kick, self.momentum, self.weight]
        wp.launch(p2g, len(self.x), scatter, device="cpu")
        fall = [self.momentum, self.weight, wp.vec3(0.0, 0.0, -9.81), kick, self.floor]
        wp.launch(update, self.momentum.shape, fall, device="cpu")
        wp.launch(g2p, len(self.x), [*state, self.dx, dt, self.momentum], device="cpu")
        self.substeps += 1
