"""relief: inflates a picture with alpha into a closed shell of flat Gaussians, without weights.

It is a guess, not a reconstruction: the silhouette becomes the solid that it most plainly suggests
(`phy124.generators.relief.solids`), the front shows the picture, and the back what the picture's
rim suggests. A picture from the side replaces the guess (`phy124.generators.relief.hull`). How
close that comes to solids known from all sides is in docs/lab/relief.md.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.relief.highlights import matte
from phy124.generators.relief.picture import Given, opened
from phy124.generators.relief.several import Facing, from_sides
from phy124.generators.relief.single import from_front
from phy124.generators.relief.view import VIEW_DISTANCE as VIEW_DISTANCE
from phy124.kernels.implicit import HULL, INFLATED, push
from phy124.progress import Progress, silent
from phy124.runtime.compiling import compile_missing

STAGES = 4


def relief(
    image_rgba: Given,
    *,
    seed: int = 0,
    progress: Progress = silent,
    count: int = 50_000,
    depth: NDArray | None = None,
    side: Given | None = None,
    facing: Facing = "left",
    back: Given | None = None,
    thickness: float | None = None,
    highlights: Literal["keep", "remove"] = "keep",
) -> Gaussians:
    """Inflate the opaque part of a picture.

    A camera `VIEW_DISTANCE` in front sees its silhouette with a longest side of 1 m at x = 0; the
    object faces +x with its middle near there. If a picture from the side shows more than that, its
    longest side is 1 m instead. Equal seeds give equal Gaussians.

    Args:
        image_rgba: The picture [H,W,4].
        seed: Of the random positions.
        progress: Called as in `phy124.progress`.
        count: Approximate number of Gaussians.
        depth: Depth map of the picture [H,W] in any unit, near is large; None: the front is
            inflated, too.
        side: The object from one side, cut out as well: it says how deep the object is.
        facing: Which way the object looks in that picture.
        back: The object from behind, cut out as well.
        thickness: Depth relative to what the silhouette suggests; None: as it suggests.

        highlights: Whether highlights are painted on the object, with which they turn.

    Raises:
        InputError: If nothing in a picture is opaque, the depth map does not fit the picture, or
            the pictures contradict each other.
    """
    rng = np.random.default_rng(seed)
    compile_missing([*(INFLATED if side is None else HULL), push], progress=progress)

    def step(done: int) -> None:
        progress("relief", done, STAGES)

    def shown(given: Given, field: str) -> Image.Image:
        picture = opened(given, field)
        return matte(picture) if highlights == "remove" else picture

    step(0)
    front, behind = shown(image_rgba, "image"), None if back is None else shown(back, "back")
    if side is None:
        shell = from_front(
            front, count=count, rng=rng, step=step, depth=depth, back=behind,
            thickness=1.0 if thickness is None else thickness,
        )  # fmt: skip
    else:
        _refuse_double(depth, thickness)
        shell = from_sides(
            front, shown(side, "side"), facing=facing, back=behind, count=count, rng=rng, step=step
        )
    gaussians = shell.gaussians()
    step(STAGES)
    return gaussians


def _refuse_double(depth: NDArray | None, thickness: float | None) -> None:
    limit = "The picture from the side says already how deep the object is."
    for field, given in (("depth", depth), ("thickness", thickness)):
        if given is not None:
            value = "map" if field == "depth" else given
            raise InputError(field, value, limit, "Give one of the two.")
