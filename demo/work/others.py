"""Further objects of a scene that are made from pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.errors import InputError
from phy124.imaging.painted import crop_of
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene

from ..pictures import HOW, cut_out, cutout_file, how_cut, viewable
from ..visitors import Visitor


@dataclass(frozen=True)
class Other:
    """A further object of the scene with its picture."""

    index: int
    """Index among the objects of the scene. The scene's first object has index 0."""
    name: str
    picture: Path
    cutout: Path
    """The cut-out, which `make_cutout` creates; its file name identifies the content."""
    generator: str = "relief"
    """Name of the generator, which is that of the first object's picture."""

    def make_cutout(self, deadline: Deadline) -> None:
        """Create the cut-out, unless it already exists.

        Raises:
            InputError: The picture shows no object.
        """
        if self.cutout.exists():
            return
        try:
            cut_out(viewable(self.picture, deadline), self.cutout, deadline=deadline)
        except InputError as error:
            limit = f"{self.name.capitalize()}: {error.limit}"
            field = f"objects.{self.index - 1}.picture"
            raise InputError(field, error.value, limit, error.remedy) from error

    @property
    def about(self) -> dict[str, Any]:
        """Entries in the report about the source of the object."""
        with Image.open(self.cutout) as cutout:
            return {"generator": self.generator, HOW: how_cut(cutout)}


def others_of(visitor: Visitor, scene: Scene, generator: str) -> tuple[Other, ...]:
    """Return the further objects of a scene that have a picture."""
    return tuple(
        Other(index, source.name, source.picture, cutout_file(visitor, source.picture), generator)
        for index, source in enumerate(scene.objects, 1)
        if source.picture is not None
    )


def with_crops(scene: Scene, others: tuple[Other, ...]) -> Scene:
    """Return a copy of the scene in which each of `others` has the crop of its cut-out."""
    objects = list(scene.objects)
    for other in others:
        with Image.open(other.cutout) as cutout:
            crop = crop_of(cutout)
        objects[other.index - 1] = objects[other.index - 1].model_copy(update={"crop": crop})
    return scene.model_copy(update={"objects": tuple(objects)})
