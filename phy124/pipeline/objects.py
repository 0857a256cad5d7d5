"""The further objects of a scene: each made from its own picture or file, as the first one is."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from phy124.errors import InputError
from phy124.gaussians import Gaussians, as_objects
from phy124.generators import Generator, needs_image
from phy124.generators.mesh import mesh
from phy124.imaging.cutout import Cutout
from phy124.io.clip import Clip
from phy124.io.formats import is_file_of_gaussians
from phy124.particles.thinning import thin
from phy124.pipeline.gaussians import Static
from phy124.pipeline.gaussians import static as one_static
from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene, preset_names
from phy124.simulation.bodies import named, refuse_ids

PathLike = str | os.PathLike[str]


CLIP = ".safetensors"
"""Ending of a clip."""


class Objects(NamedTuple):
    """The objects of a scene as far as they are made from pictures or files."""

    gaussians: Gaussians
    """With `object_id` if there are several."""
    scene: Scene
    """The scene, in which each object knows where it is in its picture."""
    about: dict[str, Any]
    """What the report says of how they were made."""


def static(
    image: PathLike | Sequence[PathLike], scene: Scene | None = None, **making: Any
) -> Static:
    """Turn a picture, or one for each object of a scene, into static Gaussians.

    Args:
        image: The picture, or several: the first object's, then those of the scene's `objects`
            that name no picture, file or shape, in order. What is missing is a copy of the first.
        scene: What will happen to them; None: the default scene.
        **making: The options of `phy124.pipeline.gaussians.static`, for the first object; the
            others share generator, number of Gaussians, device and callbacks.

    Raises:
        InputError: A picture or the options cannot be used, or there are too many pictures.
    """
    scene = scene or Scene()
    first, more = split(image)
    check_sources(scene, more)
    made = one_static(first, scene, **making)
    if not scene.objects:
        return made
    shared = {name: making[name] for name in SHARED if name in making}
    found = with_others(made.gaussians, made.scene, more, **shared)
    return replace(
        made, gaussians=found.gaussians, scene=found.scene, about=made.about | found.about
    )


SHARED = ("generator", "count", "looked", "device", "progress", "watch")
"""Options of the first object that hold for the others, too."""


def split(image: PathLike | Sequence[PathLike]) -> tuple[PathLike, tuple[PathLike, ...]]:
    """The first picture and the others."""
    if isinstance(image, (str, os.PathLike)):
        return image, ()
    first, *more = image
    return first, tuple(more)


def check_sources(scene: Scene, more: Sequence[PathLike]) -> None:
    """Check that a scene has an object for each further picture.

    Raises:
        InputError: There are more pictures than objects that wait for one.
    """
    waiting = sum(one.waits for one in scene.objects)
    if len(more) <= waiting:
        return
    several = [name for name in preset_names() if any(o.waits for o in Scene.named(name).objects)]
    limit = (
        f"the scene has {waiting} further objects that take a picture."
        if waiting
        else "the scene takes one picture."
    )
    remedy = f"Leave it out, or choose a scene of several objects: {', '.join(several)}."
    raise InputError("image", more[waiting], limit, remedy)


def at_rest(path: PathLike) -> Gaussians:
    """The object of a clip, as it is in the first frame.

    Raises:
        InputError: It is no clip, or one of several objects.
    """
    gaussians = Clip.load(path).surface.frame(0).gaussians
    if gaussians.object_id is not None:
        remedy = "Give the files of Gaussians or pictures that they were made of."
        raise InputError("file", path, "it is a clip of several objects.", remedy)
    return gaussians


def with_others(
    first: Gaussians,
    scene: Scene,
    more: Sequence[PathLike] = (),
    *,
    generator: str | Generator = "relief",
    count: int | None = None,
    looked: Callable[[Cutout], object] = lambda cutout: None,
    device: str = "cpu",
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Objects:
    """The first object and those that are made from pictures or files.

    Args:
        first: The Gaussians of the first object; or of several, with `object_id`.
        scene: The scene.
        more: Pictures or files for the objects that name none, in order.
        generator: What makes Gaussians of a picture, unless an object says otherwise.
        count: Largest number of Gaussians of each.
        looked: Called with each cut-out before the long work begins.
        device: Where the generator runs.
        progress: Called with (stage, done, total); may raise Cancelled.
        watch: Where the durations of the stages are recorded.

    Raises:
        InputError: A picture or file cannot be used, or there are too many.
    """
    check_sources(scene, more)
    if not scene.objects:
        return Objects(first, scene, {})
    refuse_ids(first, scene)
    by_hand = iter(more)
    usual = generator if needs_image(generator) else "relief"
    made = {index: first.of_object(index) for index in range(len(scene.objects) + 1)}
    objects, about = list(scene.objects), {}
    for index, one in enumerate(scene.objects, 1):
        if one.mesh is not None and not len(made[index]):
            with named(scene, index):
                whole = mesh(one.mesh, one.colour, seed=scene.seed)
            made[index] = thin(whole, count, seed=scene.seed)
            about[one.name] = {"source": one.mesh.name, "generator": "mesh"}
        source = (next(by_hand, None) if one.waits else None) or one.picture or one.file
        if source is None:
            continue
        if Path(source).suffix == CLIP:
            with named(scene, index):
                made[index] = thin(at_rest(source), count, seed=scene.seed)
            about[one.name] = {"source": Path(source).name, "generator": "clip"}
            continue
        makes = str(source) if is_file_of_gaussians(source) else one.generator or usual
        with named(scene, index):
            found = one_static(
                source, scene.alone(index), generator=makes, count=count, looked=looked,
                device=device, progress=progress, watch=watch,
            )  # fmt: skip
        made[index] = found.gaussians
        if found.cutout is not None:
            objects[index - 1] = one.model_copy(update={"crop": found.crop})
        about[one.name] = {"source": Path(source).name, **found.about}
    scene = scene.model_copy(update={"objects": tuple(objects)})
    gaussians = as_objects({index: one for index, one in made.items() if len(one)})
    return Objects(gaussians, scene, {"sources": about} if about else {})
