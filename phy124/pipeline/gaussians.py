"""Turns pictures into static Gaussians, and declares all options of this step."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians, as_objects
from phy124.generators import Generator, needs_image
from phy124.generators import make as make_generator
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.mesh import mesh
from phy124.generators.options import UNCHANGED, Effort, GeneratorOptions, effort_of
from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.cutout import Cutout, cut_out
from phy124.imaging.objects import Point
from phy124.imaging.painted import WHOLE, Crop, crop_of
from phy124.io.clip import Clip
from phy124.io.formats import is_file_of_gaussians
from phy124.particles.thinning import note_few, thin, with_count
from phy124.pipeline.capture import capture
from phy124.runtime.context import RunContext
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene, preset_names
from phy124.schema.refusals import validate
from phy124.simulation.bodies import errors_prefixed_with, refuse_ids

PathLike = str | os.PathLike[str]
Data = Mapping[str, Any]
SHARED = ("generator", "count", "on_cutout")
CLIP = ".safetensors"


@dataclass(frozen=True)
class StaticObject:
    """Static Gaussians of a scene's objects."""

    gaussians: Gaussians
    """Gaussians of all objects, with `object_id` if there are several."""
    scene: Scene
    """The scene; for a capture, with the detected floor, and with regions in metres."""
    crop: Crop
    cutout: Cutout | None
    """The cut-out of the first object; None without a picture."""
    about: dict[str, Any]
    """Entries for the report about cut-out and generator."""
    effort: Effort | None
    """Predicted time of the generator; None if the generator is fast."""


class Objects(NamedTuple):
    """The objects of a scene that are made from pictures or files."""

    gaussians: Gaussians
    """Gaussians of the objects, with `object_id` if there are several."""
    scene: Scene
    """Each object of this scene stores its position in its picture."""
    about: dict[str, Any]


def make_gaussians(
    image: PathLike | Sequence[PathLike],
    scene: Scene | None = None,
    context: RunContext | None = None,
    **making: Any,
) -> StaticObject:
    """Turn one picture, or a picture for each object of a scene, into static Gaussians.

    Args:
        image: The picture of the first object, or several pictures. Further pictures are used, in
            order, for the `objects` without picture, file or shape. Missing pictures are replaced
            by copies of the first object.
        scene: The scene that the Gaussians are made for; None: the default scene.
        context: Device of the generator, progress and stopwatch.
        **making: Options of `make_object` for the first object, and fields of the context. Options
            in `SHARED` also apply to the other objects.

    Raises:
        InputError: A picture or the options cannot be used, or there are too many pictures.
    """
    scene, context = scene or Scene(), RunContext.pop(context, making)
    first, more = split(image)
    check_sources(scene, more)
    made = make_object(first, scene, context, **making)
    if not scene.objects:
        return made
    shared = {name: making[name] for name in SHARED if name in making}
    every = with_others(made.gaussians, made.scene, more, context, **shared)
    about = made.about | every.about
    return replace(made, gaussians=every.gaussians, scene=every.scene, about=about)


