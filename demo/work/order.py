"""Orders: requests for runs that a click on the page sends, with the paths of the files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.budget.cost import GAUSSIANS
from phy124.generators.ply_file import PlyFile
from phy124.imaging.image import read_picture_size
from phy124.imaging.painted import Crop, crop_of
from phy124.pipeline.capture import adapt_scene
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene

from ..extras import NO_EXTRAS, ExtraInputs
from ..room import all_taken
from ..settings import Settings
from ..source import Cutout, GaussianFile, Source
from ..visitors import Visitor, key
from .others import Other, others_of

VIEWED = ("view", "accuracy", "description")
"""Fields of a scene that change neither its motion nor the errors measured on several grids."""

VECTOR, BYTES_SHOWN, BYTES_AT_REST = 12, 10, 200
"""Bytes that a Gaussian takes as a vector, in a frame of the viewer, and in the object at rest."""
BYTES_MOVED = 8
"""Bytes per frame and particle of a clip that stores particles instead of Gaussians.

The clip of an object that is swung takes 7 bytes per frame and particle (docs/lab/sizes.md).
"""
BYTES_OF_FILMS = 2_000_000
"""Approximate size of a run's videos [bytes]."""
COMPOSING, EACH = 210, 1800
"""Matching the camera and the colours of a video to a photograph takes as long as rendering
`COMPOSING` pictures and, in addition, `EACH` pixels per Gaussian.
"""


@dataclass(frozen=True)
class Order:
    """All inputs of a job that a click on the page starts."""

    folder: Path
    cutout: Path | None
    """The cut-out, a picture with alpha; None for a file of Gaussians."""
    scene: Scene
    stop: Path
    """File whose existence tells the job to stop."""
    seconds: float
    """Longest wall-clock time [s]."""
    max_particles: int
    expected: float = 0.0
    """Predicted wall-clock time [s]."""
    generator: str = "relief"
    """Name of the generator, or path of the file of Gaussians."""
    gaussians: int = GAUSSIANS
    """Number of Gaussians that are generated from each picture."""
    extras: ExtraInputs = NO_EXTRAS
    others: tuple[Other, ...] = ()
    photograph: Path | None = None
    """Picture in which the object is also rendered; browsers can show the format of the picture."""
    device: str = "auto"
    threads: int | None = None
    """Number of CPU threads; if None, one thread per free core."""
    about: tuple[tuple[str, str], ...] = ()
    levels: tuple[int, ...] = ()
    """Grids of an error study [number of cells across the object]; empty to render videos."""

    def picture(self) -> Image.Image:
        """Open the cut-out; without a cut-out, return an empty picture."""
        return Image.open(self.cutout) if self.cutout else Image.new("RGBA", (1, 1))

    @property
    def crop(self) -> Crop:
        """Position of the first object in its picture, on which the masks of parts were painted."""
        with self.picture() as cutout:
            return crop_of(cutout)

    def cut_views(self, deadline: Deadline) -> None:
        """Create missing cut-outs of further pictures; raise InputError if one has no object."""
        self.extras.cut_views(deadline)
        for other in self.others:
            other.make_cutout(deadline)


def folders(order: Order) -> tuple[Path, Path]:
    """Return the folders of the clip and the videos of an order."""
    physics = {name: value for name, value in order.scene.data().items() if name != "view"}
    clips = order.folder / "clips" / key(made_gaussians(order).name, physics)
    view = order.scene.view.model_dump(mode="json")
    more = ["composed"] if order.photograph else []
    return clips, order.folder / "films" / key(clips.name, view, *more)


def hide_uploads(order: Order, text: str) -> str:
    """Remove the visitor's folder from the paths of uploads in a scene's text."""
    return text.replace(f"{order.folder / 'uploads'}/", "")


