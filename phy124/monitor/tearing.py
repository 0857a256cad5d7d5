"""Tearing: detects numerical fracture of material whose constitutive law does not fracture.

Particles interact only through common nodes. If stretching moves particles more than about a cell
apart, the material separates (docs/design/stability.md). A finer grid does not help: it resolves
sharper corners, and the material at sharper corners is stretched more. More particles per cell
help.

Neighbouring particles that are farther apart than `APART` indicate a possible tear, except in thin
stems. Separated pieces prove a tear.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Frame
from phy124.kernels.diagnostics import make_apart
from phy124.monitor.diagnostics import describe_particle
from phy124.monitor.observer import Effect, Observed, Observer, Subject

if TYPE_CHECKING:
    from phy124.liquid import AnySolver

APART = 1.2
"""Material may separate if neighbouring particles are farther apart than this [cells]."""
MANY, FEW = 5e-3, 3
"""A tear is likely if the number of particles that are farther apart than `APART` exceeds both
`FEW` and `MANY` times P^(2/3), where P is the number of particles. P^(2/3) is about the number of
particles in a cross-section.

In tests, every duck with fewer than 5.2e-3 P^(2/3) of these particles stayed whole. A duck with
6.7e-3 P^(2/3) of these particles lost its head, but another duck with 7.9e-3 P^(2/3) stayed whole.
"""
REACH = 1.5
"""Reach of a particle's B-spline [cells]; a wider empty layer separates two pieces."""
LOOSE = 2e-3
"""Smallest fraction of all elastic particles in a separated piece."""
FLAKE = 8
"""Smallest number of particles in a separated piece."""
ALONE = 1.0
"""Particles that are farther apart at rest do not count as neighbours [cells]."""
STURDY = 1e9
"""Stretch limit of particles that are not checked."""
FAR = 4096
"""If there are more cubes along an axis, empty space is removed before labelling."""
MOST = 50_000_000
"""Largest number of cubes; with more cubes, pieces are not determined."""
REMEDY = (
    "A larger accuracy.particles_per_axis, binding = particles, a stiffer material, more "
    "material.damping or a gentler motion helps; a finer grid does not."
)


class Tearing(Observer):
    """Checks after each frame whether elastic materials have been torn."""

    absent: ClassVar[dict[str, Any]] = {
        "balance": {"tearing": {"apart": 0, "stretch": 1.0, "loose": 0, "likely": False}}
    }
    kept = ("count", "first", "stretch", "loose")

    def __init__(self) -> None:
        self.count, self.first, self.stretch = 0, 0, 1.0
        """`count` is the largest number of particles in a frame that are farther apart than
        `APART`. `first` is the lowest index of these particles, and `stretch` is the largest
        stretch.
        """
        self.loose = 0
        """Largest number of separated particles in a frame."""
        self._separate: NDArray[np.int32] | None = None
        """Separate piece of its object to which each particle belongs [P]."""

    @classmethod
    def of(cls, setup: Observed) -> Tearing:
        """Return the observer of a run; separate pieces of an object may move apart."""
        observer = cls()
        observer._separate = setup.particles.piece
        return observer

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether any material is elastic."""
        return subject.elastic

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernel that measures the stretch."""
        yield make_apart(real)

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        why = "all moving materials flow, so they may separate and merge"
        name = "search for torn material and separate pieces in each frame"
        return Effect(name, subject.elastic, why)

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Select the elastic particles, and label their pieces at rest."""
        self._model, self._state = solver.model, solver.state
        model = solver.model
        self._elastic = [group for group in model.groups if group.law.project is None]
        self._chosen = np.zeros(len(model), bool)
        for group in self._elastic:
            self._chosen[group.particles] = True
        spacing = np.cbrt(model.volume.numpy().astype(np.float64)) / model.dx
        # A particle that is alone in a cell at rest has no neighbours from which it could separate.
        stretch = np.where(spacing < ALONE, APART / spacing, STURDY)
        self._most = wp.array(stretch**2, dtype=model.real, device=model.device)
        """Square of the stretch above which each particle is too far from its neighbours [P]."""
        self._counts = wp.zeros(2, dtype=int, device=model.device)
        self._max_stretch = wp.zeros(1, dtype=model.real, device=model.device)
        self._launches = []
        for group in self._elastic:
            part = group.particles
            inputs = [self._most[part], group.start, self._state.F[part]]
            outputs = [self._counts, self._max_stretch]
            self._launches.append(model.launch(make_apart(model.real), len(group), inputs, outputs))
        self._pieces = Pieces(model.rest[self._chosen], REACH * model.dx, self._bodies())

    def _bodies(self) -> NDArray[np.int64] | None:
        """Return the number of each elastic particle's separate piece among those of all objects
        [P]; None: a single object of one piece.
        """
        model, separate = self._model, self._separate
        if model.bodies == 1 and separate is None:
            return None
        body = np.empty(len(model), np.int64)
        for group in model.groups:
            body[group.particles] = group.body
        if separate is not None:
            body = body * (int(separate.max()) + 1) + separate
        return body[self._chosen]

    @property
    def torn(self) -> bool:
        """Whether a visible piece of material has separated."""
        return self.loose >= max(FLAKE, LOOSE * int(self._chosen.sum()))

    @property
    def likely(self) -> bool:
        """Whether a piece of material has separated, or may have separated."""
        return self.torn or self.count > max(FEW, MANY * len(self._model) ** (2 / 3))

    def after_attempt(self) -> None:
        """Check the state at the end of a frame."""
        self._counts.assign([0, len(self._model)])
        self._max_stretch.zero_()
        for launch in self._launches:
            if launch is not None:
                launch.launch()
        count, first = self._counts.numpy().tolist()
        if count > self.count:
            stretch: Any = self._max_stretch.numpy()
            self.count, self.first = count, first
            self.stretch = max(self.stretch, float(np.asarray(stretch)[0]))
        x: Any = self._state.x.numpy()
        whole = self._chosen.all()
        self.loose = max(self.loose, self._pieces.loose(x if whole else x[self._chosen]))

    def notes(self) -> list[str]:
        """Return a note if material is torn or may be torn."""
        if not self.likely:
            return []
        if self.torn:
            fraction = self.loose / self._chosen.sum()
            return [
                f"{self.loose} particles ({fraction:.1%}) separated from their piece: the "
                f"grid tore material that should hold together. {REMEDY}"
            ]
        first = describe_particle(self._model, self._state, self.first)
        return [
            f"{self.count} particles were stretched (by up to {self.stretch:.1f} times) until they "
            f"lay more than {APART} cells apart; the first one was {first}. Between "
            f"particles so far apart the grid may tear material that should hold together. {REMEDY}"
        ]

    @property
    def briefly(self) -> str:
        """The note as a clause."""
        if self.torn:
            return "the grid tears the material"
        return f"the material is stretched {self.stretch:.1f} times and the grid may tear it"

    def report(self, frames: Sequence[Frame] = ()) -> dict[str, Any]:
        """Return this observer's section of the report."""
        tearing = {"apart": self.count, "stretch": self.stretch, "loose": self.loose}
        return {"balance": {"tearing": {**tearing, "likely": self.likely}}}


