"""The whole chain: picture -> foreground -> Gaussians -> moving Gaussians -> files.

Every function here reports progress and how long its stages take. A run that is refused or
cancelled leaves nothing behind; one that stops early keeps its good frames, and so does a cancelled
one if `keep` is set. Whatever else ends it (an error, want of room or memory, a kill), what is
computed stays: the clip before it is filmed, and the frames so far for `go_on`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from phy124.accuracy.choose import Goal, reach
from phy124.accuracy.forecast import Forecaster
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.imaging.cutout import Cutout
from phy124.io.clip import Clip
from phy124.io.files import staging as staging
from phy124.pipeline import resume
from phy124.pipeline.composing import into_photograph as into_photograph
from phy124.pipeline.gaussians import Static as Static
from phy124.pipeline.making import CUTOUT, PAUSE, Making
from phy124.pipeline.making import Result as Result
from phy124.pipeline.making import circumstances as circumstances
from phy124.pipeline.making import framed as framed
from phy124.pipeline.making import playback as playback
from phy124.pipeline.making import write_json as write_json
from phy124.pipeline.objects import check_sources as check_sources
from phy124.pipeline.objects import split
from phy124.pipeline.objects import static as static
from phy124.pipeline.objects import with_others as with_others
from phy124.pipeline.room import warn_of_room
from phy124.progress import Progress, silent
from phy124.rendering.film import cameras as cameras
from phy124.rendering.film import film as film
from phy124.rendering.film import rate as rate
from phy124.rendering.film import refuse_unfilmable
from phy124.runtime.context import RunContext
from phy124.runtime.cores import refuse_threads
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.scene.files import refuse_missing
from phy124.simulation import Simulation, prepare
from phy124.simulation.parts import WHOLE, Crop

PathLike = str | os.PathLike[str]


def generate(
    image: PathLike | Sequence[PathLike],
    scene: Scene,
    out: PathLike,
    *,
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress = silent,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
    keep: bool = False,
    **making: Any,
) -> Result:
    """Turn a picture into moving Gaussians, videos and a report in a folder.

    Args:
        image: The picture, or one for each object of the scene; a generator that is a .ply file
            does not look at it.
        scene: What happens to the object.
        out: The folder to write.
        device: Warp device, and where the generator runs.
        threads: CPU threads that simulate and draw; None: one for each core that is free.
        progress: Called with (stage, done, total); may raise Cancelled.
        goal: An error or a time; the accuracy is chosen to meet it (`phy124.accuracy.choose`).
        forecaster: Predicts the time of the run; the report compares it with the time taken.
        keep: Whether a cancelled run keeps its frames, so that `go_on` can continue it.
        **making: How the Gaussians are made: the options of `static`.

    Raises:
        InputError: The picture, the scene or the options cannot be used.
        Incomplete: Not all could be computed or written; it says what is kept, and where.
        Cancelled: `progress` raised it.
    """
    refuse_threads(threads)
    refuse_missing(scene)
    check_sources(scene, split(image)[1])
    refuse_unfilmable(scene)
    watch = Stopwatch()
    with staging(out):  # Refused before any work, if at all.
        options: dict[str, Any] = {"device": device, "progress": progress, "watch": watch}
        made = static(image, scene, **options, **making)
        return simulate(
            made.gaussians,
            made.scene,
            out,
            **options,
            about=made.about,
            crop=made.crop,
            cutout=made.cutout,
            goal=goal,
            forecaster=forecaster,
            keep=keep,
            threads=threads,
        )


def simulate(
    gaussians: Gaussians,
    scene: Scene,
    out: PathLike,
    *,
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    about: dict[str, Any] | None = None,
    crop: Crop = WHOLE,
    cutout: Cutout | None = None,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
    keep: bool = False,
    films: bool = True,
    rescues: bool = True,
    each: Callable[[Simulation, Frame], object] = lambda run, frame: None,
) -> Result:
    """Turn static Gaussians into moving ones, videos and a report in a folder.

    Args:
        gaussians: The object at any size, standing upright, facing +x.
        scene: What happens to it.
        out: The folder to write.
        device: Warp device.
        threads: CPU threads that simulate and draw; None: one for each core that is free.
        progress: Called with (stage, done, total); may raise Cancelled.
        watch: Where the durations of the stages are recorded.
        about: What the report says about how the Gaussians were made.
        crop: Where the object is in the picture that the masks of parts were painted on.
        cutout: The cut-out, to be saved beside the results.
        goal: An error or a time; the accuracy is chosen to meet it (`phy124.accuracy.choose`).
        forecaster: Predicts the time of the run; the report compares it with the time taken.
        keep: Whether a run that `progress` cancels is filmed and kept, so that `go_on` can
            continue it.
        films: Whether videos are made.
        rescues: Whether what is computed is kept, and told of by Incomplete, if the run fails or
            its folder has no room.
        each: Called with the simulation and every frame as soon as it is computed, but not for the
            grids that are tried to meet a `goal`.

    Raises:
        InputError: The Gaussians, the scene or the folder cannot be used.
        Incomplete: Not all could be computed or written; it says what is kept, and where.
        Cancelled: `progress` raised it.
    """
    refuse_missing(scene)
    if films:
        refuse_unfilmable(scene)
    watch = watch or Stopwatch()
    png = None if cutout is None else cutout.png()
    making = Making(
        Path(out), device, progress, watch, dict(about or {}), keep, png, films, threads,
        rescues=rescues,
    )  # fmt: skip

    def seen(run: Simulation, frame: Frame) -> None:
        making.recording.see(run)
        each(run, frame)

    def moved() -> tuple[Simulation, Clip]:
        context = RunContext(device=device, threads=threads, progress=progress, watch=watch)
        if goal is not None:
            see = making.recording.see
            reached = reach(
                goal, gaussians, scene, context, elapsed=watch.total, crop=crop, see=see
            )
            making.about["goal"] = reached.about
            return reached.simulation, reached.clip
        run = Simulation(prepare(gaussians, scene, context, crop=crop))
        warn_of_room(run, making.out, films=films)
        if forecaster is not None:
            with watch.stage("forecast"):
                making.predicted = forecaster.of(run)
        return run, run.run(partial(seen, run))

    return making.result(moved)


def go_on(
    out: PathLike,
    scene: Scene | None = None,
    *,
    any_accuracy: bool = False,
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress = silent,
    keep: bool = False,
) -> Result:
    """Continue the run that was interrupted in a folder, bit for bit as if it had not been.

    Args:
        out: The folder of the interrupted run.
        scene: The scene that it must have; None: any.
        any_accuracy: Whether its accuracy may differ from the scene's, as it does with a goal.
        device: Warp device.
        threads: CPU threads; None: as many as before. With another number the run goes on within
            rounding.
        progress: Called with (stage, done, total); may raise Cancelled.
        keep: Whether it is kept again if `progress` cancels it.

    Raises:
        InputError: There is no interrupted run, another process goes on with it, or it has another
            scene.
    """
    refuse_threads(threads)
    path, watch = Path(out) / PAUSE, Stopwatch()
    if not path.is_file():
        limit = "no interrupted run was left there."
        raise InputError("resume", out, limit, "Leave --resume out to start from the beginning.")
    about = resume.read_about(path)
    if scene is not None:
        asked, paused = scene.data(), about["scene"]
        if any_accuracy:
            asked["accuracy"] = paused["accuracy"]
        for own, found in zip(asked.get("objects", ()), paused.get("objects", ()), strict=False):
            own["crop"] = found.get("crop")  # no option: its picture has told it
        _refuse_other(asked, paused, out)
    refuse_unfilmable(Scene.from_data(about["scene"], str(path)))
    frames = resume.frames_of(path)
    making = Making(
        Path(out), device, progress, watch,
        {name: value for name, value in about.items() if name not in ("scene", "frames")}, keep,
        resume.read_files(path).get(CUTOUT), threads=threads, frames=frames,
        continued=about["frames"],
    )  # fmt: skip

    def moved() -> tuple[Simulation, Clip]:
        context = RunContext(device=device, threads=threads, progress=progress, watch=watch)
        run = resume.load(path, context, frames=frames)
        warn_of_room(run, making.out, films=True)
        return run, run.run(lambda _: making.recording.see(run))

    return making.result(moved)


def _refuse_other(scene: dict[str, Any], paused: dict[str, Any], out: PathLike) -> None:
    """Raise InputError if two scenes differ; it names the field."""
    asked, found = _flat(scene), _flat(paused)
    for name in {**asked, **found}:
        if asked.get(name) != found.get(name):
            both = name in asked and name in found
            what = f"{name} = {found[name]}, not {asked[name]}" if both else f"different {name}"
            remedy = "Give the options of that run, or leave --resume out to start again."
            raise InputError("resume", out, f"the interrupted run has {what}.", remedy)


def _flat(data: Any, name: str = "") -> dict[str, Any]:
    """Nested data as a single level: "time.frames" -> 14."""
    parts = data.items() if isinstance(data, dict) else enumerate(data)
    flat: dict[str, Any] = {}
    for key, value in parts:
        path = f"{name}.{key}" if name else str(key)
        nested = isinstance(value, dict) or (
            isinstance(value, (list, tuple)) and any(isinstance(v, dict) for v in value)
        )
        flat |= _flat(value, path) if nested else {path: value}
    return flat
