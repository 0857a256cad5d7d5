"""Runs the whole chain: picture -> foreground -> Gaussians -> moving Gaussians -> files.

`generate` makes Gaussians from a picture and calls `simulate`. `go_on` continues an interrupted
run. A run that is refused leaves no files. A cancelled run saves its finished frames only if `keep`
is set. A run that the solver stops early always saves its finished frames. If a run ends in any
other way, the finished frames stay on disk for `go_on`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phy124.accuracy.choose import Goal, run_for_goal
from phy124.accuracy.forecast import Forecaster
from phy124.accuracy.goal import refuse_forecast
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.imaging.cutout import Cutout
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip
from phy124.io.files import staging as staging
from phy124.pipeline import resume
from phy124.pipeline.disk_space import warn_of_disk_space
from phy124.pipeline.gaussians import StaticObject as StaticObject
from phy124.pipeline.gaussians import check_sources as check_sources
from phy124.pipeline.gaussians import make_gaussians as make_gaussians
from phy124.pipeline.gaussians import split
from phy124.pipeline.gaussians import with_others as with_others
from phy124.pipeline.inputs import describe_inputs as describe_inputs
from phy124.pipeline.inputs import refuse_other_inputs
from phy124.pipeline.run_folder import CUTOUT, PAUSE, RunFolder
from phy124.pipeline.run_folder import Result as Result
from phy124.pipeline.run_folder import playback as playback
from phy124.pipeline.run_folder import refuse_folder as refuse_folder
from phy124.pipeline.run_folder import view_report as view_report
from phy124.pipeline.run_folder import write_json as write_json
from phy124.rendering.film import cameras as cameras
from phy124.rendering.film import film as film
from phy124.rendering.film import refuse_unfilmable
from phy124.runtime.compiling import looking_up
from phy124.runtime.context import RunContext
from phy124.runtime.cores import refuse_threads
from phy124.scene import Scene
from phy124.scene.files import refuse_missing
from phy124.simulation import Simulation, prepare
from phy124.simulation.solver import kernels

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from phy124.runtime.context import ContextOptions

PathLike = str | os.PathLike[str]


def generate(
    image: PathLike | Sequence[PathLike],
    scene: Scene,
    out: PathLike,
    context: RunContext | None = None,
    *,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
    keep: bool = False,
    error: bool = True,
    **making: Any,
) -> Result:
    """Turn a picture into moving Gaussians; write the Gaussians, videos and a report into a folder.

    Args:
        image: The picture, or one picture for each object of the scene.
        scene: The scene to simulate.
        out: The folder to write.
        context: Device, threads, progress and stopwatch.
        goal: Largest error or longest time, for which the accuracy is chosen
            (`phy124.accuracy.choose`).
        forecaster: Predicts the time of the run. The report states the predicted and the actual
            time. A run with a maximum error has none.
        keep: Whether a cancelled run keeps its frames for `go_on`.
        error: Whether to estimate the error of the run, if the estimate takes little time.
        **making: `device`, `threads` and `progress` if there is no context, and options of
            `phy124.pipeline.gaussians.make_object`.

    Raises:
        InputError: The picture, the scene or the options cannot be used.
        Incomplete: Not everything could be computed or written; the message names the saved files.
        Cancelled: `progress` raised it.
    """
    context = RunContext.pop(context, making)
    refuse_forecast(goal, forecaster is not None, "forecast")
    refuse_threads(context.threads)
    refuse_missing(scene)
    first, more = split(image)
    check_sources(scene, more)
    refuse_unfilmable(scene)
    refuse_folder(Path(out), scene.view, [Path(path) for path in (first, *more)])
    with staging(out):  # An unusable folder is refused before any work.
        inputs = describe_inputs([first, *more], scene, making)
        with looking_up(kernels(scene, context.device), context.device):
            made = make_gaussians(image, scene, context, **making)
        return simulate(
            made.gaussians,
            made.scene,
            out,
            context,
            about={**made.about, "inputs": inputs},
            crop=made.crop,
            cutout=made.cutout,
            goal=goal,
            forecaster=forecaster,
            keep=keep,
            error=error,
        )


def simulate(
    gaussians: Gaussians,
    scene: Scene,
    out: PathLike,
    context: RunContext | None = None,
    *,
    about: dict[str, Any] | None = None,
    crop: Crop = WHOLE,
    cutout: Cutout | None = None,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
    keep: bool = False,
    films: bool = True,
    rescues: bool = True,
    error: bool = True,
    each: Callable[[Simulation, Frame], object] | None = None,
    **fields: Unpack[ContextOptions],
) -> Result:
    """Make static Gaussians move; write the moving Gaussians, videos and a report into a folder.

    Args:
        gaussians: The object at any size, standing upright, facing +x.
        scene: The scene to simulate.
        out: The folder to write.
        context: Device, threads, progress and stopwatch.
        about: Entries of the report that describe how the Gaussians were made.
        crop: Position of the object in the picture on which the masks of parts were painted.
        cutout: The cut-out, which is saved with the results.
        goal: Largest error or longest time, for which the accuracy is chosen
            (`phy124.accuracy.choose`).
        forecaster: Predicts the time of the run. The report states the predicted and the actual
            time. A run with a maximum error has none.
        keep: Whether a cancelled run saves and renders its frames, for `go_on`.
        films: Whether videos are made.
        rescues: Whether finished frames are saved if the run fails or its folder has no space.
        error: Whether to estimate the error of the run, if the estimate takes little time
            (`phy124.accuracy.companion`).
        each: Called with the simulation and every frame, except in trial runs for `goal`. If the
            goal is an error, all calls follow the last run.
        **fields: `device`, `threads` and `progress`, if there is no context.

    Raises:
        InputError: The Gaussians, the scene or the folder cannot be used.
        Incomplete: Not everything could be computed or written; the message names the saved files.
        Cancelled: `progress` raised it.
    """
    context = RunContext.of(context, **fields)
    refuse_forecast(goal, forecaster is not None, "forecast")
    refuse_missing(scene)
    if films:
        refuse_unfilmable(scene)
    refuse_folder(Path(out), scene.view if films else None)
    png = None if cutout is None else cutout.png()
    folder = RunFolder(
        Path(out), context, dict(about or {}), keep, png, films=films, rescues=rescues, error=error
    )

    def begin(run: Simulation) -> None:
        warn_of_disk_space(run, folder.out, films=films)

    def run_scene() -> tuple[Simulation, Clip]:
        if goal is not None:
            reached = run_for_goal(
                goal,
                gaussians,
                scene,
                context,
                elapsed=context.watch.total,
                crop=crop,
                forecaster=forecaster or Forecaster(context, error),
                begin=begin,
                see=folder.recording.see,
                each=each,
            )
            folder.about["goal"] = reached.about
            folder.predicted = reached.forecast if forecaster is not None else None
            return reached.simulation, reached.clip
        setup = prepare(gaussians, scene, context, crop=crop)
        with ThreadPoolExecutor(1, "proportions") as pool:
            pool.submit(lambda: setup.proportions)  # computed now, for the report
            run = Simulation(setup)
        begin(run)
        if forecaster is not None:
            with context.watch.stage("forecast"):
                folder.predicted = forecaster.of(run, error=folder.error)
        return run, run.run(each and partial(each, run), record=folder.recording.see, shapes=False)

    return folder.fill(run_scene)


def go_on(
    out: PathLike,
    scene: Scene | None = None,
    context: RunContext | None = None,
    *,
    inputs: dict[str, str] | None = None,
    any_accuracy: bool = False,
    keep: bool = False,
    error: bool = True,
    **fields: Unpack[ContextOptions],
) -> Result:
    """Continue an interrupted run in its folder.

    With equal numbers of threads, the result equals that of an uninterrupted run bit for bit.

    Args:
        out: The folder of the interrupted run.
        scene: The expected scene of the run; None if any scene is accepted.
        context: Device, threads, progress and stopwatch; without a number of threads, the previous
            number is used.
        inputs: The expected inputs (`describe_inputs`); None if any inputs are accepted.
        any_accuracy: Whether the accuracies of the run and of `scene` may differ, as with a goal.
        keep: Whether the run is saved again if `progress` cancels it.
        error: Whether to estimate the error of the run, if the estimate takes little time.
        **fields: `device`, `threads` and `progress`, if there is no context.

    Raises:
        InputError: There is no interrupted run, another process is continuing it, or its scene
            or inputs differ from `scene` or `inputs`.
    """
    context = RunContext.of(context, **fields)
    refuse_threads(context.threads)
    path = Path(out) / PAUSE
    if not path.is_file():
        limit = "this folder has no interrupted run."
        raise InputError("resume", out, limit, "Remove --resume to start from the beginning.")
    about = resume.read_about(path)
    if scene is not None:
        asked, paused = scene.data(), about["scene"]
        if any_accuracy:
            asked["accuracy"] = paused["accuracy"]
        objects = zip(asked.get("objects", ()), paused.get("objects", ()), strict=False)
        for asked_object, paused_object in objects:
            # The crop is not chosen by the user: it was read from the picture.
            asked_object["crop"] = paused_object.get("crop")
        _refuse_other(asked, paused, out)
    if inputs is not None and "inputs" in about:  # a run from Python may have no files
        refuse_other_inputs(inputs, about["inputs"], out)
    interrupted = Scene.from_data(about["scene"], str(path))
    refuse_unfilmable(interrupted)
    refuse_folder(Path(out), interrupted.view)
    entries = {name: value for name, value in about.items() if name not in ("scene", "frames")}
    cutout = resume.read_files(path).get(CUTOUT)
    frames = resume.frames_of(path)  # locked until `fill` ends
    folder = RunFolder(
        Path(out),
        context,
        entries,
        keep,
        cutout,
        frames=frames,
        continued=about["frames"],
        error=error,
    )

    def run_scene() -> tuple[Simulation, Clip]:
        run = resume.load(path, context, frames=frames)
        warn_of_disk_space(run, folder.out, films=True)
        return run, run.run(record=folder.recording.see, shapes=False)

    return folder.fill(run_scene)


def _refuse_other(scene: dict[str, Any], paused: dict[str, Any], out: PathLike) -> None:
    asked, before = _flat(scene), _flat(paused)
    for name in {**asked, **before}:
        if asked.get(name) != before.get(name):
            both = name in asked and name in before
            what = f"{name} = {before[name]}, not {asked[name]}" if both else f"different {name}"
            remedy = "Repeat the options of the interrupted run, or remove --resume to start again."
            raise InputError("resume", out, f"the interrupted run has {what}.", remedy)


def _flat(data: Any, name: str = "") -> dict[str, Any]:
    parts = data.items() if isinstance(data, dict) else enumerate(data)
    flat: dict[str, Any] = {}
    for key, value in parts:
        path = f"{name}.{key}" if name else str(key)
        nested = isinstance(value, dict) or (
            isinstance(value, (list, tuple)) and any(isinstance(v, dict) for v in value)
        )
        flat |= _flat(value, path) if nested else {path: value}
    return flat
