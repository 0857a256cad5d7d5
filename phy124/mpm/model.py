"""Model and State: the constants of a run, and the arrays that every substep changes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.launches import record
from phy124.kernels.transfer import Law
from phy124.materials import Material
from phy124.mpm.kept import Kept
from phy124.mpm.timestep import CFL, ELASTIC_LIMIT, beside_elastic

PRECISIONS = {"float32": wp.float32, "float64": wp.float64}


@dataclass(frozen=True, eq=False)
class Group:
    """Consecutive particles of one body with the same constitutive law."""

    law: Law
    start: int
    stop: int
    theta: wp.array
    """Parameters of the group's law: one row for all particles, or one row per particle."""
    body: int = 0
    """Index of the body to which the group's particles belong."""

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def particles(self) -> slice:
        """Range of the indices of the group's particles among all particles."""
        return slice(self.start, self.stop)

    def rows(self, part: slice) -> wp.array:
        """Return the law's parameters for a range of the group's particles."""
        if len(self.theta) == 1:
            return self.theta
        return cast("wp.array", self.theta[part.start - self.start : part.stop - self.start])


@dataclass(frozen=True, eq=False)
class Model:
    """Particles, their materials and the grid's spacing; built by `Model.of`."""

    rest: NDArray[np.float64]
    """Positions of the particles at rest [P,3], m."""
    mass: wp.array
    """Masses of the particles [P], kg."""
    volume: wp.array
    """Volumes of the particles at rest [P], m^3."""
    history: NDArray[np.float64]
    """Initial history variables of the constitutive laws [P,2]."""
    groups: tuple[Group, ...]
    """Groups of particles, sorted by body and then by constitutive law."""
    materials: tuple[Material, ...]
    dx: float
    """Grid spacing [m]."""
    origin: tuple[float, float, float]
    """Position of node (0, 0, 0) of the grid [m]."""
    cfl: float
    """Length of a substep as a fraction of the elastic limit; some parameters of laws depend on
    this fraction.
    """
    precision: str
    """Precision of the run: float32 or float64."""
    device: str
    """Name of the Warp device, "cpu" or "cuda:0"."""
    form: str
    """Transfers between particles and grid: "simd" (float32 on the CPU), "plain" or "spline"."""
    held: frozenset[int] = frozenset()
    """Indices of the bodies that never move."""
    wet: frozenset[int] = frozenset()
    """Indices of the bodies that another solver moves: liquids, or bodies on lattices."""
    names: tuple[str, ...] = ()
    """Names of the bodies; empty if they have no names."""
    tops: Mapping[str, float] = field(default_factory=dict)
    """Height of the surface of each body on a lattice and of each free solid, by name [m]. The
    integration points of a lattice lie below its surface, and free solids have no particles.
    """
    free_mass: float = 0.0
    """Total mass of the free solids [kg]. A part of a divided model has none."""
    whole: Model | None = None
    """The model of all bodies, if this model contains only some of them. Boundaries are placed
    relative to all bodies of the scene.
    """
    least_stiffness: float = 1.0
    """Smallest factor on the Young's modulus E of any particle."""
    respond: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None
    """Function that returns the accelerations [P] caused by forces on the integration points of a
    lattice; None if the particles do not depend on each other.
    """

    @classmethod
    def of(
        cls,
        x: NDArray,
        volume: NDArray,
        materials: Sequence[Material],
        *,
        dx: float,
        material: NDArray | None = None,
        stiffness: NDArray | None = None,
        body: NDArray | None = None,
        held: Collection[int] = (),
        wet: Collection[int] = (),
        names: Sequence[str] = (),
        tops: Mapping[str, float] | None = None,
        free_mass: float = 0.0,
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        cfl: float = CFL,
        precision: str = "float32",
        device: str = "cpu",
        simd: bool = True,
        gradient: str = "affine",
    ) -> Model:
        """Copy the particles to the device.

        Args:
            x: Positions at rest [P,3], m.
            volume: Volumes at rest [P], m^3.
            materials: The materials of the particles.
            dx: Grid spacing [m].
            material: For each particle, its index into `materials` [P]; particles of one law must
                be consecutive. None: all particles have the first material.
            stiffness: Factors on Young's modulus E [P]; None: 1.
            body: Index of each particle's body [P], counted from 0 and increasing; particles of one
                law must be consecutive in each body. None: all particles are one body.
            held: Bodies that never move; they act like walls on the other bodies.
            wet: Bodies that another solver moves: liquids, or bodies on lattices.
            names: Names of the bodies, in the order of the indices.
            tops: Height of the surface of each body on a lattice and of each free solid, by name
                [m]; None: there are no such bodies.
            free_mass: Total mass of the free solids [kg].
            origin: Position of node (0, 0, 0) [m].
            cfl: Length of a substep as a fraction of the elastic limit, in (0, 1).
            precision: "float32" or "float64".
            device: Warp device.
            simd: Whether to use SIMD code if the device supports it.
            gradient: Velocity gradient for stress and strain: "affine", from the affine velocity
                around each particle, or "spline", from the gradients of the weights.

        Raises:
            ValueError: The particles are not sorted by body and law, or a particle has no volume.
        """
        real, count = PRECISIONS[precision], len(x)
        if not np.all(np.asarray(volume) > 0):
            raise ValueError("every particle needs a volume above zero")
        material = np.zeros(count, int) if material is None else material
        body = np.zeros(count, int) if body is None else np.asarray(body)
        density = np.array([section.density for section in materials])[material]
        groups = []
        for start, stop in _runs(materials, material, body):
            part = slice(start, stop)
            factors = None if stiffness is None else stiffness[part]
            theta = parameters(materials, material[part], factors, dx=dx, cfl=cfl)
            law = materials[material[start]].device_law
            rows = _array(theta, wp.types.vector(law.width, real), precision, device)
            groups.append(Group(law, start, stop, rows, int(body[start])))
        px, py, pz = (float(c) for c in origin)
        return cls(
            rest=np.asarray(x, dtype=np.float64),
            mass=_array(np.asarray(volume) * density, real, precision, device),
            volume=_array(volume, real, precision, device),
            history=_histories(np.asarray(x), materials, material, body),
            groups=tuple(groups),
            materials=tuple(materials),
            dx=float(dx),
            origin=(px, py, pz),
            cfl=cfl,
            precision=precision,
            device=device,
            form=form_of(precision, device if simd else "", gradient),
            held=frozenset(held),
            wet=frozenset(wet),
            names=tuple(names),
            tops=tops or {},
            free_mass=free_mass,
            least_stiffness=1.0 if stiffness is None else float(np.min(stiffness)),
        )

    def __len__(self) -> int:
        return len(self.rest)

    @property
    def bodies(self) -> int:
        """Number of bodies of the model."""
        return 1 + max(group.body for group in self.groups)

    def particles(self, body: int) -> slice:
        """Return the slice of a body's particles."""
        groups = [group for group in self.groups if group.body == body]
        return slice(groups[0].start, groups[-1].stop)

    def named(self, name: str | None) -> slice:
        """Return the slice of the particles of a body, or of all particles if `name` is None."""
        return slice(0, len(self)) if name is None else self.particles(self.names.index(name))

    def rest_of(self, name: str | None) -> NDArray[np.float64]:
        """Return the rest positions of a body's particles [Q,3], m; None: of all particles.

        The body may belong to the model of all bodies (`whole`) without belonging to this model.
        """
        model = self if self.whole is None else self.whole
        return model.rest[model.named(name)]

    def top_of(self, name: str | None) -> float:
        """Return the height of a body's top [m]; None: of all bodies and free solids."""
        model = self if self.whole is None else self.whole
        heights = [height for key, height in model.tops.items() if name in (None, key)]
        return max([float(model.rest_of(name)[:, 2].max()), *heights])

    @property
    def moves(self) -> NDArray[np.bool_]:
        """Whether each particle may move [P]; the particles of fixed bodies may not."""
        free = np.ones(len(self), bool)
        for body in self.held:
            free[self.particles(body)] = False
        return free

    @property
    def dry_groups(self) -> tuple[Group, ...]:
        """Groups of the particles in bodies that no other solver moves."""
        return tuple(group for group in self.groups if group.body not in self.wet)

    @property
    def real(self) -> Any:
        """Warp's floating point type of the model's precision."""
        return PRECISIONS[self.precision]

    @property
    def elastic_limit(self) -> float:
        """The elastic limit in units of dx sqrt(rho0 / A); see `timestep.ELASTIC_LIMIT`."""
        return ELASTIC_LIMIT["spline" if self.form == "spline" else "affine"]

    @property
    def viscous(self) -> float:
        """Longest substep [s] that the viscosity of the materials in `dry_groups` allows."""
        laws = {group.law.name for group in self.dry_groups}
        sections = [m for m in self.materials if m.device_law.name in laws]
        slowest = min(section.viscous_limit(self.dx) for section in sections)
        return beside_elastic(self.cfl) * slowest

    def groups_in(self, run: slice) -> list[Group]:
        """Return the groups of a body, whose particles are `run`."""
        start, stop, _ = run.indices(len(self))
        return [group for group in self.groups if start <= group.start < stop]

    def densities_in(self, run: slice) -> tuple[float, float]:
        """Return the smallest and the largest density of a body's particles [kg/m^3]."""
        start = self.groups_in(run)[0].start
        if start not in self._densities:
            mass, volume = (np.asarray(a.numpy()[run], float) for a in (self.mass, self.volume))
            density = mass / volume
            self._densities[start] = float(density.min()), float(density.max())
        return self._densities[start]

    @cached_property
    def _densities(self) -> dict[int, tuple[float, float]]:
        """Densities that `densities_in` has computed."""
        return {}

    @cached_property
    def total_mass(self) -> float:
        """Mass of all particles that may move [kg]."""
        return float(np.sum(self.mass.numpy()[self.moves], dtype=np.float64))

    def array(self, values: object, dtype: Any) -> wp.array:
        """Return an array on the model's device, in the model's precision."""
        return _array(values, dtype, self.precision, self.device)

    def launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> wp.Launch | None:
        """Record a kernel launch on the model's device; return None if the launch has no threads.

        Args:
            kernel: The Warp kernel.
            dim: Number of threads, or the number of threads along each axis.
            inputs: Arguments that the kernel reads.
            outputs: Arguments that the kernel writes, passed after the inputs.
        """
        return record(kernel, dim, inputs, outputs, self.device)


