"""What one click asks for, and the files it makes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.budget.cost import BYTES_PER_GAUSSIAN, GAUSSIANS
from phy124.imaging.image import read_picture_size
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene

from ..known import NOTHING_MORE, Known
from ..visitors import key
from .others import Other

VIEWED = ("view", "accuracy", "description")
"""Fields that the stored errors of a scene's motion do not depend on."""

VECTOR, BYTES_SHOWN, BYTES_AT_REST = 12, 10, 200
"""Bytes of a Gaussian: of a vector, of what the viewer gets of a frame, and at rest."""
BYTES_OF_FILMS = 2_000_000
"""Of the videos of a run."""
COMPOSING, EACH = 210, 1800
"""Finding camera and colours of a photograph takes as long as drawing so many pictures of its size,
and so many pixels for each Gaussian."""


@dataclass(frozen=True)
class Order:
    """What one click asks for."""

    folder: Path
    """The visitor's folder."""
    cutout: Path | None
    """The cut-out, a picture with alpha; None for a file of Gaussians."""
    scene: Scene
    stop: Path
    """The file whose existence asks the job to stop."""
    seconds: float
    """Longest wall-clock time [s]."""
    max_particles: int
    generator: str = "relief"
    """Name of the generator, or the file of Gaussians."""
    gaussians: int = GAUSSIANS
    """Number of Gaussians that `relief` makes of each picture."""
    known: Known = NOTHING_MORE
    """What is told of the object beside its picture or file."""
    others: tuple[Other, ...] = ()
    """The further objects that have pictures of their own."""
    photograph: Path | None = None
    """The picture to film the object in as well, in a format that browsers can show."""
    device: str = "auto"
    threads: int | None = None
    """CPU threads; None: one for each core that is free."""
    about: tuple[tuple[str, str], ...] = ()
    """Further entries of the report."""
    levels: tuple[int, ...] = ()
    """Grids on which the scene's error is to be measured; empty: the scene is filmed instead."""

    def picture(self) -> Image.Image:
        """The cut-out, or a picture of nothing."""
        return Image.open(self.cutout) if self.cutout else Image.new("RGBA", (1, 1))

    def cut(self, deadline: Deadline) -> None:
        """Cut out of all other pictures what they show, unless that is done; raises InputError."""
        self.known.cut(deadline)
        for other in self.others:
            other.cut(deadline)


def folders(order: Order) -> tuple[Path, Path]:
    """The folders of the clip and of the films of an order."""
    physics = {name: value for name, value in order.scene.data().items() if name != "view"}
    clips = order.folder / "clips" / key(made_gaussians(order).name, physics)
    view = order.scene.view.model_dump(mode="json")
    more = ["composed"] if order.photograph else []
    return clips, order.folder / "films" / key(clips.name, view, *more)


def made_already(order: Order) -> dict[str, Any]:
    """Which stages of an order need not be run again, as arguments for the forecast.

    With them, under `composed`, the pixels that take as long as filming it in its photograph.
    """
    clips, films = ((folder / "report.json").exists() for folder in folders(order))
    pictures = (order.cutout is not None) + len(order.others)
    generated = not pictures or made_gaussians(order).exists()
    made = {
        "generated": generated, "simulated": clips, "filmed": films, "pictures": max(pictures, 1)
    }  # fmt: skip
    return {**made, "composed": _pixels_to_compose(order)}


def _pixels_to_compose(order: Order) -> float:
    if order.photograph is None:
        return 0.0
    width, height = read_picture_size(order.photograph)
    most_wide, most_high = order.scene.view.size
    scale = min(1.0, most_wide / width, most_high / height)
    return (
        width * height * scale**2 * (COMPOSING + order.scene.time.frames) + EACH * order.gaussians
    )


def made_gaussians(order: Order) -> Path:
    """The file of the Gaussians of an order."""
    told: list[Any] = [
        order.cutout.read_bytes() if order.cutout else b"",
        order.generator,
        order.gaussians,
        order.scene.seed,
        order.known.data(),
        *([other.index, other.cutout.name] for other in order.others),
    ]
    made = key(*told)
    return order.folder / "gaussians" / f"{made}.safetensors"


def made_by(order: Order) -> tuple[Path, ...]:
    """The folders and files that an order makes or uses."""
    return *folders(order), made_gaussians(order)


def bytes_of(scene: Scene, gaussians: int) -> float:
    """Size of a run's clip, its films and what is shown meanwhile [bytes], about.

    Args:
        scene: The scene.
        gaussians: Number of Gaussians of all objects.
    """
    more = VECTOR * (scene.velocities + scene.keeps_contacts)
    each = BYTES_PER_GAUSSIAN + more + BYTES_SHOWN
    return gaussians * (each * scene.time.frames + BYTES_AT_REST) + BYTES_OF_FILMS


def bytes_to_write(order: Order) -> float:
    """What an order will write [bytes], about."""
    clips, films = ((folder / "report.json").exists() for folder in folders(order))
    if films or order.levels:
        return 0.0
    whole = bytes_of(order.scene, order.gaussians * (1 + len(order.others)))
    return BYTES_OF_FILMS if clips else whole


def study_file(order: Order) -> Path:
    """The file of the errors of an order's scene, the same for every grid."""
    physics = {name: value for name, value in order.scene.data().items() if name not in VIEWED}
    kept = order.scene.resolution.model_dump(mode="json", exclude={"cells", "precision"})
    name = key(made_gaussians(order).name, physics, kept)
    return order.folder / "studies" / f"{name}.json"