class Pieces:
    """Groups of particles that are connected at rest.

    Particles in one cube, or in cubes that touch, are connected; particles of different objects, or
    of separate pieces of an object, are not.
    """

    def __init__(self, rest: NDArray, side: float, object_id: NDArray | None = None) -> None:
        """Label the pieces at rest.

        Args:
            rest: Positions at rest [P,3], m.
            side: Side of a cube [m].
            object_id: Object, or separate piece of an object, of each particle [P]; None: all
                particles belong to a single object.
        """
        self._side, self._object = side, object_id
        self._body = labels(self._spread(rest), side)
        if self._body is not None:
            self._sizes = np.bincount(self._body)

    def loose(self, x: NDArray) -> int:
        """Return the number of particles at x [P,3], m, outside the largest part of their piece."""
        now = labels(self._spread(x), self._side)
        if now is None or self._body is None or now.max() == 0:
            return 0
        pairs, counts = np.unique(self._body * (now.max() + 1) + now, return_counts=True)
        largest = np.zeros(len(self._sizes), int)
        np.maximum.at(largest, pairs // (now.max() + 1), counts)
        return int((self._sizes - largest).sum())

    def _spread(self, x: NDArray) -> NDArray:
        """Return the positions, with gaps between the objects."""
        if self._object is None or not np.isfinite(x).all():
            return x
        shifted = x.astype(np.float64)
        shifted[:, 0] += self._object * (np.ptp(shifted[:, 0]) + 3 * self._side)
        return shifted


def labels(x: NDArray, side: float) -> NDArray[np.int64] | None:
    """Return the index of each particle's piece [P]; None if the particles are too scattered. The
    pieces are found on cubes with the side `side` [m].
    """
    if len(x) == 0 or not np.isfinite(x).all():
        return None
    columns = [_cubes(column, side) for column in x.T]
    size = tuple(int(column.max()) + 1 for column in columns)
    if math.prod(size) > MOST:
        return None
    at = (columns[0] * size[1] + columns[1]) * size[2] + columns[2]
    occupied = np.zeros(size, bool)
    occupied.reshape(-1)[at] = True
    pieces, count = scipy.ndimage.label(occupied, np.ones((3, 3, 3)))  # pyright: ignore
    if count == 1:
        return np.zeros(len(x), np.int64)
    return np.asarray(pieces.reshape(-1)[at].astype(np.int64) - 1)


def _cubes(column: NDArray, side: float) -> NDArray[np.int64]:
    """Return each particle's cube along one axis; wide gaps are narrowed to two cubes."""
    cubes = (column - column.min()) / side
    if cubes.max() < FAR:
        return cubes.astype(np.int64)
    occupied, which = np.unique(np.floor(cubes), return_inverse=True)
    steps = np.minimum(np.diff(occupied, prepend=occupied[:1]), 2)
    return np.cumsum(steps).astype(np.int64)[which.reshape(-1)]
