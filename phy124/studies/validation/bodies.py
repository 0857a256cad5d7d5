"""Builds the bodies and solvers of validation problems, and averages over their particles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.gaussians import Gaussians, quaternions, spread_directions
from phy124.lattice.solver import LatticeSolver
from phy124.materials import Material
from phy124.mpm import Model, Solver, State
from phy124.particles.cubes import Cubes, Surface
from phy124.particles.lattice import lattice_of
from phy124.particles.solid import Solid

if TYPE_CHECKING:
    import warp as wp

    from phy124.liquid.solver import LiquidSolver

Array = NDArray[np.float64]
PARTS = 6
"""Number of parts along each axis of a voxel at a solid's surface."""
MODEL_OPTIONS = frozenset(signature(Model.of).parameters)


def lattice(counts: Sequence[int], spacing: float, corner: Sequence[float] = (0, 0, 0)) -> Array:
    """Return the centres [P,3], m, of the cubes that fill a box.

    There are `counts` [3] cubes with edges of `spacing` [m]. `corner` is the lowest corner [m].
    """
    lines = [(np.arange(count) + 0.5) * spacing for count in counts]
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(x + np.asarray(corner), float)


def block(per_axis: int = 6, size: float = 0.375, middle: Sequence[float] = (0, 0, 0)) -> Array:
    """Return the positions [P,3], m, of `per_axis`^3 particles that fill a cube."""
    return lattice((per_axis,) * 3, size / per_axis, [at - size / 2 for at in middle])


def turning(x: Array, omega: Sequence[float]) -> dict[str, Any]:
    """Return velocities v [P,3] and gradients C [P,3,3] of a rotation `omega` [3], rad/s.

    The rotation is about the mean of the positions x [P,3].
    """
    wx, wy, wz = omega
    C = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]], float)
    return {"v": (x - x.mean(axis=0)) @ C.T, "C": np.broadcast_to(C, (len(x), 3, 3)).copy()}


def ball_of_shells(radius: float, spacing: float) -> tuple[Array, Array]:
    """Return the positions [P,3], m, and volumes [P], m^3, of particles that fill a ball.

    Concentric shells give the ball a smooth surface. Neighbours are about `spacing` [m] apart.
    """
    count, rng = round(radius / spacing), np.random.default_rng(0)
    step, x, volume = radius / count, [], []
    for k in range(count):
        middle = (k + 0.5) * step
        many = max(4, round(4 * np.pi * (middle / step) ** 2))
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        x.append(middle * spread_directions(many) @ turn)
        shell = 4 / 3 * np.pi * ((k + 1) ** 3 - k**3) * step**3
        volume.append(np.full(many, shell / many))
    return np.concatenate(x), np.concatenate(volume)


def part_of_ball(radius: float, spacing: float, cuts: int) -> tuple[Array, Array]:
    """Return the particles of `ball_of_shells` with positive coordinates on the first `cuts` axes.

    The particles are sorted by x. Their volumes add up to this part's volume.
    """
    x, volume = ball_of_shells(radius, spacing)
    part = (x[:, :cuts] > 0).all(axis=1)
    x, volume = x[part], volume[part]
    order = np.argsort(x[:, 0])
    whole = math.pi / 6 * radius**3 * 2 ** (3 - cuts)
    return x[order], volume[order] * (whole / volume.sum())


def surface_of_ball(count: int = 300, radius: float = 0.5) -> Gaussians:
    """Return flat Gaussians on a sphere; colours depend on the direction."""
    normals = spread_directions(count)
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    along = np.cross(normals, helper)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along), normals], axis=2)
    width = radius * math.sqrt(4 * math.pi / count)
    scales = np.tile([0.7 * width, 0.7 * width, 0.1 * width], (count, 1))
    colours = 0.5 + 0.4 * normals
    return Gaussians.from_rgb(
        normals * radius, quaternions(axes), scales, np.full(count, 0.95), colours
    )


