"""Observer: measures or checks one run, from the first launch to the report.

`phy124.monitor.OBSERVERS` lists all classes. `observers_of` makes those that a scene calls for, so
what it does not call for is neither compiled, allocated nor launched. A run compiles, binds, asks,
pauses, resumes and reports its observers in loops over this list, in its order. Every method has a
default that does nothing, so a new observer overrides only what it needs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeVar

from phy124.boundaries import Boundary
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.kernels.transfer import Law
from phy124.materials import AnyMaterial
from phy124.mpm import Attachable, Model, Solver, Stage, State
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Part
from phy124.particles import Particles
from phy124.particles.scenery import Scenery
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self


class Cost(NamedTuple):
    """Cost of an effect on one core [ns per substep]; measured in docs/lab/benchmarks.md."""

    fixed: float = 0.0
    particle: float = 0.0
    """For each particle."""
    node: float = 0.0
    """For each node of the window."""

    def of(self, particles: int, nodes: int) -> float:
        """Return the cost of one substep [ns]."""
        return self.fixed + self.particle * particles + self.node * nodes


UNKNOWN = Cost()


class Effect(NamedTuple):
    """A row of the effects report: an effect, and whether the scene calls for it."""

    name: str
    called_for: bool = True
    why: str = ""
    """Why it is left out, if it is."""
    cost: Cost = UNKNOWN
    """Cost if it ran."""


class Violation(NamedTuple):
    """Reason why a frame is wrong."""

    what: str
    """A clause that says what is wrong."""
    causes: tuple[str, ...]
    """Possible causes, for `phy124.budget.remedies`, the likeliest first."""


class Subject(NamedTuple):
    """Decides which observers a run has."""

    scene: Scene
    materials: Sequence[AnyMaterial]
    """Materials of the particles: those of the scene, or of its file of properties."""
    changes: bool = False
    """Whether forces, boundaries and stiffness may change while it runs."""

    @property
    def laws(self) -> list[Law]:
        """The laws of the materials, each once."""
        return list({m.device_law.name: m.device_law for m in self.materials}.values())

    @property
    def elastic(self) -> bool:
        """Whether any material is elastic, that is, has no return mapping."""
        return any(law.project is None for law in self.laws)


class Observed(Protocol):
    """The members of `phy124.simulation.Setup` that observers read."""

    @property
    def scene(self) -> Scene:
        """The scene."""
        ...

    @property
    def subject(self) -> Subject:
        """Decides which observers the run has."""
        ...

    @property
    def particles(self) -> Particles:
        """Particles that move, at rest."""
        ...

    @property
    def scenery(self) -> Scenery:
        """All Gaussians at rest, and which of them move."""
        ...

    @property
    def shown(self) -> Gaussians:
        """All Gaussians at rest, grains included."""
        ...

    @property
    def keep(self) -> bool:
        """Whether all frames are kept."""
        ...


class Observer:
    """Observes one run; the base class observes nothing."""

    absent: ClassVar[dict[str, Any]] = {}
    """Section of the report of a run without this observer."""
    in_substeps: ClassVar[bool] = False
    """Whether it is an accumulator: a rejected substep or frame restores its snapshot."""
    in_gathers: ClassVar[bool] = False
    """Whether it records a launch after each gather; a rejected frame restores its snapshot."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether a run needs this observer."""
        del subject
        return True

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels to compile before the run, in the precision `real`."""
        del subject, real
        yield from ()

    @classmethod
    def effect(cls, subject: Subject) -> Effect | None:
        """Return the row of the effects report, if there is one, before a run."""
        del subject
        return None

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Make the observer of a run, before its solver exists."""
        del setup
        return cls()

    def wrap_forces(self, forces: Sequence[Attachable]) -> Sequence[Attachable]:
        """Return the forces with stages that measure them."""
        return forces

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable]
    ) -> Sequence[Attachable]:
        """Return `inner` with stages that measure the walls.

        Args:
            walls: The boundaries of the scene.
            inner: The boundaries as earlier observers have wrapped them, one each.
        """
        del walls
        return inner

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that end each substep (`in_substeps`)."""
        del model, state, tracks
        return []

    def allocate(self, model: Model, workers: int) -> None:
        """Allocate sums for a number of workers (`in_gathers`)."""

    def record(
        self, part: Part, worker: int, model: Model, state: State, tracks: Tracks
    ) -> Recorded:
        """Record the launch that follows the gather of a worker's part (`in_gathers`).

        Args:
            part: Particles of one law that a worker steps.
            worker: Number of the worker.
            model: The particles' constants.
            state: The state after the gather.
            tracks: Quantities that change with time.
        """
        raise NotImplementedError

    def bind(self, solver: Solver, observers: Sequence[Observer]) -> None:
        """Bind to the solver, and to the other observers whose results this one reads."""

    def change(self, scene: Scene) -> None:
        """Go on under the forces, boundaries and stiffness of another scene."""

    def skip_to(self, index: int) -> float | None:
        """Return the time [s] of a frame that needs no substeps, or None if it needs them."""
        del index

    def before_frame(self, time: float) -> None:
        """Prepare a frame that starts at this time [s]."""

    def before_attempt(self, *, closely: bool) -> None:
        """Prepare an attempt at a frame; a failed attempt is repeated with half the substep.

        Args:
            closely: Whether this is the second attempt, which is checked after every substep.
        """

    def after_substep(self) -> None:
        """Read the state after a substep, or after several where a CUDA graph takes them."""

    def after_attempt(self) -> Violation | None:
        """Check the state at the end of a frame; a violation ends the attempt."""

    def after_frame(self, frame: Frame) -> Frame:
        """Return the frame of the moving Gaussians, with what this observer adds to it."""
        return frame

    def complete(self, clip: Clip) -> Clip:
        """Return the clip with what this observer adds to it."""
        return clip

    def finished_effect(self, subject: Subject) -> Effect | None:
        """Return the row of the effects report after a run."""
        return self.effect(subject)

    def notes(self) -> list[str]:
        """Return sentences that the user should know."""
        return []

    def report(self, frames: Sequence[Frame]) -> dict[str, Any]:
        """Return the section of report.json.

        Args:
            frames: All frames, if they are kept; else none.
        """
        del frames
        return {}

    def snapshot(self) -> dict[str, Any]:
        """Return the state to continue from: arrays and plain data."""
        return {}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""


Kind = TypeVar("Kind", bound=Observer)


def find(observers: Iterable[Observer], kind: type[Kind]) -> Kind | None:
    """Return the observer of a class, or None if the scene does not call for it."""
    return next((observer for observer in observers if isinstance(observer, kind)), None)


def snapshots(observers: Iterable[Observer]) -> dict[str, Any]:
    """Return the snapshots of observers by the names of their classes."""
    return {type(observer).__name__: observer.snapshot() for observer in observers}


def restore_all(observers: Iterable[Observer], snapshot: dict[str, Any]) -> None:
    """Return observers to their snapshots; those that have none stay as they are."""
    for observer in observers:
        if type(observer).__name__ in snapshot:
            observer.restore(snapshot[type(observer).__name__])
