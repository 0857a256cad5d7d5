"""Observer: measures or checks a run, from its first kernel launch to its report.

`phy124.monitor.OBSERVERS` lists all classes. By default, an observer keeps its solver and does
nothing else, so a new observer overrides only the methods that it needs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeVar

from phy124.boundaries import Boundary
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.kernels.transfer import Law
from phy124.materials import AnyMaterial
from phy124.motion.scenery import Scenery
from phy124.mpm import Attachable, Model, Stage, State
from phy124.mpm.kept import Kept
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Part
from phy124.particles import Particles
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver


class Cost(NamedTuple):
    """Cost on one core [ns per substep], as measured in docs/lab/benchmarks.md."""

    fixed: float = 0.0
    particle: float = 0.0
    node: float = 0.0

    def of(self, particles: int, nodes: int) -> float:
        """Return the cost per substep [ns]."""
        return self.fixed + self.particle * particles + self.node * nodes


UNKNOWN = Cost()


class Effect(NamedTuple):
    """An entry in the report's list of computed and omitted effects."""

    name: str
    called_for: bool = True
    why: str = ""
    """Reason why the effect is omitted, or empty."""
    cost: Cost = UNKNOWN


class Violation(NamedTuple):
    """An error in a frame, with possible causes."""

    what: str
    causes: tuple[str, ...]
    """Possible causes, likeliest first, for `phy124.budget.remedies`."""


class Subject(NamedTuple):
    """The properties that decide which observers a run needs."""

    scene: Scene
    materials: Sequence[AnyMaterial]
    """Materials of the particles, from the scene or its properties file."""
    changes: bool = False
    """Whether forces, boundaries and stiffness may change during the run."""

    @property
    def laws(self) -> list[Law]:
        """Laws without duplicates."""
        return list({m.device_law.name: m.device_law for m in self.materials}.values())

    @property
    def elastic(self) -> bool:
        """Whether any material has no return mapping."""
        return any(law.project is None for law in self.laws)


class Observed(Protocol):
    """The members of `phy124.simulation.Setup` that observers read."""

    @property
    def scene(self) -> Scene:
        """The scene."""
        ...

    @property
    def subject(self) -> Subject:
        """The properties that decide which observers the run needs."""
        ...

    @property
    def particles(self) -> Particles:
        """The moving particles, in their rest positions."""
        ...

    @property
    def scenery(self) -> Scenery:
        """All Gaussians at rest, and a mask of the Gaussians that move."""
        ...

    @property
    def shown(self) -> Gaussians:
        """All Gaussians at rest, including grains."""
        ...

    @property
    def keep(self) -> bool:
        """Whether all frames are kept."""
        ...


class Observer(Kept):
    """Observes one run; the base class observes nothing."""

    absent: ClassVar[dict[str, Any]] = {}
    """Keys and values that the report has if a run lacks this observer."""
    in_substeps: ClassVar[bool] = False
    """Whether sums are updated in each substep; a rejected substep restores them."""
    in_gathers: ClassVar[bool] = False
    """Whether a kernel launch follows each gather (the transfer from grid to particles); a rejected
    frame restores the sums.
    """

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether a run needs this observer."""
        return True

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels to compile before the run."""
        yield from ()

    @classmethod
    def effect(cls, subject: Subject) -> Effect | None:
        """Return the entry in the report's list of effects before a run, or None."""
        return None

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run; the solver does not exist yet."""
        return cls()

    def wrap_forces(self, forces: Sequence[Attachable]) -> Sequence[Attachable]:
        """Return the forces, with stages that measure them."""
        return forces

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable]
    ) -> Sequence[Attachable]:
        """Return the boundaries, with stages that measure them.

        `inner` are the `walls` after changes by earlier observers.
        """
        return inner

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages at the end of each substep (if `in_substeps`)."""
        return []

    def allocate(self, model: Model, workers: int) -> None:
        """Allocate sums for each worker (if `in_gathers`)."""

    def record(
        self, part: Part, worker: int, model: Model, state: State, tracks: Tracks
    ) -> Recorded:
        """Record the kernel launch after each transfer to a worker's particles (if `in_gathers`).

        Args:
            part: A worker's particles of one law.
            worker: Index of the worker.
            model: The particles' constants.
            state: The state after the gather.
            tracks: Quantities that change over time.
        """
        raise NotImplementedError

    def bind(self, solver: AnySolver, observers: Sequence[Observer]) -> None:
        """Connect the observer to the solver and to other observers."""
        self._solver: Any = solver

    def change(self, scene: Scene) -> None:
        """Continue with the forces, boundaries and stiffness of another scene."""

    def skip_to(self, index: int) -> float | None:
        """Return the time [s] of a frame if the frame needs no substeps, otherwise None."""

    def before_frame(self, time: float) -> None:
        """Prepare the frame that starts at `time` [s]."""

    def before_attempt(self, *, closely: bool) -> None:
        """Prepare an attempt to compute a frame; if `closely` is set, each substep is checked."""

    def after_substep(self) -> None:
        """Read the state after a substep, or after several in a CUDA graph."""

    def after_attempt(self) -> Violation | None:
        """Check the state at the end of a frame; an error ends the attempt."""

    def after_frame(self, frame: Frame) -> Frame:
        """Return the frame with this observer's results."""
        return frame

    def complete(self, clip: Clip) -> Clip:
        """Return the clip with this observer's results."""
        return clip

    def finished_effect(self, subject: Subject) -> Effect | None:
        """Return the entry in the report's list of effects after a run."""
        return self.effect(subject)

    def notes(self) -> list[str]:
        """Return notes for the user."""
        return []

    def report(self, frames: Sequence[Frame]) -> dict[str, Any]:
        """Return the observer's section of report.json; `frames` are all kept frames."""
        return {}


Kind = TypeVar("Kind", bound=Observer)


def find(observers: Iterable[Observer], kind: type[Kind]) -> Kind | None:
    """Return the observer of a class, or None."""
    return next((observer for observer in observers if isinstance(observer, kind)), None)


def snapshots(observers: Iterable[Observer]) -> dict[str, Any]:
    """Return the snapshots by class name."""
    return {type(observer).__name__: observer.snapshot() for observer in observers}


def restore_all(observers: Iterable[Observer], snapshot: dict[str, Any]) -> None:
    """Restore the observers that have a snapshot."""
    for observer in observers:
        if type(observer).__name__ in snapshot:
            observer.restore(snapshot[type(observer).__name__])
