"""`phy124 cutout` cuts an object out of a picture; other commands use its picture options."""

import json
import sys
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro
from pydantic import Field

from phy124.accuracy.load import Load, format_span
from phy124.commands.bars import Bars
from phy124.commands.options import GeneratorName
from phy124.errors import InputError
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import Effort, GeneratorOptions
from phy124.generators.ply_file import Reading
from phy124.imaging.cutout import Cutout, cut_out, title_of
from phy124.imaging.cutting import Cutting
from phy124.io.files import refuse_replacing, replacing
from phy124.runtime.installation import with_program
from phy124.runtime.isolated import Deadline
from phy124.schema.section import Section
from phy124.weights.store import search_first

KINDS = (".png", ".webp")
IF_WRONG = (
    "if it is not the object, give --pick X,Y (a point on it), --mask FILE (white where the object "
    "is) or a picture with transparency."
)


class CutoutOptions(Cutting):
    """Options for segmenting the object, and the folder with the weights of trained networks."""

    foreground: Annotated[str, tyro.conf.arg(aliases=["--method"])] = Field(
        default="auto", description=Cutting.model_fields["foreground"].description
    )
    weights: Path | None = None
    """Folder that is searched first for trained weights (see `phy124 doctor`)."""


@dataclass(frozen=True)
class CutOut:
    """Cut the object out of a picture, save the object, and print the method and any warnings."""

    image: tyro.conf.Positional[Path]
    """Picture of one object: PNG, JPEG, WebP, AVIF or HEIC."""
    options: Annotated[CutoutOptions, tyro.conf.arg(name="")] = field(default_factory=CutoutOptions)
    out: Path | None = None
    """PNG or WebP file to write; default out/PICTURE-cutout.png."""
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Cut out the object; print the method, the coverage, the warnings and the file's name.

        Raises:
            InputError: The picture cannot be read, or the output's name does not end in .png or
                .webp, or is that of a file that the command reads.
        """
        out = self.out or Path("out") / f"{self.image.stem}-cutout.png"
        if out.suffix.lower() not in KINDS:
            limit = "A cut-out needs a format with transparency."
            raise InputError("out", out, limit, "Use a name that ends in .png or .webp.")
        mask = self.options.mask
        refuse_replacing(out, [self.image, *([] if mask is None else [mask])])
        with ExitStack() as stack:
            try:
                if self.out is None:
                    out.parent.mkdir(exist_ok=True)
                temporary = stack.enter_context(replacing(out))
            except PermissionError as error:
                limit = f"it cannot be written ({error.strerror})."
                raise InputError("out", out, limit, "Choose another folder.") from None
            cutout = self._cut_out()
            cutout.save(temporary)
        if self.json:
            print(json.dumps({"file": str(out), **cutout.data()}))
        else:
            print(describe(cutout.data()))
            doubt(cutout, f"Look at {out}; {IF_WRONG}")
            print(out)
        return 0

    def _cut_out(self) -> Cutout:
        how = self.options
        with search_first(how.weights), Bars(quiet=self.json) as bars:
            deadline = Deadline(beat=partial(bars, "cut out", 0, 1))
            try:
                cutout = cut_out(
                    self.image, how.foreground, mask=how.mask, pick=how.point, deadline=deadline
                )
            except InputError as error:
                if error.field != "foreground":
                    raise
                raise InputError("method", error.value, error.limit, error.remedy) from None
            bars("cut out", 1, 1)
        return cutout


def describe(cutout: dict[str, Any]) -> str:
    """Describe how the object was cut out (`Cutout.data()`)."""
    return f"cut out by {title_of(cutout['method'])}: {cutout['coverage']:.1%} of the picture"


def doubt(cutout: Cutout, remedy: str) -> None:
    """Print a cut-out's notes and warnings on standard error; if there are warnings, add a
    remedy.
    """
    for note in cutout.notes:
        print(f"note: {note}", file=sys.stderr)
    for warning in cutout.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if cutout.warnings:
        print(f"warning: {with_program(remedy)}", file=sys.stderr)


@dataclass(frozen=True)
class PictureOptions:
    """Options for generating Gaussians from a picture."""

    generator: GeneratorName = "relief"
    effort: Annotated[GeneratorOptions, tyro.conf.arg(name="")] = field(
        default_factory=GeneratorOptions
    )
    reading: Annotated[Reading, tyro.conf.arg(name="")] = field(default_factory=Reading)
    gaussians: int | None = None
    """Number of Gaussians. The number is approximate for relief (default 50,000), and a maximum for
    other generators.
    """
    cutting: Annotated[CutoutOptions, tyro.conf.arg(name="")] = field(default_factory=CutoutOptions)
    depth: Annotated[DepthMap, tyro.conf.arg(name="")] = field(default_factory=DepthMap)
    views: Annotated[OtherViews, tyro.conf.arg(name="")] = field(default_factory=OtherViews)

    def arguments(self) -> dict[str, Any]:
        """Return the options as arguments of `phy124.pipeline.make_gaussians`."""
        return {
            "generator": self.generator,
            "options": self.effort,
            "reading": self.reading,
            "count": self.gaussians,
            "depth": self.depth,
            "views": self.views,
            **self.cutting.arguments(),
        }

    def list_changes(self) -> dict[str, Any]:
        """Return the options that differ from their defaults, by name."""
        usual, changed = PictureOptions(), dict[str, Any]()
        for name, value in vars(self).items():
            if isinstance(value, Section):
                changed |= value.model_dump(exclude_defaults=True)
            elif value != getattr(usual, name):
                changed[name] = value
        return changed

    def refuse_without_picture(self) -> None:
        """Refuse options that need a picture.

        Raises:
            InputError: An option that needs a picture is set.
        """
        self.reading.refuse("image", "none")
        for name in self.list_changes():
            limit = f"--{name} is for a picture."
            raise InputError("image", "none", limit, f"Add --image FILE, or remove --{name}.")


def announce_generator(generator: str, effort: Effort) -> str:
    """Format a generator's settings and expected duration as a line."""
    return f"generator: {generator}, {effort.words}; likely {format_span(span(effort))}"


def span(effort: Effort) -> tuple[float, float]:
    """Return the shortest and longest expected time [s] at the present load."""
    return Load().span(effort.seconds)
