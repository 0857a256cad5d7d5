"""What a visitor tells of the object beside its picture: other views, a depth map, a thickness, and
whether it is filmed in there; or which way up a file of Gaussians is.

Names, ranges and choices are those of the command line, whose classes declare them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from phy124.errors import InputError
from phy124.generators import make as make_generator
from phy124.generators.depth_map import DepthMap
from phy124.generators.other_views import OtherViews
from phy124.generators.ply_file import Reading
from phy124.imaging.cutout import cut_out as opened
from phy124.io.axes import orientation
from phy124.runtime.isolated import Deadline
from phy124.schema.refusals import explain
from phy124.schema.section import Section

from .pictures import check_picture, cut_out, cutout_file, viewable
from .settings import Settings
from .source import Cutout, Source
from .visitors import Visitors

PICTURES = ("side", "back", "depth")
"""Options that name a picture."""
AXES = ("up", "front")
"""Options for a file of Gaussians."""
NO_DEPTH, NO_VIEWS, NO_READING = DepthMap(), OtherViews(), Reading()


class Photographed(Section):
    """Whether the object is filmed in its photograph."""

    compose: bool = Field(
        default=False,
        description="Film the object in the photograph as well, in place of itself, with its "
        "shadow; takes longer.",
    )


NOT_PHOTOGRAPHED = Photographed()


@dataclass(frozen=True)
class Known:
    """What is known of an object beside its picture from the front."""

    depth: DepthMap = NO_DEPTH
    views: OtherViews = NO_VIEWS
    """Names the cut-outs of its pictures, which `cut` makes."""
    sent: tuple[Path, ...] = ()
    """Those pictures as they were sent."""
    reading: Reading = NO_READING
    """Which way up the file of Gaussians is."""
    photographed: Photographed = NOT_PHOTOGRAPHED
    """Whether it is filmed in its photograph, which changes nothing of the Gaussians."""

    def cut(self, deadline: Deadline) -> None:
        """Cut the object out of the other views, unless that is done.

        Raises:
            InputError: No object can be found in one.
        """
        for (field, made), picture in zip(self.views.pictures.items(), self.sent, strict=True):
            if made.exists():
                continue
            try:
                cut_out(viewable(picture, deadline), made, deadline=deadline)
            except InputError as error:
                limit = f"{field.capitalize()}: {error.limit}"
                raise InputError(field, error.value, limit, error.remedy) from error

    def suited(self, source: Source) -> Known:
        """The same for this object: the axes of a file are its most likely ones unless told.

        Raises:
            InputError: Something was told that is no use for such an object.
        """
        if isinstance(source, Cutout):
            _refuse(self.reading, "It is for a file of Gaussians.")
            return self
        _refuse(self.depth, "A file of Gaussians needs none.")
        _refuse(self.views, "A file of Gaussians has all sides already.")
        _refuse(self.photographed, "A file of Gaussians comes with no photograph.")
        up, front = self.reading.up, self.reading.front
        front = front or (None if up else source.axes.front)
        return replace(self, reading=Reading(up=up or source.axes.up, front=front))

    def about(self, source: Source) -> tuple[tuple[str, Any], ...]:
        """Entries of the report that say what the object was made of."""
        if isinstance(source, Cutout):
            return (("generator", "relief"),)
        file = {**self.reading.model_dump(include=set(AXES)), "program": source.axes.program}
        told = {"generator": source.format, "file": file, "cleaning": list(source.notes)}
        return tuple(told.items())

    def generator(self, name: str) -> Any:
        """The generator of a name or a file, told of all this."""
        if self.reading != NO_READING:
            return make_generator(name, self.reading)
        generator = self.depth.given_to(make_generator(name), name)
        return self.views.given_to(generator, name, lambda field, path: opened(path, field=field))

    def data(self) -> list[Any]:
        """What Gaussians depend on, as plain data; names of files stand for their content."""
        told = (self.depth, self.views, self.reading)
        return [section.model_dump(mode="json") for section in told]


NOTHING_MORE = Known()


def options() -> dict[str, Any]:
    """The JSON schemas of all that can be told, by option."""
    return {**_fields(OtherViews), **_fields(DepthMap), **_fields(Photographed)}


def _fields(section: type[Section]) -> dict[str, Any]:
    return section.model_json_schema()["properties"]


def known_of(visitors: Visitors, settings: Settings, name: str, told: Any) -> Known:
    """What a visitor tells, checked.

    Args:
        visitors: Whose pictures may be named.
        settings: The page's limits.
        name: The visitor's name.
        told: Values by option; absent and None are the defaults.

    Raises:
        InputError: An option has an invalid value, or names no upload of this visitor.
    """
    if not isinstance(told, dict | None):
        limit = "It must be an object of values by option."
        raise InputError("known", type(told).__name__, limit, 'Give {"thickness": 0.6}, say.')
    given = {option: value for option, value in (told or {}).items() if value is not None}
    sent = {option: _sent(visitors, settings, name, option, given[option]) for option in PICTURES
            if option in given}  # fmt: skip
    depth = {option: given.pop(option) for option in DepthMap.model_fields if option in given}
    axes = {option: given.pop(option) for option in AXES if option in given}
    film = {option: given.pop(option) for option in Photographed.model_fields if option in given}
    views = given | dict(_cutouts(visitors, name, sent))
    if "depth" in sent:
        depth["depth"] = sent.pop("depth")
    reading = _checked(Reading, axes)
    orientation(reading.up, reading.front)  # refuses directions that are none
    return Known(
        _checked(DepthMap, depth), _checked(OtherViews, views), tuple(sent.values()), reading,
        _checked(Photographed, film),
    )  # fmt: skip


def _sent(visitors: Visitors, settings: Settings, name: str, option: str, given: Any) -> Path:
    upload = visitors.own(name, given)
    check_picture(upload, settings, option)
    return upload


def _cutouts(visitors: Visitors, name: str, sent: dict[str, Path]) -> Iterator[tuple[str, Path]]:
    for option, picture in sent.items():
        if option in OtherViews.model_fields:
            yield option, cutout_file(visitors.get(name), picture)


def _refuse(section: Section, why: str) -> None:
    """Refuse what is told in a section; raises InputError."""
    for option, value in section.model_dump(exclude_defaults=True).items():
        raise InputError(option, value, why, "Leave it out.")


def _checked(section: type[Any], values: dict[str, Any]) -> Any:
    try:
        return section.model_validate(values)
    except ValidationError as error:
        raise explain(error, "known", section) from None
