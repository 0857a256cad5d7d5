"""Interior: adds Gaussians inside elastic material; these Gaussians become visible if the material
tears.

Generators place Gaussians only on the surface, so a tear in the object would look like a hole.
Inner particles that have lost a neighbour get round Gaussians in the colours of the surface. The
Gaussians are added to the finished clip, because exposed particles are not known in advance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Frame, Gaussians, join
from phy124.io.clip import Clip
from phy124.kernels.diagnostics import make_neighbours_lost
from phy124.materials import AnyMaterial
from phy124.monitor.observer import Effect, Observed, Observer, Subject, find
from phy124.monitor.tearing import APART, Tearing
from phy124.motion.exposed import Exposed
from phy124.motion.recorded import Computed, Torn, make_arrays
from phy124.particles import Particles, by_object
from phy124.particles.grains import leave_room, make_grains

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver

NEIGHBOURS = 7
"""Number of particles that are examined for each particle: itself and six neighbours."""
Opened = dict[str, NDArray]


class Interior(Observer):
    """Finds the inner particles that tears expose."""

    def __init__(
        self,
        shown: Gaussians,
        particles: Particles,
        materials: Sequence[AnyMaterial],
        *,
        spacing: float,
        dx: float,
        keep: bool = True,
    ) -> None:
        """Store the object at rest; everything else is computed only if material tears.

        Args:
            shown: All other visible Gaussians.
            particles: The particles that move.
            materials: The materials of the particles; only elastic materials can be torn.
            spacing: Distance between neighbouring particles at rest [m].
            dx: Grid spacing [m].
            keep: Whether the run keeps the frames for a clip.
        """
        self._shown, self._rest, self._materials = shown, particles, materials
        self._spacing, self._dx, self._keep = spacing, dx, keep
        self._real: Any = wp.float32
        self._uploaded: tuple[wp.array, wp.array, wp.array] | None = None
        self._opened: dict[int, Opened] = {}
        """Exposed particles and their positions, for each frame with torn material."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether grains are shown and any material can tear."""
        return subject.scene.grains and subject.elastic

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        grains = subject.scene.grains
        why = "no elastic material could be torn" if grains else "grains is off"
        return Effect("inside of torn material", subject.elastic and grains, why)

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        scene, materials = setup.scene, setup.subject.materials
        sizes: dict[str, Any] = {"spacing": scene.spacing, "dx": scene.dx, "keep": setup.keep}
        return cls(setup.shown, setup.particles, materials, **sizes)

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, and to the observer that detects tears."""
        self._state, self._tearing = solver.state, find(observers, Tearing)
        self._real = solver.model.real

    def after_frame(self, frame: Frame) -> Frame:
        """Find exposed particles if a tear is likely; return the frame unchanged."""
        if self._keep and self._tearing is not None and self._tearing.likely:
            self.look(frame.index, self._state.x)
        return frame

    def look(self, index: int, x: wp.array) -> None:
        """Find the particles exposed in a frame, from the positions x [P,3], m."""
        lost = self._find_lost(x)
        # Gaps are wider than a particle, so the second layer of particles is also visible.
        alone = np.zeros(len(x), bool)
        alone[self._inside[lost]] = True
        ids = np.flatnonzero(lost | alone[self._neighbours].any(axis=1))
        here: Any = x.numpy()[self._inside[ids]] if len(ids) else np.zeros((0, 3))
        self._opened[index] = {"ids": ids, "x": here.astype(np.float32)}

    def _find_lost(self, x: wp.array) -> NDArray[np.bool_]:
        """Return a mask of the inner particles that have lost a neighbour.

        The kernel is compiled at first use, because most runs do not need it.
        """
        if self._uploaded is None:
            chosen, neighbours = (
                wp.array(array, dtype=wp.int32, device=x.device)
                for array in (self._inside, self._neighbours)
            )
            byte: Any = wp.uint8
            lost = wp.empty(len(self._inside), dtype=byte, device=x.device)
            self._uploaded = chosen, neighbours, lost
        *read, lost = self._uploaded
        inputs = [self._real((APART * self._dx) ** 2), *read, x]
        kernel = make_neighbours_lost(self._real)
        wp.launch(kernel, len(lost), inputs=inputs, outputs=[lost], device=x.device)
        return np.asarray(lost.numpy(), bool)

    def complete(self, clip: Clip) -> Clip:
        """Return the clip with a Gaussian for each exposed particle."""
        exposed = self._list_exposed(len(clip))
        if exposed is None:
            return clip
        means: Any = clip.means
        if isinstance(means, Computed):
            moving = make_arrays(Torn(means.recorded, exposed))
        else:
            moving = _add_exposed(clip, exposed)
        whole, motion = join([self._shown, exposed.grains]), clip.motion
        fixed = {name: getattr(whole, name) for name in ("opacities", "sh", "object_id")}
        clip = replace(clip, **moving, **fixed)
        return clip if motion is None else clip.with_motion(replace(motion, exposed=exposed))

    def _list_exposed(self, count: int) -> Exposed | None:
        """Return the particles exposed in `count` frames; None if no particle is exposed.

        A skipped frame has the same exposed particles as the frame before.
        """
        latest: Opened = {"ids": np.zeros(0, int), "x": np.zeros((0, 3), np.float32)}
        frames = [latest := self._opened.get(index, latest) for index in range(count)]
        ids, grain = np.unique(np.concatenate([f["ids"] for f in frames]), return_inverse=True)
        if not len(ids):
            return None
        above, grains = self._make_grains(ids)
        frame = np.repeat(np.arange(count, dtype=np.int32), [len(f["ids"]) for f in frames])
        order = np.argsort(grain, kind="stable")
        x = np.concatenate([f["x"] for f in frames])
        listed = grain.astype(np.int32)[order], frame[order], x[order]
        return Exposed(grains, above.astype(np.int32), *listed)

    def snapshot(self) -> dict[str, Any]:
        """Return the exposed particles of all frames."""
        return {str(index): dict(opened) for index, opened in self._opened.items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the exposed particles."""
        self._opened = {int(index): opened for index, opened in snapshot.items()}

    @cached_property
    def _objects(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]]:
        """For each object: Gaussians, particles that a tear may expose, and the neighbours of these
        particles.
        """
        rest = self._rest
        elastic = np.array([s.device_law.project is None for s in self._materials])[rest.material]
        free = elastic & (rest.gaussian < 0)
        # Each object is handled alone, because objects that touch at the start and then separate
        # are not torn.
        return [
            (gaussians, *self._prepare_object(gaussians, particles, free[particles]))
            for gaussians, particles in by_object(self._shown, rest)
            if len(particles)
        ]

    @cached_property
    def _inside(self) -> NDArray[np.intp]:
        return np.concatenate([inside for _, inside, _ in self._objects])

    @cached_property
    def _neighbours(self) -> NDArray[np.intp]:
        """Neighbours of these particles at rest [I,7]."""
        return np.concatenate([neighbours for *_, neighbours in self._objects])

    def _prepare_object(
        self, gaussians: NDArray[np.intp], particles: NDArray[np.intp], free: NDArray[np.bool_]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        x = self._rest.x[particles]
        candidates = np.flatnonzero(free)
        inside = candidates[leave_room(self._surface(gaussians), x[candidates], self._spacing)]
        count = min(NEIGHBOURS, len(x))
        near = np.reshape(
            scipy.spatial.KDTree(x).query(x[inside], k=count, workers=-1)[1], (len(inside), count)
        )
        # In a tiny object, particles have fewer neighbours; the last neighbour is then repeated.
        near = np.pad(near, ((0, 0), (0, NEIGHBOURS - count)), mode="edge")
        return particles[inside], particles[near]

    def _make_grains(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.intp], Gaussians]:
        """Return the nearest surface Gaussian and the new Gaussian of each exposed particle."""
        above, grains, first = [], [], 0
        for gaussians, inside, _ in self._objects:
            chosen = ids[(ids >= first) & (ids < first + len(inside))] - first
            first += len(inside)
            x = self._rest.x[inside[chosen]]
            made, nearest = make_grains(self._surface(gaussians), x, self._spacing)
            grains.append(made)
            above.append(gaussians[nearest])
        return np.concatenate(above), join(grains)

    def _surface(self, gaussians: NDArray[np.intp]) -> Gaussians:
        every = len(gaussians) == len(self._shown)
        return self._shown if every else self._shown.select(gaussians)


def _add_exposed(clip: Clip, exposed: Exposed) -> dict[str, Any]:
    above, count = exposed.above, len(exposed.above)
    names = ("means", "quats", "scales", "rotations", "velocities")
    known = {name: array for name in names if (array := getattr(clip, name)) is not None}
    rows = {name: np.asarray(array[:, above]) for name, array in known.items()}
    shown = [
        exposed.show({name: array[index] for name, array in rows.items()}, index, np.arange(count))
        for index in range(len(clip))
    ]
    added = {name: np.stack([row[name] for row in shown]) for name in known}
    if clip.contacts is not None:
        known["contacts"], added["contacts"] = clip.contacts, np.zeros_like(added["means"])
    return {name: np.concatenate([known[name], added[name]], axis=1) for name in known}
