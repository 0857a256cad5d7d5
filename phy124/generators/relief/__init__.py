"""Generator `relief`: inflates an image with alpha into a closed shell of flat Gaussians.

The generator needs no trained weights. `relief` makes the most plausible solid for a silhouette.
docs/lab/relief.md compares the results with objects whose shape is known.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.relief.back import BackLook
from phy124.generators.relief.highlights import matte
from phy124.generators.relief.picture import Picture, open_picture
from phy124.generators.relief.several import Facing, from_sides
from phy124.generators.relief.single import Shape, from_front
from phy124.generators.relief.surface import VIEW_DISTANCE as VIEW_DISTANCE
from phy124.imaging.depth import DepthNetwork
from phy124.kernels.implicit import HULL, INFLATED, push
from phy124.progress import Progress, silent
from phy124.runtime.compiling import compile_missing

STAGES = 4


def relief(
    image_rgba: Picture,
    *,
    seed: int = 0,
    progress: Progress = silent,
    count: int = 50_000,
    depth: NDArray | DepthNetwork | None = None,
    side: Picture | None = None,
    facing: Facing = "left",
    back: Picture | None = None,
    back_look: BackLook = "auto",
    thickness: float | None = None,
    shape: Shape = "auto",
    photo_elevation: float | None = None,
    highlights: Literal["keep", "remove"] = "keep",
) -> Gaussians:
    """Inflate the opaque part of an image to the closed shell of an upright object that faces +x.

    A camera at the distance `VIEW_DISTANCE`, raised by the elevation of the picture, sees the
    silhouette of the image. For a camera that is not raised, the longest side of the silhouette in
    the plane x = 0 is 1 m. If the object is longer in the side image, the longest side there is 1 m
    instead. Equal seeds give equal Gaussians.

    Args:
        image_rgba: The image [H,W,4].
        seed: Seed of the points' positions.
        progress: Callback as described in `phy124.progress`.
        count: Approximate number of Gaussians.
        depth: Depth map of the image [H,W] in any unit, larger values nearer, or a network that
            estimates the map. None: the front is inflated like the back.
        side: Image of the segmented object from one side, which determines the object's depth.
        facing: Direction in which the object's front points in `side`.
        back: Image of the segmented object from behind.
        back_look: Look of the back without an image from behind. "mirror": the mirrored front;
            "plain": the materials of the front without its features; "auto": plain if the
            silhouette is symmetric, otherwise mirrored. A warning says if it has no effect, because
            the object is a vessel, a ring, a box or a table.
        thickness: Factor of the guessed depth; None: 1.
        shape: "round": as deep as its parts are wide; "upright": a solid of revolution with a
            vertical axis; "flat": a thin sheet; "auto": the most plausible of these, a slab or a
            box.
        photo_elevation: Angle above the horizontal from which the picture was taken [degrees], 0 to
            80. None: estimated for a vessel, a ring, a box and an object that shows two sides, and
            0 for other objects.
        highlights: "keep": highlights are painted on the object; "remove": highlights are removed
            from the images.

    Raises:
        InputError: If an image has no opaque pixels, the depth map does not fit the image, or the
            front and side images contradict each other.
    """
    rng = np.random.default_rng(seed)
    compile_missing([*(INFLATED if side is None else HULL), push], progress=progress)

    def step(done: int) -> None:
        progress("relief", done, STAGES)

    def prepare(image: Picture, field: str) -> Image.Image:
        picture = open_picture(image, field)
        return matte(picture) if highlights == "remove" else picture

    step(0)
    front = prepare(image_rgba, "image")
    if isinstance(depth, DepthNetwork) and side is None:
        depth = depth(np.asarray(open_picture(image_rgba, "image")))
    elif isinstance(depth, DepthNetwork) and depth.optional:
        depth = None  # the image from the side determines the depth better than a network
    behind = None if back is None else prepare(back, "back")
    if side is None:
        assert not isinstance(depth, DepthNetwork)
        shell = from_front(
            front,
            count=count,
            rng=rng,
            step=step,
            depth=depth,
            back=behind,
            look=back_look,
            thickness=1.0 if thickness is None else thickness,
            shape=shape,
            elevation=photo_elevation,
        )
    else:
        _refuse_double(depth=depth, thickness=thickness, photo_elevation=photo_elevation)
        _refuse_double(shape=None if shape == "auto" else shape)
        shell = from_sides(
            front,
            prepare(side, "side"),
            facing=facing,
            back=behind,
            look=back_look,
            count=count,
            rng=rng,
            step=step,
        )
    gaussians = shell.gaussians()
    step(STAGES)
    return gaussians


def _refuse_double(**options: object | None) -> None:
    limit = "The picture from the side determines the object's depth already."
    for field, option in options.items():
        if option is not None:
            value = "map" if field == "depth" else option
            raise InputError(
                field, value, limit, f"Give either the picture from the side or {field}."
            )
