"""`phy124 cutout`: only cuts the object out of a picture, to look at it before anything else."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro
from pydantic import Field

from phy124.commands.bars import Bars
from phy124.errors import InputError
from phy124.imaging.cutout import Cutout, cut_out, title_of
from phy124.imaging.cutting import Cutting
from phy124.io.files import replacing
from phy124.runtime.installation import with_program
from phy124.runtime.isolated import Deadline
from phy124.weights.store import search_first

KINDS = (".png", ".webp")
IF_WRONG = (
    "if it is not the object, give --pick X,Y (a place on it), --mask FILE (white where the object "
    "is) or a picture with transparency."
)


class CutoutOptions(Cutting):
    """How the object is cut out of its picture, and with which weights."""

    foreground: Annotated[str, tyro.conf.arg(aliases=["--method"])] = Field(
        default="auto", description=Cutting.model_fields["foreground"].description
    )
    weights: Path | None = Field(
        default=None,
        description="Folder to look for trained weights in first (see `phy124 doctor`).",
    )


@dataclass(frozen=True)
class CutOut:
    """Cut the object out of a picture, report how and whether it looks right, and save it."""

    image: tyro.conf.Positional[Path]
    """PNG, JPEG, WebP, AVIF or HEIC picture of one object."""
    options: Annotated[CutoutOptions, tyro.conf.arg(name="")] = field(default_factory=CutoutOptions)
    out: Path | None = None
    """PNG or WebP file to write; default out/PICTURE-cutout.png."""
    json: bool = False
    """Print as JSON and nothing else."""

    def run(self) -> int:
        """Cut out; prints method, coverage, warnings and the file.

        Raises:
            InputError: The picture or the name of the file cannot be used.
        """
        out = self.out or Path("out") / f"{self.image.stem}-cutout.png"
        if out.suffix.lower() not in KINDS:
            limit = "A cut-out needs a format with transparency."
            raise InputError("out", out, limit, "End the name in .png or .webp.")
        if self.out is None:
            out.parent.mkdir(exist_ok=True)
        with replacing(out) as temporary:
            cutout = self._cut_out()
            cutout.save(temporary)
        if self.json:
            print(json.dumps({"file": str(out), **cutout.data()}))
        else:
            print(described(cutout.data()))
            doubt(cutout, f"Look at {out}; {IF_WRONG}")
            print(out)
        return 0

    def _cut_out(self) -> Cutout:
        how = self.options
        with search_first(how.weights), Bars(quiet=self.json) as bars:
            deadline = Deadline(beat=partial(bars, "cut out", 0, 1))
            found = cut_out(
                self.image, how.foreground, mask=how.mask, pick=how.point, deadline=deadline
            )
            bars("cut out", 1, 1)
        return found


def described(cutout: dict[str, Any]) -> str:
    """How the object was cut out and how large it is, in words; takes `Cutout.data()`."""
    return f"cut out by {title_of(cutout['method'])}: {cutout['coverage']:.1%} of the picture"


def doubt(cutout: Cutout, remedy: str) -> None:
    """Print on standard error what makes the cut-out doubtful, and what to do."""
    for note in cutout.notes:
        print(f"note: {note}", file=sys.stderr)
    for warning in cutout.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if cutout.warnings:
        print(f"warning: {with_program(remedy)}", file=sys.stderr)