def make_object(
    image: PathLike,
    scene: Scene,
    context: RunContext,
    *,
    generator: str | Generator = "relief",
    options: GeneratorOptions | Data = UNCHANGED,
    reading: Reading | Data | None = None,
    method: str = "auto",
    mask: PathLike | None = None,
    pick: Point | None = None,
    depth: DepthMap | Data | None = None,
    views: OtherViews | Data | None = None,
    on_cutout: Callable[[Cutout], object] = lambda cutout: None,
    on_estimate: Callable[[Effort], object] = lambda effort: None,
    preview_with_relief: bool = False,
    count: int | None = None,
) -> StaticObject:
    """Turn the picture of one object into static Gaussians.

    Args:
        image: The picture; not used if the generator is a .ply file.
        scene: The scene that the Gaussians are made for.
        context: Device of the generator, progress and stopwatch.
        generator: Name of a generator, path of a .ply file, or a generator.
        options: Amount of work that the generator does.
        reading: How to interpret the generator's .ply file.
        method: Method of segmentation, see `phy124.imaging.cutout.foreground`.
        mask: Picture that is white where the object is.
        pick: A point on the object, if the picture shows several objects.
        depth: Depth map of the picture, for `relief`.
        views: Further pictures of the object, for `relief`.
        on_cutout: Called with each cut-out before the slow steps.
        on_estimate: Called with the forecast of a slow generator before it starts.
        preview_with_relief: Whether `relief` replaces a slow generator, so that a forecast takes
            little time.
        count: Largest number of Gaussians.

    Raises:
        InputError: The picture or the options cannot be used.
    """
    watch, progress = context.watch, context.progress
    options = validate(GeneratorOptions, options)
    reading = None if reading is None else validate(Reading, reading)
    depth = None if depth is None else validate(DepthMap, depth)
    views = None if views is None else validate(OtherViews, views)
    name = generator if isinstance(generator, str) else type(generator).__name__
    make = with_count(make_generator(generator, reading, options, context.device), count)
    make = depth.bind(make, name) if depth else make
    deadline = Deadline(beat=partial(progress, "cut out", 0, 1))

    def cut_view(field: str, path: Path) -> Cutout:
        """Cut the object out of a further picture; error messages name the option `field`."""
        try:
            with watch.stage("image"):
                way = method if mask is None else "auto"
                cutout = cut_out(path, way, field=field, deadline=deadline)
        except InputError as error:
            raise InputError(field, path, error.limit, error.remedy) from error
        on_cutout(cutout)
        return cutout

    if views:
        make = views.bind(make, name, cut_view)
    cutout, picture = None, Image.new("RGBA", (1, 1))
    if needs_image(generator):
        with watch.stage("image"):
            cutout = cut_out(image, method, mask=mask, pick=pick, deadline=deadline)
            progress("cut out", 1, 1)
        on_cutout(cutout)
        picture = cutout.picture
    else:
        for field, value in (("mask", mask), ("pick", pick)):
            if value is not None:
                limit = f"{name} does not use a picture."
                raise InputError(
                    field, value, limit, "Remove the picture, or choose another generator."
                )
    about: dict[str, Any] = {
        "foreground": cutout and cutout.method,
        "cutout": cutout and cutout.data(),
        "generator": name,
        "cleaning": [],
        "notes": [],
    }
    crop = crop_of(picture)
    with watch.stage("generate"):
        effort = effort_of(make)
        if effort is not None:
            on_estimate(effort)
            about["effort"] = {**effort.settings, "predicted": effort.seconds}
            make = with_count(make_generator("relief"), count) if preview_with_relief else make
        if isinstance(make, PlyFile):
            read = capture(make, scene, count=count, progress=progress)
            gaussians, scene, crop = read.gaussians, read.scene, read.crop
            about |= {"cleaning": read.cleaning, "notes": [*read.notes], **read.about}
        else:
            with _errors_naming_files(depth, views):
                gaussians = make(picture, seed=scene.seed, progress=progress)
            about["notes"] += note_few(make, len(gaussians), count)
            gaussians = thin(gaussians, count, seed=scene.seed)
    return StaticObject(gaussians, scene, crop, cutout, about, effort)


@contextmanager
def _errors_naming_files(depth: DepthMap | None, views: OtherViews | None) -> Iterator[None]:
    """Add the file's name to errors about a depth map or a further picture in this context.

    Raises:
        InputError: The original error, with the file as the value.
    """
    files: dict[str, object] = {} if views is None else {**views.pictures}
    if depth is not None:
        files["depth"] = depth.depth
    try:
        yield
    except InputError as error:
        if error.field not in files:
            raise
        file = files[error.field]
        raise InputError(error.field, file, error.limit, error.remedy) from error