@dataclass
class State(Kept):
    """The particles' arrays on the device that every substep changes."""

    kept = ("x", "residue", "v", "C", "F", "history", "total")

    x: wp.array
    """Positions of the particles [P,3], m."""
    residue: wp.array
    """Rounding errors of the particles' positions [P,3], m; they are added in the next substep."""
    v: wp.array
    """Velocities of the particles [P,3], m/s, half a substep behind the positions."""
    C: wp.array
    """Velocity gradients of the APIC scheme [P,3,3], 1/s."""
    F: wp.array
    """Elastic deformation gradients of the particles [P,3,3]."""
    history: wp.array
    """History variables of the constitutive laws [P,2]; empty if no law has any."""
    total: wp.array
    """Total deformation gradients [P,3,3], with plastic strain; empty if no material is plastic."""

    @classmethod
    def of(cls, model: Model, v: NDArray | None = None, C: NDArray | None = None) -> State:
        """Return the state of undeformed particles.

        Args:
            model: The particles.
            v: Velocities [P,3], m/s; None: at rest.
            C: Velocity gradients [P,3,3], 1/s; None: zero.
        """
        t, count = types(model.real), len(model)
        plastic = any(group.law.project is not None for group in model.groups)
        kept = count if plastic else 0
        v, C = (None if motion is None else _zero_held(motion, model) for motion in (v, C))
        identity = np.tile(np.eye(3), (count, 1, 1))
        return cls(
            x=model.array(model.rest, t.vec3),
            residue=model.array(np.zeros((count, 3)), t.vec3),
            v=model.array(np.zeros((count, 3)) if v is None else v, t.vec3),
            C=model.array(np.zeros((count, 3, 3)) if C is None else C, t.mat33),
            F=model.array(identity, t.mat33),
            history=model.array(model.history[:kept], t.vec2),
            total=model.array(identity[:kept], t.mat33),
        )

    def arrays(self) -> dict[str, wp.array]:
        """Return all arrays of the state by name."""
        return {name: getattr(self, name) for name in self.kept}

    @property
    def deformation(self) -> wp.array:
        """Deformation gradients that Gaussians follow: `total` if a material is plastic, or
        else F.
        """
        return self.total if len(self.total) else self.F


