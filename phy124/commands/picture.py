"""Options of every command that makes Gaussians from a picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro

from phy124.accuracy.forecast import Load, format_span
from phy124.commands.cutout import CutoutOptions
from phy124.commands.options import GeneratorName
from phy124.errors import InputError
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import Effort, GeneratorOptions
from phy124.generators.ply_file import Reading
from phy124.schema.section import Section


@dataclass(frozen=True)
class PictureOptions:
    """How a picture becomes Gaussians."""

    generator: GeneratorName = "relief"
    effort: Annotated[GeneratorOptions, tyro.conf.arg(name="")] = field(
        default_factory=GeneratorOptions
    )
    reading: Annotated[Reading, tyro.conf.arg(name="")] = field(default_factory=Reading)
    gaussians: int | None = None
    """Number of Gaussians: about so many from relief (default 50,000), otherwise the maximum."""
    cutting: Annotated[CutoutOptions, tyro.conf.arg(name="")] = field(default_factory=CutoutOptions)
    depth: Annotated[DepthMap, tyro.conf.arg(name="")] = field(default_factory=DepthMap)
    views: Annotated[OtherViews, tyro.conf.arg(name="")] = field(default_factory=OtherViews)

    def given(self) -> dict[str, Any]:
        """The options as `phy124.pipeline.make_gaussians` takes them."""
        return {
            "generator": self.generator, "options": self.effort, "reading": self.reading,
            "count": self.gaussians, "depth": self.depth, "views": self.views,
            **self.cutting.arguments(),
        }  # fmt: skip

    def refuse_without_picture(self) -> None:
        """Check that nothing is told of a picture where there is none.

        Raises:
            InputError: Something is.
        """
        self.reading.refuse("image", "none")
        usual = PictureOptions()
        for option, value in vars(self).items():
            if value != getattr(usual, option):
                name = option
                if isinstance(value, Section):
                    name = next(iter(value.model_dump(exclude_defaults=True)))
                limit = f"--{name} is for a picture."
                raise InputError("image", "none", limit, "Add --image FILE, or leave that out.")


def told(generator: str, effort: Effort) -> str:
    """What a generator is about to do, and for how long, as a line of text."""
    return f"generator: {generator}, {effort.words}; likely {format_span(span(effort))}"


def span(effort: Effort) -> tuple[float, float]:
    """Shortest and longest time expected [s]; how busy the machine is has been measured with it."""
    return Load().span(effort.seconds)
