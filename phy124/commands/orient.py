"""`phy124 orient` draws the Gaussians of a file with each possible up axis."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from phy124.commands.options import Device
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import Reading
from phy124.io.axes import FRONTS
from phy124.io.files import refuse_replacing, replacing
from phy124.rendering.orienting import candidates, draw_oriented, samples
from phy124.rendering.render import Renderer
from phy124.runtime.device import pick_device

SIZE = 320


@dataclass(frozen=True)
class Orient:
    """Draw a file of Gaussians with each of the six possible up axes. If the up axis is known, draw
    the four possible front directions.
    """

    file: tyro.conf.Positional[Path]
    """File of Gaussians whose up axis and front direction are unknown."""
    up: Annotated[str | None, tyro.conf.arg(metavar="AXIS")] = None
    """The axis that points up, if it is known. Only the four front directions are then drawn."""
    out: Path | None = None
    """PNG file to write; default out/FILE-orient.png."""
    device: Device = "auto"

    def run(self) -> int:
        """Draw the object in each possible orientation; print the path of the contact sheet.

        Raises:
            InputError: The file cannot be read, `up` is not an axis, or `out` is not a PNG file
                or is the file that is read.
        """
        out = self.out or Path("out") / f"{self.file.stem}-orient.png"
        if out.suffix.lower() != ".png":
            raise InputError(
                "out", out, "Only a PNG file can be written.", "Use a name that ends in .png."
            )
        if self.up is not None and self.up not in FRONTS:
            raise InputError(
                "up", self.up, "It is not an axis.", f"Choose one of {', '.join(FRONTS)}."
            )
        refuse_replacing(out, [self.file])
        gaussians, notes = samples(str(self.file))
        for note in notes:
            print(f"note: {note}")
        renderer = Renderer(device=pick_device(self.device))
        tiles = [_tile(renderer, gaussians, reading) for reading in candidates(self.up)]
        if self.out is None:
            out.parent.mkdir(exist_ok=True)
        with replacing(out) as temporary:
            Image.fromarray(_sheet(tiles)).save(temporary, "PNG")
        print(out)
        return 0


def _tile(renderer: Renderer, gaussians: Gaussians, reading: Reading) -> NDArray[np.uint8]:
    tile = Image.fromarray(draw_oriented(renderer, gaussians, reading, SIZE))
    words = f"--up={reading.up} --front={reading.front}"
    ImageDraw.Draw(tile).text((8, SIZE - 20), words, fill=(60, 60, 60))
    return np.asarray(tile)


def _sheet(tiles: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    half = (len(tiles) + 1) // 2
    rows = [np.concatenate(tiles[i : i + half], axis=1) for i in range(0, len(tiles), half)]
    return np.concatenate(rows)
