"""The material point method: Model (constant), State (changes), Grid (scratch), Solver (steps).

Explicit MLS-MPM with APIC transfers: a substep reads as push, clear, p2g, update, collide, g2p.
Only stages that the scene calls for exist; each is one recorded launch.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import transfer
from phy124.kernels.grid import make_update
from phy124.kernels.transfer import types
from phy124.materials import Material
from phy124.timestep import CFL, Extremes, Substep, stable_substep
from phy124.tracks import Tracks

Stage = tuple[str, Callable[[], wp.Launch | None]]
"""Name of a stage and how to record its launch for the grid window of the moment."""
CHECK_EVERY = 4
"""Substeps between two measurements of the stability limits."""
MARGIN = 4
"""Cells of window beyond the particles: more than they can cross between two measurements."""
PRECISIONS = {"float32": wp.float32, "float64": wp.float64}


class Attachable(Protocol):
    """A force or a boundary: adds its stages to a solver."""

    def attach(self, solver: Solver) -> list[Stage]:
        """The stages it needs in each substep."""
        ...


class Unstable(RuntimeError):
    """Particles left the grid window or stopped being numbers; the state is not to be used."""


@dataclass(frozen=True)
class Group:
    """A run of particles of one material."""

    material: Material
    start: int
    stop: int
    theta: wp.array
    """Parameters of the law, one row, or one row per particle."""


@dataclass
class State:
    """What changes every substep, on the device."""

    x: wp.array
    """Positions [P,3], m."""
    residue: wp.array
    """What rounding took from the positions [P,3], m."""
    v: wp.array
    """Velocities [P,3], m/s, half a substep behind the positions."""
    C: wp.array
    """APIC velocity gradients [P,3,3], 1/s."""
    F: wp.array
    """Elastic deformation gradients [P,3,3]."""
    history: wp.array
    """History variables of the law [P,2]; empty unless a law has some."""
    total: wp.array
    """Total deformation gradients [P,3,3]; empty unless a law is plastic."""

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def deformation(self) -> wp.array:
        """What the Gaussians follow: F, or F_total where it differs."""
        return self.total if len(self.total) else self.F

    def copy(self) -> dict[str, wp.array]:
        """A snapshot to restore from."""
        return {name: wp.clone(array) for name, array in self.arrays().items()}

    def restore(self, snapshot: dict[str, wp.array]) -> None:
        """Go back to a snapshot."""
        for name, array in self.arrays().items():
            wp.copy(array, snapshot[name])


class Grid:
    """Nodes in a window around the particles: a flat array, re-based when they outgrow it."""

    def __init__(self, origin: Sequence[float], dx: float, *, real: Any, device: str) -> None:
        t = types(real)
        self.origin, self.dx, self.device, self.vec4 = np.array(origin, float), dx, device, t.vec4
        self.lattice = t.vec4(*origin, dx)
        self.window = wp.zeros(2, dtype=wp.vec3i, device=device)
        self.low, self.size = np.zeros(3, int), np.zeros(3, int)
        self.nodes = wp.zeros(0, dtype=t.vec4, device=device)

    @property
    def count(self) -> int:
        """Nodes in the window."""
        return int(np.prod(self.size))

    def fit(self, lower: NDArray, upper: NDArray) -> bool:
        """Cover particles between two corners [m] with room to move; True if the window changed."""
        low = np.floor((lower - self.origin) / self.dx - 0.5).astype(int)
        high = np.floor((upper - self.origin) / self.dx - 0.5).astype(int) + 3
        end = self.low + self.size
        spare = np.minimum(low - self.low, end - high)
        if self.count and np.all(spare >= MARGIN // 2) and np.all(spare <= 3 * MARGIN):
            return False
        self.low, self.size = low - MARGIN, high - low + 2 * MARGIN
        self.window.assign(np.stack([self.low, self.size]).astype(np.int32))
        # One node more than the window: the SIMD rows read four nodes at a time.
        self.nodes = wp.zeros(self.count + 1, dtype=self.vec4, device=self.device)
        return True

    def nodes_within(self, lower: NDArray, upper: NDArray) -> tuple[NDArray, NDArray]:
        """First node (in the window) and extent of the nodes between two corners [m]."""
        low, size = self.low, self.size
        start = np.floor(np.clip((lower - self.origin) / self.dx - low, 0, size)).astype(int)
        stop = np.ceil(np.clip((upper - self.origin) / self.dx - low + 1, 0, size)).astype(int)
        return start, np.maximum(stop - start, 0)


class Solver:
    """Steps particles of given materials under forces and boundaries.

    `x [P,3]` m, `volume [P]` m^3, `material [P]` non-decreasing indices into `materials`,
    `dx` the grid spacing [m]; `v [P,3]` m/s and `C [P,3,3]` 1/s are the motion at the start.
    """

    def __init__(
        self,
        x: NDArray,
        volume: NDArray,
        materials: Sequence[Material],
        *,
        dx: float,
        material: NDArray | None = None,
        v: NDArray | None = None,
        C: NDArray | None = None,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Attachable] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        precision: str = "float32",
        device: str = "cpu",
        cfl: float = CFL,
        ceiling: float = math.inf,
        simd: bool | None = None,
    ) -> None:
        self.real, self.device, self.dx = PRECISIONS[precision], device, float(dx)
        self.cfl, self.ceiling = cfl, ceiling
        cpu_float = device == "cpu" and precision == "float32"
        self.native = cpu_float if simd is None else simd and cpu_float
        self.rest = np.asarray(x, dtype=np.float64)
        self.materials = tuple(materials)
        self._build_model(volume, np.zeros(len(x), int) if material is None else material)
        self._build_state(v, C)
        self.grid = Grid(origin, self.dx, real=self.real, device=device)
        self.clock = wp.zeros(3, dtype=self.real, device=device)
        self.stray = wp.zeros(1, dtype=int, device=device)
        self.maxima = wp.zeros(9, dtype=self.real, device=device)
        self.tracks = Tracks(real=self.real, device=device)
        self.pushes = [stage for force in forces for stage in force.attach(self)]
        self.collisions = [stage for wall in boundaries for stage in wall.attach(self)]
        self.tracks.upload(self.clock)
        self.time, self.substeps, self.last_dt = 0.0, 0, 0.0
        self.limiters: dict[str, int] = {}
        self.timings: dict[str, list[float]] = {}
        self._tracks_launch = self.tracks.record()
        self._tracks_launch.launch()
        self._records: list[tuple[str, wp.Launch]] = []
        self._since_check = CHECK_EVERY
        self.extremes = Extremes(0.0, 0.0, 0.0)

    def _build_model(self, volume: NDArray, material: NDArray) -> None:
        if np.any(np.diff(material) < 0):
            raise ValueError("particles must be sorted by material")
        density = np.array([m.density for m in self.materials])[material]
        self.volume = self._array(volume, self.real)
        self.mass = self._array(np.asarray(volume) * density, self.real)
        self.groups = []
        for index in np.unique(material):
            section = self.materials[index]
            start, stop = np.searchsorted(material, [index, index + 1])
            theta = self._array(
                [section.theta()], wp.types.vector(section.device_law.width, self.real)
            )
            self.groups.append(Group(section, int(start), int(stop), theta))

    def _build_state(self, v: NDArray | None, C: NDArray | None) -> None:
        t, count = types(self.real), len(self.rest)
        plastic = any(group.material.device_law.project is not None for group in self.groups)
        kept = count if plastic else 0
        identity = np.tile(np.eye(3), (count, 1, 1))
        history = np.zeros((kept, 2))
        for group in self.groups if plastic else ():
            history[group.start : group.stop] = group.material.history()
        self.state = State(
            x=self._array(self.rest, t.vec3),
            residue=self._array(np.zeros((count, 3)), t.vec3),
            v=self._array(np.zeros((count, 3)) if v is None else v, t.vec3),
            C=self._array(np.zeros((count, 3, 3)) if C is None else C, t.mat33),
            F=self._array(identity, t.mat33),
            history=self._array(history, t.vec2),
            total=self._array(identity[:kept], t.mat33),
        )

    def _array(self, values: object, dtype: Any) -> wp.array:
        scalar = np.float32 if self.real is wp.float32 else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype, device=self.device)

    def record(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> wp.Launch | None:
        """A launch to be repeated, on the solver's device; None if it has nothing to do."""
        launch = wp.launch(
            kernel, dim, inputs=inputs, outputs=outputs, device=self.device, record_cmd=True
        )
        return cast("wp.Launch | None", launch)

    def _measure(self) -> None:
        """Read the stability limits and make the window fit; raises Unstable."""
        self.maxima.fill_(-np.inf)
        for group in self.groups:
            s, part = self.state, slice(group.start, group.stop)
            kernel = transfer.make_measure(group.material.device_law, self.real)
            wp.launch(
                kernel,
                group.stop - group.start,
                inputs=[
                    group.theta, self.mass[part], self.volume[part],
                    s.x[part], s.v[part], s.C[part], s.F[part], _part(s.history, part),
                ],
                outputs=[self.maxima, self.stray],
                device=self.device,
            )  # fmt: skip
        lost = int(self.stray.numpy()[0])
        if lost:
            raise Unstable(f"{lost} particles left the grid or are no longer numbers")
        maxima = self.maxima.numpy().astype(np.float64)
        self.extremes = Extremes(*maxima[:3].tolist())
        if self.grid.fit(-maxima[3:6], maxima[6:9]) or not self._records:
            self._record_substep()
        self._since_check = 0

    def _record_substep(self) -> None:
        """Record the launches of one substep, in order."""
        records: list[tuple[str, wp.Launch | None]] = [(n, record()) for n, record in self.pushes]
        records += [(f"p2g {g.material.device_law.name}", self._record_p2g(g)) for g in self.groups]
        update = make_update(self.real)
        inputs = [self.clock, self.tracks.values]
        records.append(("grid", self.record(update, self.grid.count, inputs, [self.grid.nodes])))
        records += [(name, record()) for name, record in self.collisions]
        records += [(f"g2p {g.material.device_law.name}", self._record_g2p(g)) for g in self.groups]
        # A boundary out of reach of the window has no nodes and so no launch.
        self._records = [(name, launch) for name, launch in records if launch is not None]

    def _record_p2g(self, group: Group) -> wp.Launch | None:
        s, grid, part = self.state, self.grid, slice(group.start, group.stop)
        kernel = transfer.make_p2g(group.material.device_law, self.real, self.native)
        model = [self.mass[part], self.volume[part], group.theta]
        state = [s.x[part], s.v[part], s.C[part], s.F[part], _part(s.history, part)]
        inputs = [*model, grid.lattice, grid.window, self.clock, *state]
        return self.record(kernel, group.stop - group.start, inputs, [grid.nodes])

    def _record_g2p(self, group: Group) -> wp.Launch | None:
        s, grid, part = self.state, self.grid, slice(group.start, group.stop)
        kernel = transfer.make_g2p(group.material.device_law, self.real, self.native)
        inputs = [group.theta, grid.lattice, grid.window, self.clock, grid.nodes]
        outputs = [s.x[part], s.residue[part], s.v[part], s.C[part], s.F[part]]
        outputs += [_part(s.history, part), _part(s.total, part), self.stray]
        return self.record(kernel, group.stop - group.start, inputs, outputs)

    def step(self, kick: float, drift: float) -> None:
        """One substep: velocities change over `kick` s, positions and F over `drift` s."""
        if not self._records or self._since_check >= CHECK_EVERY:
            self._timed("measure", self._measure)
        self._set_clock(kick, drift)
        if self.tracks.vary:
            self._timed("tracks", self._tracks_launch.launch)
        pushes = len(self.pushes)
        for name, launch in self._records[:pushes]:
            self._timed(name, launch.launch)
        self._timed("clear", self.grid.nodes.zero_)
        for name, launch in self._records[pushes:]:
            self._timed(name, launch.launch)
        self.time += drift
        self.substeps += 1
        self._since_check += 1

    def advance(self, until: float, *, after: Callable[[], None] | None = None) -> None:
        """Substeps of stable length up to a time [s]; `after` is called after each.

        Raises Unstable if a particle leaves the grid window or stops being a number.
        """
        while self.time < until:
            if self._since_check >= CHECK_EVERY:
                self._timed("measure", self._measure)
            limit = self.substep()
            rest = until - self.time
            count = max(1, math.ceil(rest / limit.dt - 1e-9))
            dt = rest / count
            self.step((self.last_dt + dt) / 2, dt)
            if count == 1:
                self.time = until
            self.last_dt = dt
            self.limiters[limit.limiter] = self.limiters.get(limit.limiter, 0) + 1
            if after is not None:
                after()
        self._timed("measure", self._measure)

    def snapshot(self) -> dict[str, Any]:
        """All that `restore` needs to go on from here bit for bit."""
        clock = {"time": self.time, "last_dt": self.last_dt, "substeps": self.substeps}
        return {"state": self.state.copy(), "clock": clock, "limiters": dict(self.limiters)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to a snapshot."""
        self.state.restore(snapshot["state"])
        for name, value in snapshot["clock"].items():
            setattr(self, name, value)
        self.limiters = dict(snapshot["limiters"])
        self.stray.zero_()
        self._since_check = CHECK_EVERY

    def substep(self) -> Substep:
        """The longest stable substep at the present state."""
        return stable_substep(self.extremes, self.dx, cfl=self.cfl, ceiling=self.ceiling)

    def _set_clock(self, kick: float, drift: float) -> None:
        values = (kick, drift, self.time)
        if self.device == "cpu":
            self.clock.numpy()[:] = values
        else:
            self.clock.assign(np.array(values))

    def _timed(self, name: str, work: Callable[[], object]) -> None:
        start = time.perf_counter()
        work()
        entry = self.timings.setdefault(name, [0.0, 0])
        entry[0] += time.perf_counter() - start
        entry[1] += 1


def _part(array: wp.array, part: slice) -> wp.array:
    """A slice of an array that may be empty because no law needs it."""
    return cast("wp.array", array[part]) if len(array) else array
