"""The further objects of a scene that have pictures of their own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.errors import InputError
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene
from phy124.simulation.parts import crop_of

from ..pictures import HOW, cut_out, cutout_file, how_cut, viewable
from ..visitors import Visitor


@dataclass(frozen=True)
class Other:
    """A further object and its picture."""

    index: int
    """Its number among the objects; the first object is 0."""
    name: str
    picture: Path
    """The picture as it was sent."""
    cutout: Path
    """Its cut-out, which `cut` makes; its name stands for its content."""

    def cut(self, deadline: Deadline) -> None:
        """Cut the object out, unless that is done.

        Raises:
            InputError: No object can be found.
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
        """What the report says of how it was made."""
        with Image.open(self.cutout) as cutout:
            return {"generator": "relief", HOW: how_cut(cutout)}


def others_of(visitor: Visitor, scene: Scene) -> tuple[Other, ...]:
    """The further objects of a scene whose pictures a visitor has sent."""
    return tuple(
        Other(index, one.name, one.picture, cutout_file(visitor, one.picture))
        for index, one in enumerate(scene.objects, 1)
        if one.picture is not None
    )


def cropped(scene: Scene, others: tuple[Other, ...]) -> Scene:
    """The scene, in which each of these objects knows where it is in its picture."""
    objects = list(scene.objects)
    for other in others:
        with Image.open(other.cutout) as cutout:
            crop = crop_of(cutout)
        objects[other.index - 1] = objects[other.index - 1].model_copy(update={"crop": crop})
    return scene.model_copy(update={"objects": tuple(objects)})