def make_solver(
    x: NDArray[Any],
    volume: NDArray[Any] | float,
    materials: Sequence[Material],
    *,
    v: NDArray[Any] | None = None,
    C: NDArray[Any] | None = None,
    **options: Any,
) -> Solver:
    """Create a solver for a set of particles.

    Args:
        x: Positions [P,3], m.
        volume: Volumes [P], or the volume of each particle, m^3.
        materials: Materials of the particles.
        v: Initial velocities [P,3], m/s.
        C: Initial velocity gradients [P,3,3], 1/s.
        **options: Options of `Model.of` and of `Solver`.
    """
    of_model = {name: options.pop(name) for name in MODEL_OPTIONS & options.keys()}
    model = Model.of(x, np.full(len(x), volume), materials, **of_model)
    return Solver(model, State.of(model, v, C), **options)


def fill_solid(
    distance: Callable[[NDArray[Any]], NDArray[Any]],
    lower: Sequence[float] | NDArray[Any],
    upper: Sequence[float] | NDArray[Any],
    voxel: float,
) -> Solid:
    """Return the solid inside a surface, approximated by a plane in each part of a voxel.

    Args:
        distance: Signed distance of points [...,3] from the surface [m], negative inside.
        lower: Lowest corner of a box around the body [m].
        upper: Highest corner of the box [m].
        voxel: Edge length of a voxel [m].
    """
    first = np.floor(np.asarray(lower) / voxel + 1e-9).astype(np.int64)
    count = np.ceil(np.asarray(upper) / voxel - 1e-9).astype(np.int64) - first
    index = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1)
    away = distance((index + first + 0.5) * voxel)
    border = np.flatnonzero(np.abs(away) < 0.9 * voxel)
    inner = np.array(list(np.ndindex(PARTS, PARTS, PARTS))) / PARTS
    corner = (index.reshape(-1, 3)[border][:, None] + inner).reshape(-1, 3)
    middle = (corner + first + 0.5 / PARTS) * voxel
    height, step = -distance(middle) / voxel, 1e-3 * voxel
    slopes = [(distance(middle + step * unit) - distance(middle)) / step for unit in np.eye(3)]
    normal = np.stack(slopes, axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    lowest = np.full(len(height), -1.0)
    voxels, weight = np.repeat(border, PARTS**3), np.ones(len(height))
    parts = Cubes(voxels, corner, weight, normal, np.clip(height, -1, 1), lowest)
    surface = Surface(((parts.select(height > -1 / PARTS), PARTS),))
    return Solid(first, voxel, surface.fill(away < 0), surface)


def fill_box(edges: Sequence[float], dx: float, *, centred: bool = False) -> Solid:
    """Return a box on voxels of half a cell; its lowest corner is the origin.

    Args:
        edges: Edges of the box [3], multiples of dx / 2 [m].
        dx: Edge length of a cell [m].
        centred: True to place the box's centre at the origin.
    """
    counts = [round(2 * edge / dx) for edge in edges]
    first = [-(count // 2) if centred else 0 for count in counts]
    return Solid(np.array(first), dx / 2, np.ones(counts, np.float32))


def fill_part_of_ball(radius: float, dx: float, cuts: int) -> Solid:
    """Return the part of a ball around the origin with positive coordinates on the first axes.

    Args:
        radius: Radius of the ball [m].
        dx: Edge length of a cell; a voxel is half as long [m].
        cuts: Number of these axes.
    """
    low = [0.0 if axis < cuts else -radius for axis in range(3)]
    return fill_solid(lambda x: np.linalg.norm(x, axis=-1) - radius, low, (radius,) * 3, dx / 2)


def make_lattice_solver(
    solid: Solid,
    dx: float,
    material: Material,
    *,
    v: Sequence[float] = (0.0, 0.0, 0.0),
    spin: Sequence[float] = (0.0, 0.0, 0.0),
    **options: Any,
) -> LatticeSolver:
    """Create a solver for an undeformed solid on its lattice.

    Args:
        solid: The body.
        dx: Edge length of a cell [m].
        material: Material of the body.
        v: Initial velocity [3], m/s.
        spin: Initial angular velocity about the mean of the points [3], rad/s.
        **options: Options of `Model.of` and of `LatticeSolver`.
    """
    of_model = {name: options.pop(name) for name in MODEL_OPTIONS & options.keys()}
    points = lattice_of(solid, density=material.density, dx=dx)
    x = points.x.astype(np.float64)
    model = Model.of(x, points.volume, [material], dx=dx, **of_model)
    motion = turning(x, spin)
    motion["v"] += np.asarray(v, float)
    assert points.surface is not None
    options = {"copies": points.copies, **options}
    return LatticeSolver(model, points.surface, State.of(model, **motion), **options)


def measure_wall_force(solver: LatticeSolver, start: float, end: float) -> Array:
    """Return the mean force [3], N, of the first wall on a body between two times [s]."""
    solver.advance(start)
    before = host(solver.walls.sums)[0, :3]
    solver.advance(end)
    return (host(solver.walls.sums)[0, :3] - before) / (end - start)


UP = (0.0, 0.0, 1.0)
FAR = 1e3
"""Position of a plane [m]; the plane is so far away that all grid nodes are inside the wall."""


def sheet(counts: Sequence[int], spacing: float, corner: Sequence[float] = (0, 0, 0)) -> Array:
    """Return the positions [P,3], m, of particles in a single layer in the plane y = corner[1].

    The layer has `counts` [2] particles along x and z, `spacing` [m] apart.
    """
    x = lattice((counts[0], 1, counts[1]), spacing) * [1.0, 0.0, 1.0]
    return np.asarray(x + np.asarray(corner), float)


def plane() -> HalfSpace:
    """Return a wall that contains all grid nodes and prevents motion along y (plane strain)."""
    return HalfSpace(point=(0, FAR, 0), normal=(0, 1.0, 0), contact="slip")


def mirrors(*axes: int) -> list[HalfSpace]:
    """Return symmetry planes through the origin; the body must be on their positive sides."""
    return [HalfSpace(normal=tuple(np.eye(3)[axis].tolist()), contact="slip") for axis in axes]


def connected_end(x: NDArray[Any], gap: float) -> float:
    """Return the last of the sorted coordinates before the first gap wider than `gap` [m]."""
    x = np.sort(x.astype(float))
    gaps = np.flatnonzero(np.diff(x) > gap)
    return float(x[gaps[0]] if len(gaps) else x[-1])


def host(array: wp.array) -> Array:
    """Copy an array to the host as float64."""
    return array.numpy().astype(np.float64)


def record(
    solver: Solver | LatticeSolver | LiquidSolver,
    times: Sequence[float] | Array,
    measure: Callable[[], Any],
) -> Array:
    """Advance to each time [s], and return the values of `measure` at these times [T,...]."""
    values = []
    for time in times:
        solver.advance(float(time))
        values.append(measure())
    return np.array(values)


def mean_along(solver: Solver | LatticeSolver, of: str, axis: Sequence[float]) -> float:
    """Return the mass-weighted mean of `x` or `v` (named by `of`) along a unit vector [3]."""
    mass = host(solver.model.mass)
    return float(mass @ (host(getattr(solver.state, of)) @ np.array(axis, float)) / mass.sum())


def mean_acceleration(
    solver: Solver | LatticeSolver, axis: Sequence[float], start: float, times: Array
) -> float:
    """Return the acceleration of the centre of mass along an axis, by a fitted parabola [m/s^2].

    Args:
        solver: The solver, which is advanced to the last time.
        axis: Unit vector [3].
        start: Time of the first sample [s].
        times: Times of the samples after the start [T], s.
    """
    places = record(solver, start + times, lambda: mean_along(solver, "x", axis))
    return float(2 * np.polyfit(times, places, 2)[0])


def find_zeros(times: Array, values: Array) -> Array:
    """Return the times [Z] at which a signal [T] changes its sign, by linear interpolation."""
    after = np.flatnonzero(np.diff(np.sign(values)) != 0)
    return times[after] - values[after] * np.diff(times)[after] / np.diff(values)[after]