def stages_done(order: Order) -> dict[str, Any]:
    """Return arguments of the forecast that state which stages of an order are already finished.

    `composed` is the cost of rendering in the photograph, expressed as a number of rendered pixels.
    """
    clips, films = ((folder / "report.json").exists() for folder in folders(order))
    pictures = (order.cutout is not None) + len(order.others)
    generated = not pictures or made_gaussians(order).exists()
    composed = 0.0
    if order.photograph is not None:
        width, height = read_picture_size(order.photograph)
        most_wide, most_high = order.scene.view.size
        scale = min(1.0, most_wide / width, most_high / height)
        drawn = width * height * scale**2 * (COMPOSING + order.scene.time.frames)
        composed = drawn + EACH * order.gaussians
    return {
        "generated": generated,
        "simulated": clips,
        "filmed": films,
        "pictures": max(pictures, 1),
        "composed": composed,
        "network": 0.0 if generated or clips else pictures * order.extras.making.seconds(),
    }


def made_gaussians(order: Order) -> Path:
    """Return the file that contains an order's Gaussians."""
    parts: list[Any] = [
        order.cutout.read_bytes() if order.cutout else b"",
        order.generator,
        order.gaussians,
        order.scene.seed,
        order.extras.data(),
        *([other.index, other.cutout.name] for other in order.others),
    ]
    name = key(*parts)
    return order.folder / "gaussians" / f"{name}.safetensors"


def trial_key(order: Order) -> str:
    """Return the key under which the run time from a trial run is stored."""
    composed = stages_done(order)["composed"]
    return key(made_gaussians(order).name, order.scene.data(), composed)


def made_by(order: Order) -> tuple[Path, ...]:
    """Return the folders and files that an order writes or reads."""
    return *folders(order), made_gaussians(order)


def bytes_of(scene: Scene, gaussians: int) -> float:
    """Estimate the size of a run's clip, videos and frames for the viewer [bytes].

    `gaussians` is the number of Gaussians of all objects.
    """
    more = VECTOR * (scene.velocities + scene.keeps_contacts)
    each = BYTES_MOVED + more + BYTES_SHOWN
    return gaussians * (each * scene.time.frames + BYTES_AT_REST) + BYTES_OF_FILMS


def bytes_to_write(order: Order) -> float:
    """Estimate the size of the files that an order will write [bytes]."""
    clips, films = ((folder / "report.json").exists() for folder in folders(order))
    if films or order.levels:
        return 0.0
    whole = bytes_of(order.scene, order.gaussians * (1 + len(order.others)))
    return BYTES_OF_FILMS if clips else whole


def study_file(order: Order) -> Path:
    """Return the file that stores the measured errors of an order's scene.

    Orders that differ only in the grid or the precision share one file.
    """
    physics = {name: value for name, value in order.scene.data().items() if name not in VIEWED}
    resolution = order.scene.resolution.model_dump(mode="json", exclude={"cells", "precision"})
    resolution["solver"] = order.scene.solver
    name = key(made_gaussians(order).name, physics, resolution)
    return order.folder / "studies" / f"{name}.json"


def order_of(
    visitor: Visitor, source: Source, scene: Scene, extras: ExtraInputs, limits: Settings
) -> Order:
    """Create the order for a visitor's request.

    Args:
        visitor: The visitor.
        source: The object's source.
        scene: The scene. The regions of the scene may be in the units of a file.
        extras: Optional inputs in addition to the front picture.
        limits: The page's limits.

    Raises:
        InputError: An input does not suit the object, or a region contains no part of the object.
    """
    each = limits.room.each
    size = bytes_of(scene, count_of(source, limits) * len(scene.names))
    if size > each:
        raise all_taken(size, each, "Choose fewer frames.")
    cutout = Path(source.path) if isinstance(source, Cutout) else None
    extras = extras.suit(source)
    if cutout is None:
        scene = adapt_scene(PlyFile(source.path, extras.reading), scene)
    return Order(
        folder=visitor.folder,
        cutout=cutout,
        scene=scene,
        stop=visitor.folder / "never",
        seconds=limits.max_seconds,
        max_particles=limits.max_particles,
        generator=extras.making.generator if cutout else source.path,
        gaussians=count_of(source, limits),
        extras=extras,
        others=others_of(visitor, scene, extras.making.generator),
        photograph=Path(source.picture) if extras.photographed.compose else None,
        device=limits.device,
        threads=limits.threads or None,
        about=extras.about(source),
    )


def count_of(source: Source | None, limits: Settings) -> int:
    """Return the number of Gaussians of an object."""
    return source.count if isinstance(source, GaussianFile) else limits.gaussians
