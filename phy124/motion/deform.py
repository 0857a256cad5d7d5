"""Moves Gaussians with the material: computes a frame from particles and the Gaussians at rest.

Let F be the total deformation gradient. The paper (Phy124, arXiv 2409.07179) decomposes the
covariance `Sigma_t = F Sigma_0 F^T = Q Lambda Q^T` into rotation and scales. This module instead
computes the axes from `A = F R_0 S_0` (`Sigma = A A^T`), once per frame and in float64, which
preserves thin axes and positive definiteness (`phy124.kernels.deform`).

Orientations are continuous. Among the 24 proper signed permutations of the axes, the permutation
closest to the previous frame is chosen. The sign of each quaternion is chosen so that its product
with the previous quaternion is not negative. Axes of equal length rotate with the material; the
relative change of the covariance is at most 1e-5.
"""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Array, Frame, Gaussians, Particles, rotate_sh
from phy124.kernels import carriers, deform
from phy124.kernels.arguments import types
from phy124.motion.binding import Binding, bind
from phy124.motion.blocks import DEFORMATION, BlockLauncher, Step


class Deformer:
    """Computes the frames of one moving object; call once per frame, in order of time.

    With the binding `particles`, each Gaussian moves with one particle. With `lattice`, the nearest
    particles of the lattice carry the Gaussian: `x_g = sum w_i (x_i + F_i (X_g - X_i))` and `F_g =
    sum w_i F_i`, with smooth weights w that sum to 1. The interpolation is exact for every affine
    motion. For fluid and granular materials, the interpolation is exact only while the vectors `F_i
    (X_g - X_i)` are at most twice as long as at rest. If such material mixes and the particles
    separate, the Gaussian follows only the nearest particle.
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
            particles: The particles made from the Gaussians; None: one particle per Gaussian, in
                order.
            max_stretch: Largest allowed stretch of the longest axis; a number, or a value per
                Gaussian [N]. Fluid and plastic material need a limit, because their F grows without
                bound. None: no limit.
            rounds: Mask of the Gaussians that become balls when they are stretched [N], so that
                fluids do not look like needles; None: no Gaussians.
            flows: Mask of the Gaussians of fluid or granular material [N], whose F grows without
                bound; None: no Gaussians.
            holds: Largest stretch of the material with which each Gaussian is drawn [N]; torn
                material is stretched further. None: no limit.
            binding: Particles that carry each Gaussian, if already known.
            device: Warp device of the computation.
            threads: Number of CPU threads; does not affect the result.

        Raises:
            InputError: `max_stretch` is below 1.
            ValueError: The particles belong to other Gaussians.
        """
        limits = np.asarray(np.inf if max_stretch is None else max_stretch, np.float64)
        if not (limits >= 1).all():
            limit = "Gaussians would have to be smaller than they are at rest."
            least = float(np.nanmin(limits))
            raise InputError("max_stretch", least, limit, "Choose at least 1, or omit max_stretch.")
        self.gaussians = gaussians
        self.rotations: Array | None = None
        """Polar rotations of the material in the last frame [N,4] wxyz; None if sh has degree 0."""
        n = len(gaussians)
        self.binding = bind(gaussians, particles) if binding is None else binding
        self._device, self._blocks = device, BlockLauncher(n, device, threads)
        block = self._blocks.block
        self._count = n if particles is None else len(particles.x)
        self._broken = wp.zeros(2, dtype=wp.int32, device=device)

        def constant(values: Any, dtype: Any) -> wp.array:
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
        # The axes start from the axes of the previous frame, whose arrays are not changed.
        self._quats = self._quats0
        self.reset()

    def reset(self) -> None:
        """Forget all frames, so that the next frame is computed as the first frame."""
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
            F: Total deformation gradients of the particles [P,3,3].
            index: Number of the frame.
            time: Time [s].
            velocities: Velocities of the particles [P,3], m/s, if the frame should contain
                velocities.
            colours: Whether colours are rotated with the material.

        Raises:
            FloatingPointError: A position or F is not finite; the message contains the number of
                such particles.
            ValueError: The arrays do not match the number of particles.
        """
        x, F = self._upload(x, F)
        n, device = len(self.gaussians), self._device
        vec3: Any = wp.vec3f
        vec4: Any = wp.vec4f
        means, scales = (wp.empty(n, dtype=vec3, device=device) for _ in range(2))
        quats = wp.empty(n, dtype=vec4, device=device)
        real = _precision(F)
        lattice = self.binding.weights is not None
        carry = carry_of(real, lattice=lattice)
        alone = [wp.empty(n, dtype=float, device=device)] if lattice else []
        # Particles keep their precision; the kernel converts the values that it reads.
        shared = [self._rest, x, F] if lattice else [x, F]
        shapes, each = shapes_of(device)
        rest = [self._quats0, self._scales0, *self._limits, self._quats]
        steps = [
            Step(carry, self._carried, shared, [means, DEFORMATION, *alone]),
            Step(shapes, rest, [DEFORMATION], [self._inner, quats, scales], each),
        ]
        if self.gaussians.sh_degree:
            steps.append(Step(deform.turn_of_material, [DEFORMATION], [], [self._turned]))
        self._blocks.run(steps)
        self._quats = quats
        frame = replace(
            self.gaussians,
            means=host(means),
            quats=host(quats),
            scales=host(scales),
            sh=self._colours(colours),
        )
        if velocities is not None:
            velocities = host(velocities).astype(np.float64)
            self._refuse_other_shape(velocities.shape, (3,))
            broken = int((~np.isfinite(velocities).all(axis=1)).sum())
            self._refuse_broken(broken)
            velocities = self.binding.interpolate(velocities, *map(host, alone))
        return Frame(index, time, frame, velocities)

    @cached_property
    def carriers(self) -> NDArray[np.int32]:
        """Indices of the particles that carry Gaussians [C]."""
        carry = np.zeros(self._count, bool)
        carry[self.binding.particles] = True
        return np.flatnonzero(carry).astype(np.int32)

    def snapshot(self) -> dict[str, NDArray]:
        """Return the Gaussians' axes, from which the next frame is computed."""
        axes = {"quats": self._quats, "inner": self._inner}
        if self.gaussians.sh_degree:
            axes["turned"] = self._turned
        return {name: array.numpy().copy() for name, array in axes.items()}

    def restore(self, snapshot: dict[str, NDArray]) -> None:
        """Restore a snapshot of the Gaussians' axes."""
        self._quats = wp.array(snapshot["quats"], dtype=wp.vec4f, device=self._device)
        self._inner.assign(snapshot["inner"])
        if self.gaussians.sh_degree:
            self._turned.assign(snapshot["turned"])

    def _alias(self, array: NDArray, dtype: Any) -> wp.array:
        return wp.array(array, dtype=dtype, device=self._device, copy=False)

    def _upload(self, x: Any, F: Any) -> tuple[wp.array, wp.array]:
        for array, shape in ((x, (3,)), (F, (3, 3))):
            values = array if isinstance(array, wp.array) else np.asarray(array)
            inner: Any = getattr(array.dtype, "_shape_", ())
            self._refuse_other_shape((*values.shape, *inner), shape)
        real = _precision(F)
        t = types(real)
        x, F = _on(x, t.vec3, self._device), _on(F, t.mat33, self._device)
        self._broken.zero_()
        kernel = deform.make_count_broken(real)
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
        self.rotations = turned = host(self._turned).copy()
        still = not rotated or (turned == (1, 0, 0, 0)).all()
        return rest.sh if still else rotate_sh(rest.sh, turned)


