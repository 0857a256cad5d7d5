"""Moves the Gaussians with the material: a frame follows from particles and Gaussians at rest.

Phy124 (arXiv 2409.07179): Sigma_t = F Sigma_0 F^T with the total F; then Sigma = Q Lambda Q^T gives
the rotation and the scales of the 4D representation. Here the axes are computed from A = F R_0 S_0
(Sigma = A A^T), once per frame and in float64, never from an integrated Sigma. This preserves thin
axes and positive definiteness (`phy124.kernels.deform`).

Orientations are continuous: of all labellings of the axes (24 proper signed permutations), the one
closest to the previous frame is chosen, with q . q_previous >= 0. Axes of equal length move with
the material, to within 1e-5 of the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Array, Frame, Gaussians, Particles, by_object, rotate_sh
from phy124.kernels import deform as field
from phy124.kernels.arguments import types
from phy124.kernels.carriers import CARRIERS, find_carriers
from phy124.runtime.cores import cores

PER_CELL, MOST_CELLS = 2, 256
"""Parameters of the search for the particles that carry each Gaussian: mean number of particles in
a cell of their bounding box, and largest number of cells per axis.
"""
BLOCK = 1 << 15
"""Number of Gaussians that a CPU thread processes at once."""
DEFORMATION = "F"
"""Placeholder for the deformation gradients of the Gaussians in the arguments of a step."""
THREADS = "shapes"
"""Prefix of the names of the threads that process the Gaussians."""
FARTHEST = 4.0
"""Distance, in mean distances of particles, beyond which a particle carries a Gaussian only if no
particle is nearer, because the grid does not connect material so far apart.
"""


class Deformer:
    """Computes the frames of one moving object; to be called once per frame, in order of time.

    With the binding `particles`, each Gaussian moves with its own particle. With `lattice`, the
    nearest particles of the lattice carry the Gaussian: x_g = sum w_i (x_i + F_i (X_g - X_i)) and
    F_g = sum w_i F_i, with smooth weights w that sum to 1. This is exact for every affine motion;
    for fluid and granular materials, only while the arms F_i (X_g - X_i) are at most twice as long
    as at rest.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        particles: Particles | None = None,
        *,
        max_stretch: float | NDArray | None = None,
        rounds: NDArray | None = None,
        flows: NDArray | None = None,
        holds: NDArray | None = None,
        binding: Binding | None = None,
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        """Bind clean Gaussians to the particles made from them.

        Args:
            gaussians: The object at rest, N Gaussians.
            particles: The particles that `make_particles` made from the Gaussians; None: one
                particle per Gaussian, in order.
            max_stretch: Longest axis allowed, relative to the longest axis at rest, for all
                Gaussians or for each [N]; for fluid and plastic material, whose F grows without
                bound. None: no limit.
            rounds: Mask of the Gaussians that become balls when they are stretched [N], so that
                fluids show no needles; None: none do.
            flows: Mask of the Gaussians of fluid or granular material [N], whose F grows without
                bound; None: none are.
            holds: Largest stretch of each Gaussian's material [N]. If F is larger, the material is
                torn, and its Gaussians are drawn with this stretch; None: no limit.
            binding: Particles that carry each Gaussian, if they are known.
            device: Warp device of the computation.
            threads: Number of CPU threads that process the Gaussians; it does not change the
                result.

        Raises:
            InputError: `max_stretch` is below 1.
            ValueError: The particles belong to other Gaussians.
        """
        limits = np.asarray(np.inf if max_stretch is None else max_stretch, np.float64)
        if not (limits >= 1).all():
            limit = "Gaussians would have to be smaller than they are at rest."
            least = float(np.nanmin(limits))
            raise InputError("max_stretch", least, limit, "Give 1 or more, or leave it out.")
        self.gaussians = gaussians
        self.rotations: Array | None = None
        """Polar rotations of the material in the last frame [N,4] wxyz; None if sh has degree 0."""
        n = len(gaussians)
        self.binding = bind(gaussians, particles) if binding is None else binding
        self._device, self._share = device, _Share(n, device, threads)
        block = self._share.block
        self._count = n if particles is None else len(particles.x)
        self._broken = wp.zeros(2, dtype=wp.int32, device=device)

        def constant(values: Any, dtype: Any) -> wp.array:
            """Return an array on the device; if all values are equal, only one block of it."""
            values = np.broadcast_to(values, n)
            if n > block and (values.strides == (0,) or (values == values[0]).all()):
                values = np.repeat(values[:1], block)
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        self._limits = [
            constant(np.inf if holds is None else holds, wp.float64),
            constant(limits, wp.float64),
            constant(False if rounds is None else rounds, wp.bool),
        ]
        self._quats0 = self._alias(gaussians.quats, wp.vec4f)
        self._scales0 = self._alias(gaussians.scales, wp.vec3f)
        neighbours, weights = self.binding
        if weights is None:
            self._carried = [self._alias(neighbours, wp.int32)]
        else:
            assert particles is not None
            far = constant(False if flows is None else flows, wp.bool)
            means = self._alias(gaussians.means, wp.vec3f)
            self._carried = [self._alias(neighbours, wp.int32), self._alias(weights, wp.float32)]
            self._carried += [means, far]
            self._rest = wp.array(particles.x, dtype=wp.vec3f, device=device)
        quaternion: Any = wp.vec4f
        self._inner = wp.empty(n, dtype=quaternion, device=device)
        self._turned = wp.empty(n if gaussians.sh_degree else 0, dtype=quaternion, device=device)
        # One frame's axes continue those of the frame before, whose arrays are not changed.
        self._quats = self._quats0
        self.reset()

    def reset(self) -> None:
        """Return to the state before the first frame."""
        self._quats = self._quats0
        for array in (self._inner, self._turned):
            array.fill_(wp.vec4f(1.0, 0.0, 0.0, 0.0))

    def __call__(
        self,
        x: Any,
        F: Any,
        *,
        index: int,
        time: float,
        velocities: Any = None,
        colours: bool = True,
    ) -> Frame:
        """Return the frame at a given time.

        Args:
            x: Positions of the particles [P,3], m; a NumPy or Warp array.
            F: Their total deformation gradients [P,3,3].
            index: Number of the frame.
            time: Time [s].
            velocities: Velocities of the particles [P,3], m/s, if the frame is to include them.
            colours: Whether colours are rotated with the material.

        Raises:
            FloatingPointError: A position or F is not finite; the message says how many.
            ValueError: The arrays do not match the number of particles.
        """
        x, F = self._upload(x, F)
        n, device = len(self.gaussians), self._device
        vec3: Any = wp.vec3f
        vec4: Any = wp.vec4f
        means, scales = (wp.empty(n, dtype=vec3, device=device) for _ in range(2))
        quats = wp.empty(n, dtype=vec4, device=device)
        real = _precision(F)
        if self.binding.weights is None:
            carry, shared = field.make_follow(real), [x, F]
        else:
            # Particles keep their precision; the kernel converts the values that it reads.
            carry, shared = field.make_carry(real), [self._rest, x, F]
        shapes, each = shapes_of(device)
        rest = [self._quats0, self._scales0, *self._limits, self._quats]
        steps = [
            Step(carry, self._carried, shared, [means, DEFORMATION]),
            Step(shapes, rest, [DEFORMATION], [self._inner, quats, scales], each),
        ]
        if self.gaussians.sh_degree:
            steps.append(Step(field.turn_of_material, [DEFORMATION], [], [self._turned]))
        self._share.run(steps)
        self._quats = quats
        frame = replace(
            self.gaussians,
            means=_host(means),
            quats=_host(quats),
            scales=_host(scales),
            sh=self._colours(colours),
        )
        if velocities is not None:
            velocities = _host(velocities).astype(np.float64)
            self._refuse_other_shape(velocities.shape, (3,))
            broken = int((~np.isfinite(velocities).all(axis=1)).sum())
            self._refuse_broken(broken)
            velocities = self.binding.interpolate(velocities)
        return Frame(index, time, frame, velocities)

    @property
    def carriers(self) -> NDArray[np.int32]:
        """Indices of the particles that carry Gaussians [C]."""
        carry = np.zeros(self._count, bool)
        carry[self.binding.particles] = True
        return np.flatnonzero(carry).astype(np.int32)

    def snapshot(self) -> dict[str, NDArray]:
        """Return the axes of the Gaussians, from which the next frame continues."""
        return {name: array.numpy().copy() for name, array in self._axes().items()}

    def restore(self, snapshot: dict[str, NDArray]) -> None:
        """Return to the state right after the frame at which a snapshot was taken."""
        self._quats = wp.array(snapshot["quats"], dtype=wp.vec4f, device=self._device)
        self._inner.assign(snapshot["inner"])
        if self.gaussians.sh_degree:
            self._turned.assign(snapshot["turned"])

    def _axes(self) -> dict[str, wp.array]:
        turned = {"turned": self._turned} if self.gaussians.sh_degree else {}
        return {"quats": self._quats, "inner": self._inner, **turned}

    def _alias(self, array: NDArray, dtype: Any) -> wp.array:
        """Return an array on the device, without a copy on a CPU."""
        return wp.array(array, dtype=dtype, device=self._device, copy=False)

    def _upload(self, x: Any, F: Any) -> tuple[wp.array, wp.array]:
        """Check positions and F, and return them on the device, in the precision of F."""
        for array, shape in ((x, (3,)), (F, (3, 3))):
            values = array if isinstance(array, wp.array) else np.asarray(array)
            inner: Any = getattr(array.dtype, "_shape_", ())
            self._refuse_other_shape((*values.shape, *inner), shape)
        real = _precision(F)
        t = types(real)
        x, F = _on(x, t.vec3, self._device), _on(F, t.mat33, self._device)
        self._broken.zero_()
        kernel = field.make_count_broken(real)
        wp.launch(kernel, self._count, [x, F], [self._broken], device=self._device)
        for broken in self._broken.numpy().tolist():
            self._refuse_broken(broken)
        return x, F

    def _refuse_other_shape(self, shape: tuple[int, ...], inner: tuple[int, ...]) -> None:
        if shape != (self._count, *inner):
            raise ValueError(f"got an array {shape} for {self._count} particles")

    def _refuse_broken(self, broken: int) -> None:
        if broken:
            raise FloatingPointError(f"{broken} of {self._count} particles are NaN or infinite")

    def _colours(self, rotated: bool) -> NDArray:
        rest = self.gaussians
        if rest.sh_degree == 0:
            return rest.sh
        self.rotations = turned = _host(self._turned).copy()
        still = not rotated or (turned == (1, 0, 0, 0)).all()
        return rest.sh if still else rotate_sh(rest.sh, turned)