def part_of(array: wp.array, part: slice) -> wp.array:
    """Return a slice of an array with a row per particle.

    An empty array, which no law uses, is returned unchanged.
    """
    return cast("wp.array", array[part]) if len(array) else array


def _zero_held(motion: NDArray, model: Model) -> NDArray:
    if not model.held:
        return motion
    moves: NDArray = model.moves.reshape(-1, *[1] * (motion.ndim - 1))
    return np.where(moves, motion, 0.0)


def form_of(precision: str, device: str, gradient: str = "affine") -> str:
    """Return the name of the transfers' implementation: "spline" on request, "simd" or "plain"."""
    if gradient == "spline":
        return "spline"
    return "simd" if device == "cpu" and precision == "float32" else "plain"


def parameters(
    materials: Sequence[Material],
    material: NDArray,
    stiffness: NDArray | None,
    *,
    dx: float,
    cfl: float,
) -> NDArray[np.float64]:
    """Return the parameters of a law's particles: one row if all are equal, otherwise a row per
    particle.

    Args:
        materials: All materials.
        material: For each particle, its index into `materials` [P].
        stiffness: Factors [P] on the parameters that are proportional to E, or None.
        dx: Grid spacing [m].
        cfl: Length of a substep as a fraction of the elastic limit.
    """
    kinds = np.unique(material)
    rows = np.array([materials[i].theta_on(dx, cfl) for i in kinds])
    scaled = np.array([materials[i].scaled for i in kinds])
    if stiffness is None or not scaled.any():
        return rows if len(kinds) == 1 else rows[np.searchsorted(kinds, material)]
    kind = np.searchsorted(kinds, material)
    column = np.arange(rows.shape[1]) < scaled[kind][:, None]
    return rows[kind] * np.where(column, stiffness[:, None], 1.0)


