"""The whole chain: picture -> foreground -> Gaussians -> moving Gaussians -> files.

Every function here reports progress and how long its stages take. A run that fails or is cancelled
leaves nothing behind; one that stops early keeps its good frames, and so does a cancelled one if
`keep` is set.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from PIL import Image

from phy124 import resume
from phy124.accuracy.choose import Goal, reach
from phy124.accuracy.forecast import Forecaster
from phy124.capture import capture
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.generators import Generator, needs_image
from phy124.generators import make as make_generator
from phy124.generators.depth_map import DepthMap
from phy124.generators.other_views import OtherViews
from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.cutout import Cutout, cut_out
from phy124.imaging.objects import Point
from phy124.io.clip import Clip
from phy124.io.files import staged as staged
from phy124.particles.thinning import asked_for, thinned
from phy124.parts import WHOLE, Crop, crop_of
from phy124.pipeline.making import PAUSE, Making
from phy124.pipeline.making import Result as Result
from phy124.pipeline.making import circumstances as circumstances
from phy124.pipeline.making import framed as framed
from phy124.pipeline.making import playback as playback
from phy124.pipeline.making import write_json as write_json
from phy124.progress import Progress, silent
from phy124.rendering.film import cameras as cameras
from phy124.rendering.film import film as film
from phy124.rendering.film import rate as rate
from phy124.rendering.film import refuse_unfilmable
from phy124.runtime.isolated import Deadline
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.scene.files import refuse_missing
from phy124.simulation import Simulation

PathLike = str | os.PathLike[str]


def generate(
    image: PathLike,
    scene: Scene,
    out: PathLike,
    *,
    generator: str | Generator = "relief",
    reading: Reading | None = None,
    method: str = "auto",
    mask: PathLike | None = None,
    pick: Point | None = None,
    depth: DepthMap | None = None,
    views: OtherViews | None = None,
    looked: Callable[[Cutout], object] = lambda cutout: None,
    count: int | None = None,
    device: str = "cpu",
    progress: Progress = silent,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
    keep: bool = False,
) -> Result:
    """Turn a picture into moving Gaussians, videos and a report in a folder.

    Args:
        image: The picture; a generator that is a .ply file does not look at it.
        scene: What happens to the object.
        out: The folder to write.
        generator: Name, path of a .ply file, or a generator itself.
        reading: How to interpret that .ply file, and whether to find its floor.
        method: How the object is cut out, see `phy124.imaging.cutout.foreground`.
        mask: Picture that is white where the object is.
        pick: A place on the object that is meant, if there are several.
        depth: Depth map of the picture, for `relief`.
        views: Further pictures of the object, for `relief`.
        looked: Called with each cut-out before the long work begins.
        count: Largest number of Gaussians.
        device: Warp device.
        progress: Called with (stage, done, total); may raise Cancelled.
        goal: An error or a time; the accuracy is chosen to meet it (`phy124.accuracy.choose`).
        forecaster: Predicts the time of the run; the report compares it with the time taken.
        keep: Whether a cancelled run keeps its frames, so that `go_on` can continue it.

    Raises:
        InputError: The picture, the scene or the options cannot be used.
        Cancelled: `progress` raised it.
    """
    scene.refuse_nameless()
    refuse_missing(scene)
    refuse_unfilmable(scene)
    watch = Stopwatch()
    with staged(out):  # Refused before any work, if at all.
        made = static(
            image,
            scene,
            generator=generator,
            reading=reading,
            method=method,
            mask=mask,
            pick=pick,
            depth=depth,
            views=views,
            looked=looked,
            count=count,
            progress=progress,
            watch=watch,
        )
        return simulate(
            made.gaussians,
            made.scene,
            out,
            device=device,
            progress=progress,
            watch=watch,
            about=made.about,
            crop=made.crop,
            cutout=made.cutout,
            goal=goal,
            forecaster=forecaster,
            keep=keep,
        )


@dataclass(frozen=True)
class Static:
    """The object made from a picture, before anything happens to it."""

    gaussians: Gaussians
    scene: Scene
    """The scene for it; for a capture with the floor that was found, and regions in metres."""
    crop: Crop
    """Where the object is in the picture."""
    cutout: Cutout | None
    """The cut-out; None without a picture."""
    about: dict[str, Any]
    """How the object was cut out, and which generator made the Gaussians."""


def static(
    image: PathLike,
    scene: Scene | None = None,
    *,
    generator: str | Generator = "relief",
    reading: Reading | None = None,
    method: str = "auto",
    mask: PathLike | None = None,
    pick: Point | None = None,
    depth: DepthMap | None = None,
    views: OtherViews | None = None,
    looked: Callable[[Cutout], object] = lambda cutout: None,
    count: int | None = None,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Static:
    """Turn a picture into static Gaussians.

    Args:
        image: The picture; a generator that is a .ply file does not look at it.
        scene: What will happen to them; None: the default scene.
        generator: Name, path of a .ply file, or a generator itself.
        reading: How to interpret that .ply file, and whether to find its floor.
        method: How the object is cut out, see `phy124.imaging.cutout.foreground`.
        mask: Picture that is white where the object is.
        pick: A place on the object that is meant, if there are several.
        depth: Depth map of the picture, for `relief`.
        views: Further pictures of the object, for `relief`.
        looked: Called with each cut-out before the long work begins.
        count: Largest number of Gaussians.
        progress: Called with (stage, done, total); may raise Cancelled.
        watch: Where the durations of the stages are recorded.

    Raises:
        InputError: The picture or the options cannot be used.
    """
    watch, scene = watch or Stopwatch(), scene or Scene()
    make, cutout = asked_for(make_generator(generator, reading), count), None
    make = depth.given_to(make, _name(generator)) if depth else make
    deadline = Deadline(beat=partial(progress, "cut out", 0, 1))
    if views:
        way = method if mask is None else "auto"
        cut = partial(_cut_view, method=way, deadline=deadline, looked=looked, watch=watch)
        make = views.given_to(make, _name(generator), cut)
    picture = Image.new("RGBA", (1, 1))
    if needs_image(generator):
        with watch.stage("image"):
            cutout = cut_out(image, method, mask=mask, pick=pick, deadline=deadline)
            progress("cut out", 1, 1)
        looked(cutout)
        picture = cutout.picture
    elif mask is not None:
        limit = f"{_name(generator)} does not look at a picture."
        raise InputError("mask", mask, limit, "Leave the mask out, or choose another generator.")
    about = {
        "foreground": cutout and cutout.method,
        "cutout": cutout and cutout.data(),
        "generator": _name(generator),
        "cleaning": [],
    }
    with watch.stage("generate"):
        if isinstance(make, PlyFile):
            read = capture(make, scene, count=count, progress=progress)
            gaussians, scene = read.gaussians, read.scene
            about |= {"cleaning": read.cleaning, **read.about}
        else:
            gaussians = make(picture, seed=scene.seed, progress=progress)
            gaussians = thinned(gaussians, count, seed=scene.seed)
    return Static(gaussians, scene, crop_of(picture), cutout, about)


def _cut_view(
    field: str,
    path: Path,
    *,
    method: str,
    deadline: Deadline,
    looked: Callable[[Cutout], object],
    watch: Stopwatch,
) -> Cutout:
    """The object in a further picture, for the option of this name."""
    try:
        with watch.stage("image"):
            found = cut_out(path, method, field=field, deadline=deadline)
    except InputError as error:
        raise InputError(field, path, error.limit, error.remedy) from error
    looked(found)
    return found


def simulate(
    gaussians: Gaussians,
    scene: Scene,
    out: PathLike,
    *,
    device: str = "cpu",
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    about: dict[str, Any] | None = None,
    crop: Crop = WHOLE,
    cutout: Cutout | None = None,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
    keep: bool = False,
    films: bool = True,
    each: Callable[[Simulation, Frame], object] = lambda run, frame: None,
) -> Result:
    """Turn static Gaussians into moving ones, videos and a report in a folder.

    Args:
        gaussians: The object at any size, standing upright, facing +x.
        scene: What happens to it.
        out: The folder to write.
        device: Warp device.
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
        each: Called with the simulation and every frame as soon as it is computed, but not for the
            grids that are tried to meet a `goal`.

    Raises:
        InputError: The Gaussians, the scene or the folder cannot be used.
        Cancelled: `progress` raised it.
    """
    scene.refuse_nameless()
    refuse_missing(scene)
    if films:
        refuse_unfilmable(scene)
    watch = watch or Stopwatch()
    making = Making(Path(out), device, progress, watch, dict(about or {}), keep, cutout, films)

    def moved() -> tuple[Simulation, Clip]:
        options: dict[str, Any] = {"device": device, "progress": progress, "watch": watch}
        if goal is not None:
            reached = reach(goal, gaussians, scene, elapsed=watch.total, crop=crop, **options)
            making.about["goal"] = reached.about
            return reached.simulation, reached.clip
        run = Simulation(gaussians, scene, crop=crop, **options)
        if forecaster is not None:
            with watch.stage("forecast"):
                making.predicted = forecaster.of(run)
        return run, run.run(partial(each, run))

    return making.result(moved)


def go_on(
    out: PathLike,
    scene: Scene | None = None,
    *,
    any_accuracy: bool = False,
    device: str = "cpu",
    progress: Progress = silent,
    keep: bool = False,
) -> Result:
    """Continue the run that was interrupted in a folder, bit for bit as if it had not been.

    Args:
        out: The folder of the interrupted run.
        scene: The scene that it must have; None: any.
        any_accuracy: Whether its accuracy may differ from the scene's, as it does with a goal.
        device: Warp device.
        progress: Called with (stage, done, total); may raise Cancelled.
        keep: Whether it is kept again if `progress` cancels it.

    Raises:
        InputError: There is no interrupted run, or it has another scene.
    """
    path, watch = Path(out) / PAUSE, Stopwatch()
    if not path.is_file():
        limit = "no interrupted run was left there."
        raise InputError("resume", out, limit, "Leave --resume out to start from the beginning.")
    about = resume.read_about(path)
    if scene is not None:
        asked, paused = scene.data(), about["scene"]
        if any_accuracy:
            asked["accuracy"] = paused["accuracy"]
        _refuse_other(asked, paused, out)
    about = {name: value for name, value in about.items() if name not in ("scene", "frames")}
    making = Making(Path(out), device, progress, watch, about, keep)

    def moved() -> tuple[Simulation, Clip]:
        run = resume.load(path, device=device, progress=progress, watch=watch)
        return run, run.run()

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


def _name(generator: str | Generator) -> str:
    return generator if isinstance(generator, str) else type(generator).__name__
