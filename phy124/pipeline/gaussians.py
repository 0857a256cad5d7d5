"""From a picture to static Gaussians: every choice that makes them is declared here, once."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators import Generator, needs_image
from phy124.generators import make as make_generator
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import UNCHANGED, Effort, GeneratorOptions, effort_of
from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.cutout import Cutout, cut_out
from phy124.imaging.objects import Point
from phy124.particles.thinning import thin, with_count
from phy124.pipeline.capture import capture
from phy124.progress import Progress, silent
from phy124.runtime.isolated import Deadline
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation.parts import Crop, crop_of

PathLike = str | os.PathLike[str]


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
    effort: Effort | None
    """What the generator was forecast to take, if it takes long."""


def static(
    image: PathLike,
    scene: Scene | None = None,
    *,
    generator: str | Generator = "relief",
    options: GeneratorOptions = UNCHANGED,
    reading: Reading | None = None,
    method: str = "auto",
    mask: PathLike | None = None,
    pick: Point | None = None,
    depth: DepthMap | None = None,
    views: OtherViews | None = None,
    looked: Callable[[Cutout], object] = lambda cutout: None,
    announce: Callable[[Effort], object] = lambda effort: None,
    stand_in: bool = False,
    count: int | None = None,
    device: str = "cpu",
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Static:
    """Turn a picture into static Gaussians.

    Args:
        image: The picture; a generator that is a .ply file does not look at it.
        scene: What will happen to them; None: the default scene.
        generator: Name, path of a .ply file, or a generator itself.
        options: How much work the generator does.
        reading: How to interpret that .ply file, and whether to find its floor.
        method: How the object is cut out, see `phy124.imaging.cutout.foreground`.
        mask: Picture that is white where the object is.
        pick: A place on the object that is meant, if there are several.
        depth: Depth map of the picture, for `relief`.
        views: Further pictures of the object, for `relief`.
        looked: Called with each cut-out before the long work begins.
        announce: Called with what the generator will take, if it takes long, before it begins.
        stand_in: Whether `relief` takes the place of a generator that takes long, for a forecast.
        count: Largest number of Gaussians.
        device: Where the generator runs, by Warp's name.
        progress: Called with (stage, done, total); may raise Cancelled.
        watch: Where the durations of the stages are recorded.

    Raises:
        InputError: The picture or the options cannot be used.
    """
    watch, scene = watch or Stopwatch(), scene or Scene()
    name = generator if isinstance(generator, str) else type(generator).__name__
    make = with_count(make_generator(generator, reading, options, device), count)
    make = depth.bind(make, name) if depth else make
    deadline = Deadline(beat=partial(progress, "cut out", 0, 1))
    if views:
        way = method if mask is None else "auto"
        cut = partial(_cut_view, method=way, deadline=deadline, looked=looked, watch=watch)
        make = views.bind(make, name, cut)
    cutout, picture = None, Image.new("RGBA", (1, 1))
    if needs_image(generator):
        with watch.stage("image"):
            cutout = cut_out(image, method, mask=mask, pick=pick, deadline=deadline)
            progress("cut out", 1, 1)
        looked(cutout)
        picture = cutout.picture
    else:
        _refuse_cutting(name, mask=mask, pick=pick)
    about: dict[str, Any] = {
        "foreground": cutout and cutout.method,
        "cutout": cutout and cutout.data(),
        "generator": name,
        "cleaning": [],
        "notes": [],
    }
    with watch.stage("generate"):
        effort = effort_of(make)
        if effort is not None:
            announce(effort)
            about["effort"] = {**effort.settings, "predicted": effort.seconds}
            make = with_count(make_generator("relief"), count) if stand_in else make
        if isinstance(make, PlyFile):
            read = capture(make, scene, count=count, progress=progress)
            gaussians, scene = read.gaussians, read.scene
            about |= {"cleaning": read.cleaning, "notes": [*read.notes], **read.about}
        else:
            gaussians = make(picture, seed=scene.seed, progress=progress)
            gaussians = thin(gaussians, count, seed=scene.seed)
    return Static(gaussians, scene, crop_of(picture), cutout, about, effort)


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


def _refuse_cutting(generator: str, **told: Any) -> None:
    """Check that nothing is told of a picture that the generator does not look at.

    Raises:
        InputError: Something is.
    """
    for name, value in told.items():
        if value is not None:
            limit = f"{generator} does not look at a picture."
            raise InputError(name, value, limit, "Leave it out, or choose another generator.")
