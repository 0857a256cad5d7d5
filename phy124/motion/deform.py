"""Moves the Gaussians with the material: computes a frame from particle state and rest Gaussians.

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
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

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
"""Mean number of particles in a cell of their bounding box, and largest number of cells per axis,
in the search for the particles that carry each Gaussian.
"""
THREADS = "shapes"
"""Prefix of the names of the threads that process the Gaussians."""
FARTHEST = 4.0
"""Distance, in mean distances of particles, beyond which a particle carries only Gaussians without
a nearer particle, because the grid does not connect material so far apart.
"""


class Deformer:
    """Computes the frames of one moving object; call it once per frame, in order of time.

    With the binding `particles`, each Gaussian moves with its own particle. With `lattice`, the
    nearest particles of the lattice carry the Gaussian: x_g = sum w_i (x_i + F_i (X_g - X_i)) and
    F_g = sum w_i F_i, with smooth weights w that sum to 1. This is exact for every affine motion.
    For fluid and granular materials it is exact only while the arms F_i (X_g - X_i) are at most
    twice as long as at rest.
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
        bound: NDArray | None = None,
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
            bound: Index of each Gaussian's own particle [N]; None: as the particles say.
            device: Warp device of the computation.
            threads: Number of CPU threads that process the Gaussians; it does not change the
                result.

        Raises:
            InputError: `max_stretch` is below 1.
            ValueError: The particles belong to other Gaussians.
        """
        limits = np.asarray(np.inf if max_stretch is None else max_stretch, np.float64)
        if not (limits >= 1).all():
            limit = "Gaussians must be allowed at least their size at rest."
            least = float(np.nanmin(limits))
            raise InputError("max_stretch", least, limit, "Give 1 or more, or leave it out.")
        self.gaussians = gaussians
        self.rotations: Array | None = None
        """Polar rotations of the material at the last frame [N,4] wxyz; None if sh degree is 0."""
        n = len(gaussians)
        self._share = _Share(n, device, threads)
        self._device = device
        self._max_stretch = wp.array(
            np.broadcast_to(limits, n).copy(), dtype=wp.float64, device=device
        )
        balls = np.zeros(n, bool) if rounds is None else rounds
        self._rounds = wp.array(balls, dtype=wp.bool, device=device)
        most = np.full(n, np.inf) if holds is None else holds
        self._holds = wp.array(most, dtype=wp.float64, device=device)
        bound = _bound_particles(n, particles) if bound is None else bound
        if bound is None and particles is not None:
            self._motion = _Field(gaussians, particles, flows, self._share)
        else:
            self._motion = _Bound(np.arange(n) if bound is None else bound, self._share)
        self._count = n if particles is None else len(particles.x)
        self._broken = wp.zeros(2, dtype=wp.int32, device=device)
        self._carrier = wp.array(np.arange(n), dtype=wp.int32, device=device)
        self._quats0 = wp.array(gaussians.quats, dtype=wp.vec4f, device=device)
        self._scales0 = wp.array(gaussians.scales, dtype=wp.vec3f, device=device)
        self._quats = wp.clone(self._quats0)
        self._scales = wp.clone(self._scales0)
        identity = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
        self._inner = wp.array(identity, dtype=wp.vec4f, device=device)
        self._turned = wp.array(identity, dtype=wp.vec4f, device=device)

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
        means, deformation = self._motion.carry(x, F)
        limits = [self._holds, self._max_stretch, self._rounds]
        rest = [self._carrier, self._quats0, self._scales0, *limits]
        frame = [self._inner, self._quats, self._scales]
        kernel, each = shapes_of(self._device)
        self._share.launch(kernel, rest, [deformation], frame, each=each)
        sh = self._colours(deformation, colours)
        quats, scales = _copy(self._quats), _copy(self._scales)
        gaussians = replace(self.gaussians, means=_copy(means), quats=quats, scales=scales, sh=sh)
        if velocities is not None:
            velocities = _host(velocities).astype(np.float64)
            self._refuse_other_shape(velocities.shape, (3,))
            broken = int((~np.isfinite(velocities).all(axis=1)).sum())
            self._refuse_broken(broken)
            velocities = self._motion.interpolate(velocities)
        return Frame(index, time, gaussians, velocities)

    @property
    def carriers(self) -> NDArray[np.int32]:
        """Indices of the particles that carry Gaussians [C]."""
        carry = np.zeros(self._count, bool)
        carry[self._motion.carriers] = True
        return np.flatnonzero(carry).astype(np.int32)

    def snapshot(self) -> dict[str, NDArray]:
        """Return the axes from which the next frame continues."""
        return {name: array.numpy().copy() for name, array in self._axes().items()}

    def restore(self, snapshot: dict[str, NDArray]) -> None:
        """Return to the state right after the frame at which a snapshot was taken."""
        for name, array in self._axes().items():
            array.assign(snapshot[name])

    def _axes(self) -> dict[str, wp.array]:
        arrays = (self._quats, self._scales, self._inner, self._turned)
        return dict(zip(("quats", "scales", "inner", "turned"), arrays, strict=True))

    def _upload(self, x: Any, F: Any) -> tuple[wp.array, wp.array]:
        """Return positions and F on the device, in the precision of F, after a check of both."""
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

    def _colours(self, deformation: wp.array, rotated: bool) -> NDArray:
        rest = self.gaussians
        if rest.sh_degree == 0:
            return rest.sh
        self._share.launch(field.turn_of_material, [self._carrier], [deformation], [self._turned])
        self.rotations = turned = _copy(self._turned)
        still = not rotated or (turned == (1, 0, 0, 0)).all()
        return rest.sh if still else rotate_sh(rest.sh, turned)


class _Share:
    """Launches over Gaussians, divided among CPU threads.

    The threads are reused, because new threads for every launch often all started on one core.
    """

    def __init__(self, count: int, device: str, threads: int) -> None:
        self.device = device
        threads = max(1, min(threads, count)) if device == "cpu" else 1
        self._runs = [
            slice(count * k // threads, count * (k + 1) // threads) for k in range(threads)
        ]
        self._others = ThreadPoolExecutor(threads - 1, THREADS) if threads > 1 else None

    def launch(
        self, kernel: Any, read: list, shared: list, written: list, *, each: int = 1
    ) -> None:
        """Launch a kernel over the Gaussians.

        Args:
            kernel: The kernel.
            read: First arguments, with one entry per Gaussian.
            shared: Next arguments, of which a Gaussian may read any entry.
            written: Last arguments, with one entry per Gaussian.
            each: Number of Gaussians that a thread of the kernel processes.
        """
        launches: list[Any] = [
            wp.launch(
                kernel,
                dim=-(-(run.stop - run.start) // each),
                inputs=[*(a[run] for a in read), *shared, *(a[run] for a in written)],
                device=self.device,
                record_cmd=True,
            )
            for run in self._runs
        ]
        # Recording a launch loads its kernel, which several threads must not do at the same time.
        first, *others = launches
        started = [self._others.submit(item.launch) for item in others] if self._others else []
        first.launch()
        for future in started:
            future.result()


class _Bound:
    """Gaussians that each follow a particle of their own."""

    def __init__(self, particle: NDArray, share: _Share) -> None:
        """Store the index of each Gaussian's particle [N]."""
        n, device, self._share = len(particle), share.device, share
        self.carriers = self.particle = particle
        self._particle = wp.array(particle, dtype=wp.int32, device=device)
        self._means = wp.array(np.zeros((n, 3)), dtype=wp.vec3f, device=device)
        self._deformation = wp.array(np.zeros((n, 3, 3)), dtype=wp.mat33d, device=device)

    def carry(self, x: wp.array, F: wp.array) -> tuple[wp.array, wp.array]:
        """Return centres [N,3], m, and deformation gradients [N,3,3] of the Gaussians."""
        kernel, written = field.make_follow(_precision(F)), [self._means, self._deformation]
        self._share.launch(kernel, [self._particle], [x, F], written)
        return self._means, self._deformation

    def interpolate(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the values [N,3] of each Gaussian's particle."""
        return values[self.particle].astype(np.float32)


class _Field:
    """Gaussians carried by nearby particles; neighbours and weights are computed once, at rest."""

    def __init__(
        self, gaussians: Gaussians, particles: Particles, flows: NDArray | None, share: _Share
    ) -> None:
        self.neighbours, self.weights = _carriers_of(gaussians, particles)
        self.carriers = self.neighbours
        n, device = len(gaussians), share.device
        self.device, self._share = device, share
        self._carried = [
            wp.array(self.neighbours, dtype=wp.int32, device=device),
            wp.array(self.weights, dtype=wp.float32, device=device),
            wp.array(gaussians.means, dtype=wp.vec3f, device=device),
            wp.array(np.zeros(n, bool) if flows is None else flows, dtype=wp.bool, device=device),
        ]
        self._rest = wp.array(particles.x, dtype=wp.vec3f, device=device)
        self._means = wp.empty_like(self._carried[2])
        self._deformation = wp.array(np.zeros((n, 3, 3)), dtype=wp.mat33d, device=device)

    def carry(self, x: wp.array, F: wp.array) -> tuple[wp.array, wp.array]:
        """Return centres [N,3], m, and deformation gradients [N,3,3] of the Gaussians."""
        # Particles keep their precision; the kernel converts the values that it reads.
        shared, written = [self._rest, x, F], [self._means, self._deformation]
        kernel = field.make_carry(_precision(F))
        self._share.launch(kernel, self._carried, shared, written)
        return self._means, self._deformation

    def interpolate(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return weighted means [N,3] of values on the particles [P,3]."""
        out = np.zeros((len(self.weights), 3))
        for k in range(self.weights.shape[1]):
            out += self.weights[:, k, None] * values[self.neighbours[:, k]]
        return out.astype(np.float32)


def _carriers_of(
    gaussians: Gaussians, particles: Particles
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return each Gaussian's carriers [N,K], from its own object, and their weights [N,K]."""
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
    index, weights = carriers(means, x, FARTHEST * np.cbrt(volume.mean()))
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
    _Share(len(points), "cpu", cores()).launch(
        find_carriers,
        [wp.array(ordered, dtype=wp.vec3, device="cpu", copy=False)],
        [*shared, *numbers],
        written,
    )
    return neighbours, weights


def _bound_particles(count: int, particles: Particles | None) -> NDArray[np.int32] | None:
    """Return each Gaussian's particle [N]; None if they are in order, or with `lattice`."""
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


def _copy(array: wp.array) -> NDArray:
    """Return a NumPy copy of a Warp array."""
    device: Any = array.device
    # A GPU's array is copied by the transfer itself.
    return array.numpy() if device.is_cuda else array.numpy().copy()


def _precision(F: Any) -> Any:
    """Return Warp's type of the numbers of deformation gradients: float32 or else float64."""
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
    """Return for each Gaussian the value [N] of its particle, or of the nearest particle [P]."""
    # Equal values, for example of a single material, need no search.
    if len(values) and (values == values[0]).all():
        return np.repeat(values[:1], len(gaussians), axis=0)
    particle = _bound_particles(len(gaussians), particles)
    if particle is None:
        particle = np.zeros(len(gaussians), np.int64)
        for ours, theirs in by_object(gaussians, particles):
            nearest = scipy.spatial.KDTree(particles.x[theirs]).query(
                gaussians.means[ours], workers=-1
            )[1]
            particle[ours] = theirs[nearest]
    return values[particle]


def shapes_of(device: str) -> tuple[Any, int]:
    """Return the kernel that deforms shapes, and the number of Gaussians per kernel thread."""
    return (field.deform_shapes_simd, 8) if device == "cpu" else (field.deform_shapes, 1)


def kernels(real: Any, binding: str, device: str) -> list[Any]:
    """Return the kernels that deform the Gaussians of a frame."""
    bound = [field.make_carry(real), find_carriers] if binding == "lattice" else []
    carry = bound or [field.make_follow(real)]
    return [shapes_of(device)[0], *carry, field.make_count_broken(real)]