def host(array: Any) -> NDArray:
    """Return a NumPy view of a Warp array, or of any array-like object."""
    return np.asarray(array.numpy() if isinstance(array, wp.array) else array)


def _precision(F: Any) -> Any:
    number = F.dtype._wp_scalar_type_ if isinstance(F, wp.array) else np.asarray(F).dtype
    return wp.float32 if number in (wp.float32, np.float32) else wp.float64


def _on(array: Any, dtype: Any, device: str) -> wp.array:
    if (
        isinstance(array, wp.array)
        and array.dtype is dtype
        and array.device == wp.get_device(device)
    ):
        return array
    return wp.array(np.ascontiguousarray(host(array)), dtype=dtype, device=device)


def shapes_of(device: str) -> tuple[Any, int]:
    """Return the kernel that deforms shapes, and the number of Gaussians per kernel thread."""
    return (deform.deform_shapes_simd, 8) if device == "cpu" else (deform.deform_shapes, 1)


def carry_of(real: Any, *, lattice: bool) -> Any:
    """Return the kernel that moves Gaussians."""
    return deform.make_carry(real) if lattice else deform.make_follow(real)


def kernels(real: Any, binding: str, device: str) -> list[Any]:
    """Return the kernels that deform the Gaussians of a frame."""
    lattice = binding == "lattice"
    search = [carriers.find_carriers] if lattice else []
    carry = carry_of(real, lattice=lattice)
    return [shapes_of(device)[0], carry, *search, deform.make_count_broken(real)]
