"""Optional inputs in addition to the front picture, named as on the command line.

For a file of Gaussians, the only optional input is the orientation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from phy124.errors import InputError
from phy124.generators import is_present
from phy124.generators import make as make_generator
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import effort_of
from phy124.generators.ply_file import Reading
from phy124.imaging.cutout import cut_out as open_view
from phy124.io.axes import orientation
from phy124.runtime.isolated import Deadline
from phy124.schema.refusals import validate
from phy124.schema.section import Section

from .pictures import check_picture, cut_out, cutout_file, viewable
from .settings import Settings
from .source import Cutout, Source
from .visitors import Visitors

PICTURES = ("side", "back", "depth")
"""Optional inputs that are uploaded pictures: other views of the object, and a depth map."""
AXES = ("up", "front")
"""Options for a file of Gaussians: the axes that point upwards and to the front."""
NO_DEPTH, NO_VIEWS, NO_READING = DepthMap(), OtherViews(), Reading()


class Photographed(Section):
    """Option to render the object in the photograph that the visitor sent."""

    compose: bool = False
    """Also film the moving object inside its photograph, with its shadow; this takes longer."""


NOT_PHOTOGRAPHED = Photographed()


class Making(Section):
    """Option for the generator, which creates the object from the picture."""

    generator: Literal["relief", "triposr"] = "relief"
    """Generator of the object: relief guesses the unseen sides from the silhouette, in a second;
    triposr is a trained network, which takes longer.
    """

    def seconds(self) -> float:
        """Predict the time of the generator's network under the current machine load [s]."""
        if self.generator == "relief":
            return 0.0
        effort = effort_of(make_generator(self.generator))
        return effort.seconds if effort else 0.0


NOT_CHOSEN = Making()


@dataclass(frozen=True)
class ExtraInputs:
    """Optional inputs in addition to the front picture."""

    depth: DepthMap = NO_DEPTH
    views: OtherViews = NO_VIEWS
    """Cut-outs of the other views, which `cut_views` creates."""
    sent: tuple[Path, ...] = ()
    """Pictures of the other views before the background is removed."""
    reading: Reading = NO_READING
    photographed: Photographed = NOT_PHOTOGRAPHED
    """Whether to render the object in its photograph. This does not affect the Gaussians."""
    making: Making = NOT_CHOSEN

    def cut_views(self, deadline: Deadline) -> None:
        """Create the missing cut-outs of the other views.

        Raises:
            InputError: No object is found in one of the pictures.
        """
        for (field, path), picture in zip(self.views.pictures.items(), self.sent, strict=True):
            if path.exists():
                continue
            try:
                cut_out(viewable(picture, deadline), path, deadline=deadline)
            except InputError as error:
                limit = f"{field.capitalize()}: {error.limit}"
                raise InputError(field, error.value, limit, error.remedy) from error

    def suit(self, source: Source) -> ExtraInputs:
        """Return the inputs for an object; if no axes are set, use the likely axes of the file.

        Raises:
            InputError: An input does not apply to this kind of object.
        """
        if isinstance(source, Cutout):
            _refuse(self.reading, "This option is only for a file of Gaussians.")
            return self
        _refuse(self.depth, "A file of Gaussians needs no depth.")
        _refuse(self.views, "A file of Gaussians has all sides already.")
        _refuse(self.photographed, "A file of Gaussians comes with no photograph.")
        _refuse(self.making, "A file of Gaussians needs no generator.")
        up, front = self.reading.up, self.reading.front
        front = front or (None if up else source.axes.front)
        return replace(self, reading=Reading(up=up or source.axes.up, front=front))

    def about(self, source: Source) -> tuple[tuple[str, Any], ...]:
        """Return the report's entries about the source of the object."""
        if isinstance(source, Cutout):
            return (("generator", self.making.generator),)
        file = {**self.reading.model_dump(include=set(AXES)), "program": source.axes.program}
        about = {"generator": source.format, "file": file, "cleaning": list(source.notes)}
        return tuple(about.items())

    def generator(self, name: str) -> Any:
        """Create a generator with these inputs; choose it by its name or by the file's type."""
        if self.reading != NO_READING:
            return make_generator(name, self.reading)
        generator = self.depth.bind(make_generator(name), name)
        return self.views.bind(generator, name, lambda field, path: open_view(path, field=field))

    def data(self) -> list[Any]:
        """Return the inputs that determine the Gaussians, as plain data with file names."""
        sections = (self.depth, self.views, self.reading)
        return [section.model_dump(mode="json") for section in sections]


NO_EXTRAS = ExtraInputs()


def options() -> dict[str, Any]:
    """Return the JSON schemas of the optional inputs, by option name."""
    sections: list[type[Section]] = [OtherViews, DepthMap, Photographed]
    sections += [Making] if is_present("triposr") else []
    return {
        name: schema
        for section in sections
        for name, schema in section.model_json_schema()["properties"].items()
    }


def extras_of(visitors: Visitors, settings: Settings, name: str, values: Any) -> ExtraInputs:
    """Validate a visitor's optional inputs.

    Args:
        visitors: All visitors.
        settings: The page's limits.
        name: The visitor's name.
        values: Values of the options. None means the default.

    Raises:
        InputError: An option has an invalid value, or names a file that this visitor did not
            upload.
    """
    if not isinstance(values, dict | None):
        limit = "It must be an object that maps options to values."
        raise InputError("known", type(values).__name__, limit, 'Give {"thickness": 0.6}, say.')
    rest = {option: value for option, value in (values or {}).items() if value is not None}
    sent: dict[str, Path] = {}
    for option in PICTURES:
        if option in rest:
            sent[option] = visitors.find_upload(name, rest[option])
            check_picture(sent[option], settings, option)
    depth = {option: rest.pop(option) for option in DepthMap.model_fields if option in rest}
    axes = {option: rest.pop(option) for option in AXES if option in rest}
    film = {option: rest.pop(option) for option in Photographed.model_fields if option in rest}
    making = validate(Making, {o: rest.pop(o) for o in Making.model_fields if o in rest}, "known")
    if making != NOT_CHOSEN and not is_present(making.generator):
        limit = "This server does not have the generator's weights."
        raise InputError("generator", making.generator, limit, "Remove `generator`.")
    if "depth" in sent:
        depth["depth"] = str(sent.pop("depth"))
    cutouts = {option: cutout_file(visitors.expect(name), path) for option, path in sent.items()}
    reading = validate(Reading, axes, "known")
    orientation(reading.up, reading.front)  # raises an error for invalid axes
    return ExtraInputs(
        validate(DepthMap, depth, "known"),
        validate(OtherViews, rest | cutouts, "known"),
        tuple(sent.values()),
        reading,
        validate(Photographed, film, "known"),
        making,
    )


def _refuse(section: Section, why: str) -> None:
    for option, value in section.model_dump(exclude_defaults=True).items():
        raise InputError(option, value, why, "Remove it.")