def with_others(
    first: Gaussians,
    scene: Scene,
    more: Sequence[PathLike] = (),
    context: RunContext | None = None,
    *,
    generator: str | Generator = "relief",
    count: int | None = None,
    on_cutout: Callable[[Cutout], object] = lambda cutout: None,
) -> Objects:
    """Return the first object together with the other objects.

    Args:
        first: The Gaussians of the first object, or of several objects, with `object_id`.
        scene: The scene.
        more: Pictures or files for the objects that name no source themselves, in order.
        context: Device of the generator, progress and stopwatch.
        generator: Generator for pictures, unless an object names another generator.
        count: Largest number of Gaussians of each object.
        on_cutout: Called with each cut-out before the slow steps.

    Raises:
        InputError: A picture or file cannot be used, or there are more pictures and files than
            objects.
    """
    check_sources(scene, more)
    if not scene.objects:
        return Objects(first, scene, {})
    refuse_ids(first, scene)
    context, remaining = context or RunContext(), iter(more)
    usual = generator if needs_image(generator) else "relief"
    made = {index: first.of_object(index) for index in range(len(scene.objects) + 1)}
    objects, about = list(scene.objects), {}
    for index, body in enumerate(scene.objects, 1):
        if body.mesh is not None and not len(made[index]):
            with errors_prefixed_with(scene, index):
                solid = mesh(body.mesh, body.colour, seed=scene.seed)
            made[index] = thin(solid, count, seed=scene.seed)
            about[body.name] = {"source": body.mesh.name, "generator": "mesh"}
        source = (next(remaining, None) if body.waits else None) or body.picture or body.file
        if source is None:
            continue
        if Path(source).suffix == CLIP:
            with errors_prefixed_with(scene, index):
                rest, crop = at_rest(source)
            made[index] = thin(rest, count, seed=scene.seed)
            objects[index - 1] = body.model_copy(update={"crop": crop or body.crop})
            about[body.name] = {"source": Path(source).name, "generator": "clip"}
            continue
        maker = str(source) if is_file_of_gaussians(source) else body.generator or usual
        with errors_prefixed_with(scene, index):
            other = make_object(
                source,
                scene.alone(index),
                context,
                generator=maker,
                count=count,
                on_cutout=on_cutout,
            )
        made[index] = other.gaussians
        if other.cutout is not None or other.crop != WHOLE:
            objects[index - 1] = body.model_copy(update={"crop": other.crop})
        about[body.name] = {"source": Path(source).name, **other.about}
    scene = scene.model_copy(update={"objects": tuple(objects)})
    gaussians = as_objects({index: body for index, body in made.items() if len(body)})
    return Objects(gaussians, scene, {"sources": about} if about else {})


def split(image: PathLike | Sequence[PathLike]) -> tuple[PathLike, tuple[PathLike, ...]]:
    """Return the first picture, and the other pictures as a tuple."""
    if isinstance(image, (str, os.PathLike)):
        return image, ()
    first, *more = image
    return first, tuple(more)


def check_sources(scene: Scene, more: Sequence[PathLike]) -> None:
    """Refuse more pictures than there are objects that need a picture.

    Raises:
        InputError: There are too many pictures.
    """
    waiting = sum(body.waits for body in scene.objects)
    if len(more) <= waiting:
        return
    several = [name for name in preset_names() if any(o.waits for o in Scene.named(name).objects)]
    limit = (
        f"the scene has {waiting} further objects that need a picture."
        if waiting
        else "the scene takes one picture."
    )
    remedy = f"Remove it, or choose a scene of several objects: {', '.join(several)}."
    raise InputError("image", more[waiting], limit, remedy)


def at_rest(path: PathLike) -> tuple[Gaussians, Crop | None]:
    """Return the Gaussians at rest of a stored clip's only object, as `at_rest_in` does.

    Raises:
        InputError: The file is not a clip, or the clip has several objects.
    """
    gaussians, crop = at_rest_in(Clip.load(path))
    if gaussians.object_id is not None:
        remedy = "Give the pictures or files of Gaussians from which its objects were made."
        raise InputError("file", path, "it is a clip of several objects.", remedy)
    return gaussians, crop


def at_rest_in(clip: Clip) -> tuple[Gaussians, Crop | None]:
    """Return the Gaussians of a clip's objects in the first frame, without grains, and the first
    object's position in its picture (None in clips of earlier versions).
    """
    crop = clip.report.get("crop")
    return clip.surface.frame(0).gaussians, crop and tuple(crop)
