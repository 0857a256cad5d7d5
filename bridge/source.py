"""Open clips, and run simulations as streams of frames."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import GeneratorOptions
from phy124.generators.ply_file import Reading
from phy124.imaging.cutting import Cutting
from phy124.io.clip import Clip
from phy124.io.flaws import describe_flaws
from phy124.io.formats import is_file_of_gaussians
from phy124.io.opening import obstacle

if TYPE_CHECKING:
    from phy124.imaging.cutout import Cutout
    from phy124.pipeline import StaticObject
    from phy124.scene import Scene
    from phy124.simulation import Simulation

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LiveOptions:
    """Options of a running simulation (`--live`)."""

    live: bool = False
    """Simulate the source (a picture or a file of Gaussians) while it is shown."""
    scene: str = "press"
    """Preset (see `phy124 scenes`) or path of a .toml file."""
    set: tuple[str, ...] = field(default_factory=tuple)
    """Any values of the scene, as KEY=VALUE: accuracy=draft, time.frames=48."""
    generator: str = "relief"
    """Generator that turns a picture into Gaussians."""
    device: str = "auto"
    """Device that simulates: auto, cpu or cuda:0."""
    more: tuple[Path, ...] = ()
    """Pictures, or files of Gaussians, of the scene's further objects."""
    reading: Reading = field(default_factory=Reading)
    effort: GeneratorOptions = field(default_factory=GeneratorOptions)
    cutting: Cutting = field(default_factory=Cutting)
    depth: DepthMap = field(default_factory=DepthMap)
    views: OtherViews = field(default_factory=OtherViews)

    def check(self) -> None:
        """Refuse options that need `--live` if `--live` is missing.

        Raises:
            InputError: An option that needs `--live` is set.
        """
        if not self.live and self != LiveOptions():
            limit = "Options of a simulation were given, but a saved clip is only played."
            raise InputError("live", self.live, limit, "Add --live, or remove these options.")

    def resolve(self) -> Scene:
        """Return the scene with the changes of `--set`. Unless `--set` says otherwise, frames have
        velocities.
        """
        from phy124.scene import Scene, parse_changes

        return Scene.named(self.scene).replaced({"velocities": True, **parse_changes(self.set)})


class LiveRun:
    """A simulation that does not store its frames, because they might not fit into the memory."""

    def __init__(self, source: Path, options: LiveOptions) -> None:
        """Check the source, a picture or a file of Gaussians, and the scene.

        Raises:
            InputError: The source does not exist, or the scene cannot be used.
        """
        self.scene = options.resolve()
        refuse_unopened(source)
        self._source, self._options = source, options
        self._simulation: Simulation | None = None
        self.stopped: str | None = None
        """Reason why the simulation ended early, or None."""

    def __len__(self) -> int:
        return self.scene.time.frames

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames when they are computed; `stopped` states why the run ended early."""
        from phy124.simulation import Stopped

        try:
            yield from self.prepare()
        except Stopped as stop:
            self.stopped = str(stop)

    def prepare(self) -> Simulation:
        """Create the object and its solver unless they exist; raise InputError on failure."""
        if self._simulation is None:
            self._simulation = self._make()
        return self._simulation

    def _make(self) -> Simulation:
        import warp

        from phy124.runtime.context import RunContext
        from phy124.runtime.device import pick_device
        from phy124.simulation import Simulation, prepare

        device = pick_device(self._options.device)
        # This hides the messages that Warp prints during compilation.
        warp.config.log_level = warp.LOG_ERROR
        made = make_object(self._source, self._options, self.scene, device)
        self.scene = made.scene
        # Frames are passed to sinks and not stored, so that memory does not limit the length of the
        # run.
        context = RunContext(device=device)
        setup = prepare(made.gaussians, made.scene, context, crop=made.crop, keep=False)
        return Simulation(setup)

    def report(self) -> dict[str, Any]:
        """Return the report of the run."""
        report = self.prepare().report()
        complete = report["complete"] and self.stopped is None
        return {**report, "complete": complete, "stopped": self.stopped}


def refuse_unopened(source: Path) -> None:
    """Refuse a source that cannot be opened.

    Raises:
        InputError: The source cannot be opened.
    """
    if hindrance := obstacle(source):
        limit, remedy = hindrance
        raise InputError("source", source, limit[0].upper() + limit[1:], remedy)


class FileWatch:
    """Notices if another program writes into a clip that is being played.

    The arrays of a clip are memory-mapped from the file. If the file becomes shorter, the system
    kills a process that reads them. A file that is deleted or replaced stays readable.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._before = self._state()

    def check(self) -> None:
        """Check that the file has not changed. A file that was replaced by another file is
        accepted.

        Raises:
            InputError: Another program wrote into the file.
        """
        now = self._state()
        if now and self._before and now[:2] == self._before[:2] and now != self._before:
            limit = "Another program wrote into this file while it was played."
            remedy = "To replace a clip while it is played, write a new file and then rename it."
            raise InputError("clip", self._path, limit, remedy)

    def _state(self) -> tuple[int, ...]:
        try:
            state = Path(self._path).stat()
        except OSError:
            return ()
        return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns


def open_clip(path: str | Path) -> Clip:
    """Open a clip; log values that cannot be shown."""
    clip = Clip.load(path)
    for flaw in describe_flaws(clip):
        log.warning(flaw)
    return clip


def make_object(source: Path, options: LiveOptions, scene: Scene, device: str) -> StaticObject:
    """Make the Gaussians and the scene for a picture or a file; raise InputError on failure.

    Args:
        source: The picture or the file.
        options: The generator and its options.
        scene: The scene.
        device: Device on which the generator runs.
    """
    from phy124.pipeline import make_gaussians

    def look(cutout: Cutout) -> None:
        for note in cutout.notes:
            log.warning(note)
        if cutout.warnings:
            see = f"Look at the cut-out with `phy124 cutout {source}`."
            mend = "If it is wrong, use --pick or --mask in both commands."
            for sentence in (*cutout.warnings, f"{see} {mend}"):
                log.warning(sentence)

    made = make_gaussians(
        [source, *options.more],
        scene,
        generator=str(source) if is_file_of_gaussians(source) else options.generator,
        options=options.effort,
        reading=options.reading,
        depth=options.depth,
        views=options.views,
        **options.cutting.arguments(),
        on_cutout=look,
        on_estimate=lambda effort: log.info(
            "%s: %s; about %.0f s", options.generator, effort.words, effort.seconds
        ),
        device=device,
    )
    for sentence in (*made.about["notes"], *made.about["cleaning"]):
        log.warning(sentence)
    return made