class Step(NamedTuple):
    """A kernel that is launched over the Gaussians."""

    kernel: Any
    mine: list[Any]
    """First arguments: arrays with an entry for each Gaussian; `DEFORMATION` stands for F."""
    shared: list[Any]
    """Next arguments: arrays of which each Gaussian may read any entry."""
    out: list[Any]
    """Last arguments: arrays with an entry for each Gaussian."""
    each: int = 1
    """Number of Gaussians that a thread of the kernel processes."""


class _Share:
    """Launches kernels over the Gaussians in blocks that are divided among CPU threads.

    The deformation gradients of a block stay in the cache from one step to the next. The threads
    are reused, because new threads for every launch often all started on one core.
    """

    def __init__(self, count: int, device: str, threads: int) -> None:
        self.device, self._count = device, count
        threads = max(1, min(threads, count)) if device == "cpu" else 1
        self._runs = [
            range(count * k // threads, count * (k + 1) // threads) for k in range(threads)
        ]
        matrix: Any = wp.mat33d
        self.block = BLOCK if device == "cpu" else max(count, 1)
        most = min(self.block, max(len(run) for run in self._runs))
        self._deformation = [wp.empty(most, dtype=matrix, device=device) for _ in range(threads)]
        self._others = ThreadPoolExecutor(threads - 1, THREADS) if threads > 1 else None

    def run(self, steps: Sequence[Step]) -> None:
        """Run all steps for each block of Gaussians."""
        work = [
            [
                self._record(step, range(first, min(first + self.block, run.stop)), F)
                for first in range(run.start, run.stop, self.block)
                for step in steps
            ]
            for run, F in zip(self._runs, self._deformation, strict=True)
        ]
        # Recording a launch loads its kernel, which several threads must not do at the same time.
        first, *others = work
        started = [self._others.submit(_launch, items) for items in others] if self._others else []
        _launch(first)
        for future in started:
            future.result()

    def _record(self, step: Step, block: range, F: wp.array) -> Any:
        """Return the launch of a step for a block of Gaussians."""
        count = len(block)

        def part(array: Any) -> Any:
            if isinstance(array, str):
                return F[:count]
            whole = len(array) == self._count
            return array[block.start : block.stop] if whole else array[:count]

        mine, out = ([part(array) for array in arrays] for arrays in (step.mine, step.out))
        shared = [F[:count] if isinstance(array, str) else array for array in step.shared]
        return wp.launch(
            step.kernel,
            dim=-(-count // step.each),
            inputs=[*mine, *shared, *out],
            device=self.device,
            record_cmd=True,
        )


def _launch(launches: list[Any]) -> None:
    for launch in launches:
        launch.launch()


class Binding(NamedTuple):
    """The particles that carry each Gaussian, and their weights."""

    particles: NDArray[np.int32]
    """Indices of the K particles of each Gaussian [N,K], or of its single particle [N]."""
    weights: NDArray[np.float32] | None
    """Weights that sum to 1 [N,K]; None if each Gaussian follows a single particle."""

    def interpolate(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return weighted means [N,3] of values on the particles [P,3]."""
        if self.weights is None:
            return values[self.particles].astype(np.float32)
        out = np.zeros((len(self.weights), 3))
        for k in range(self.weights.shape[1]):
            out += self.weights[:, k, None] * values[self.particles[:, k]]
        return out.astype(np.float32)

    def select(self, chosen: NDArray) -> Binding:
        """Return the binding of some Gaussians."""
        return Binding(
            self.particles[chosen], None if self.weights is None else self.weights[chosen]
        )


def bind(gaussians: Gaussians, particles: Particles | None) -> Binding:
    """Find the particles that carry each Gaussian.

    Raises:
        ValueError: The particles belong to other Gaussians.
    """
    if particles is None:
        return Binding(np.arange(len(gaussians), dtype=np.int32), None)
    bound = _bound_particles(len(gaussians), particles)
    return Binding(*_carriers_of(gaussians, particles)) if bound is None else Binding(bound, None)


def _carriers_of(
    gaussians: Gaussians, particles: Particles
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return each Gaussian's carriers [N,K], which are of its object, and their weights [N,K]."""
    if particles.body is None or gaussians.object_id is None:
        return _carriers_within(gaussians.means, particles.x, particles.volume)
    neighbours = np.zeros((len(gaussians), CARRIERS), np.int32)
    weights = np.zeros((len(gaussians), CARRIERS), np.float32)
    for ours, theirs in by_object(gaussians, particles):
        means, x, volume = gaussians.means[ours], particles.x[theirs], particles.volume[theirs]
        index, weights[ours] = _carriers_within(means, x, volume)
        neighbours[ours] = theirs[index]
    return neighbours, weights


def _carriers_within(
    means: NDArray, x: NDArray, volume: NDArray
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the carriers [N,K] and weights [N,K] of the Gaussians of one object."""
    # Rounded, so that equal volumes and their mean give the same weights.
    index, weights = carriers(means, x, float(np.float32(FARTHEST * np.cbrt(volume.mean()))))
    if len(x) < CARRIERS:
        # Few particles do not determine the motion far from them: use the nearest one alone.
        weights[:] = np.eye(1, CARRIERS)
    return index, weights


def carriers(
    points: NDArray, particles: NDArray, farthest: float = math.inf
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the nearest particles of each point [N,K] and their weights [N,K], which sum to 1.

    w = (1 - (d / R)^2)^2. R is the distance of the nearest particle that is not chosen. R is at
    most twice the distance of the farthest chosen particle, and at most the larger of `farthest`
    and twice the distance of the nearest particle [m]. The weights vary smoothly over the points,
    since a particle enters and leaves the chosen set with weight 0. With fewer than K particles,
    the last weights are 0.
    """
    low, high = particles.min(axis=0).astype(np.float64), particles.max(axis=0)
    extent = np.maximum(high - low, 1e-9)
    cell = max(float(np.cbrt(extent.prod() * PER_CELL / len(particles))), extent.max() / MOST_CELLS)
    shape = np.floor(extent / cell).astype(np.int64) + 1
    place = np.minimum(((particles - low) / cell).astype(np.int64), shape - 1)
    flat = np.ravel_multi_index(tuple(place.T), tuple(shape))
    order = np.argsort(flat, kind="stable").astype(np.int32)
    starts = np.zeros(shape.prod() + 1, np.int32)
    np.cumsum(np.bincount(flat, minlength=shape.prod()), out=starts[1:])
    neighbours = np.empty((len(points), CARRIERS), np.int32)
    weights = np.empty((len(points), CARRIERS), np.float32)
    ordered, sorted_x = (np.ascontiguousarray(a, np.float32) for a in (points, particles[order]))
    written: list[Any] = [wp.array(a, device="cpu", copy=False) for a in (neighbours, weights)]
    shared = [wp.array(sorted_x, dtype=wp.vec3, device="cpu", copy=False)]
    shared += [wp.array(a, device="cpu", copy=False) for a in (order, starts)]
    numbers = [wp.vec3i(*shape.tolist()), wp.vec3d(*low.tolist()), cell, min(farthest, 1e100)]
    mine = [wp.array(ordered, dtype=wp.vec3, device="cpu", copy=False)]
    _Share(len(points), "cpu", cores()).run(
        [Step(find_carriers, mine, [*shared, *numbers], written)]
    )
    return neighbours, weights


def _bound_particles(count: int, particles: Particles | None) -> NDArray[np.int32] | None:
    """Return the particle of each Gaussian [N]; None if they have the same order, or with
    `lattice`.
    """
    if particles is None or (particles.gaussian < 0).all():
        return None
    bound = np.flatnonzero(particles.gaussian >= 0)
    if not np.array_equal(np.sort(particles.gaussian[bound]), np.arange(count)):
        raise ValueError(f"the particles were not made from these {count} Gaussians")
    particle = np.empty(count, np.int32)
    particle[particles.gaussian[bound]] = bound
    return particle


def _host(array: Any) -> NDArray:
    """Return a NumPy view of a Warp array, or of any array-like object."""
    return np.asarray(array.numpy() if isinstance(array, wp.array) else array)


def _precision(F: Any) -> Any:
    """Return Warp's type of the numbers in deformation gradients: float32 or float64."""
    number = F.dtype._wp_scalar_type_ if isinstance(F, wp.array) else np.asarray(F).dtype
    return wp.float32 if number in (wp.float32, np.float32) else wp.float64


def _on(array: Any, dtype: Any, device: str) -> wp.array:
    """Return a Warp array of a type on a device, without a copy if no conversion is needed."""
    if (
        isinstance(array, wp.array)
        and array.dtype is dtype
        and array.device == wp.get_device(device)
    ):
        return array
    return wp.array(np.ascontiguousarray(_host(array)), dtype=dtype, device=device)


def of_gaussians(gaussians: Gaussians, particles: Particles, values: NDArray) -> NDArray:
    """Return each Gaussian's value [N], of its particle or the nearest one, from values [P]."""
    # Equal values, for example of a single material, need no search.
    if len(values) and (values == values[0]).all():
        return np.repeat(values[:1], len(gaussians), axis=0)
    particle = _bound_particles(len(gaussians), particles)
    if particle is None:
        particle = np.zeros(len(gaussians), np.int64)
        for ours, theirs in by_object(gaussians, particles):
            tree = scipy.spatial.KDTree(particles.x[theirs])
            particle[ours] = theirs[tree.query(gaussians.means[ours], workers=-1)[1]]
    return values[particle]


def shapes_of(device: str) -> tuple[Any, int]:
    """Return the kernel that deforms shapes, and the number of Gaussians per kernel thread."""
    return (field.deform_shapes_simd, 8) if device == "cpu" else (field.deform_shapes, 1)


def kernels(real: Any, binding: str, device: str) -> list[Any]:
    """Return the kernels that deform the Gaussians of a frame."""
    bound = [field.make_carry(real), find_carriers] if binding == "lattice" else []
    carry = bound or [field.make_follow(real)]
    return [shapes_of(device)[0], *carry, field.make_count_broken(real)]