def _histories(
    x: NDArray, materials: Sequence[Material], material: NDArray, body: NDArray
) -> NDArray[np.float64]:
    """Return the initial history variables [P,2] of particles at x [P,3], m."""
    history = np.empty((len(x), 2))
    for number in np.unique(body):
        inside = np.flatnonzero(body == number)
        low, high = x[inside].min(axis=0), x[inside].max(axis=0)
        inside = inside[np.argsort(material[inside], kind="stable")]
        kinds, first = np.unique(material[inside], return_index=True)
        for kind, which in zip(kinds, np.split(inside, first[1:]), strict=True):
            history[which] = materials[kind].histories(x[which], low, high)
    return history


def _runs(materials: Sequence[Material], material: NDArray, body: NDArray) -> list[tuple[int, int]]:
    """Return the first index and the end index of each law's particles in each body.

    Raises:
        ValueError: The particles of different bodies or laws are mixed, or a body has no particle.
    """
    laws = [section.device_law.name for section in materials]
    law = np.array([laws.index(name) for name in laws])[material]
    steps = np.diff(body)
    if body[0] != 0 or np.any((steps != 0) & (steps != 1)):
        raise ValueError("particles must be sorted by body, and bodies must be numbered from 0")
    if np.any((np.diff(law) < 0) & (steps == 0)):
        raise ValueError("particles must be sorted by constitutive law")
    first = np.flatnonzero(np.diff(law, prepend=-1) | np.diff(body, prepend=-1))
    return list(itertools.pairwise([*first.tolist(), len(law)]))


def _array(values: object, dtype: Any, precision: str, device: str) -> wp.array:
    scalar = np.float32 if precision == "float32" else np.float64
    return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype, device=device)
