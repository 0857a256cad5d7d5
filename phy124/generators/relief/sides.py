"""Checks whether images from the side and from behind agree with the front image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError

Solid = NDArray[np.bool_]
UNLIKE = 0.5
"""Smallest overlap (IoU) of the front's silhouette with the mirrored silhouette from behind."""
EMPTY = 0.05
"""At most at this fraction of the heights, only one of the two images may show the object."""
DEEPEST, FLATTEST = 4.0, 0.03
"""Largest and smallest depth, relative to the longest side of the front."""


LOWEST = 3
"""Smallest height of a front from which a solid is made with an image from the side [pixels]."""


@dataclass(frozen=True)
class Box:
    """Bounding box of the object in an image [pixels]."""

    top: int
    bottom: int
    left: int
    right: int

    @classmethod
    def of(cls, solid: Solid) -> Box:
        """Return the bounding box of a silhouette [H,W]."""
        rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
        return cls(int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self.right - self.left, self.bottom - self.top

    @property
    def middle(self) -> tuple[float, float]:
        """Column and row of the centre, relative to the centre of pixel 0."""
        return (self.left + self.right - 1) / 2, (self.top + self.bottom - 1) / 2


def check_side(front: Solid, side: Solid) -> None:
    """Refuse two silhouettes of equal height that cannot belong to the same object.

    Raises:
        InputError: If the object is too low, the depth is out of range, or only one image shows the
            object at too many heights.
    """
    front_box, side_box = Box.of(front), Box.of(side)
    depth = side_box.size[0] / max(front_box.size)
    if not FLATTEST <= depth <= DEEPEST:
        limit = (
            "If the picture from the side is scaled to the height of the front picture, the object "
            f"is {depth:.2g} times as deep as the longest side of its front."
        )
        remedy = "Give pictures that show the whole object, upright in both."
        raise InputError("side", "picture", limit, remedy)
    if front_box.size[1] < LOWEST:
        height = front_box.size[1] / max(*front_box.size, *side_box.size)
        limit = (
            f"The object's height is {height:.2g} of its longest side, which is too low to compare "
            "heights in two pictures."
        )
        raise InputError("side", "picture", limit, "Remove the picture from the side.")
    height = min(front_box.size[1], side_box.size[1])
    rows = [
        solid[box.top : box.top + height].any(axis=1)
        for solid, box in ((front, front_box), (side, side_box))
    ]
    if float(np.mean(rows[0] != rows[1])) > EMPTY:
        limit = "At some heights, only one of the front and side pictures shows the object."
        remedy = "Give two pictures of the same object, which is upright in both."
        raise InputError("side", "picture", limit, remedy)


def check_back(front: Solid, back: Solid) -> None:
    """Refuse a silhouette from behind that differs too much from the front's.

    Args:
        front: Silhouette from the front.
        back: Mirrored silhouette from behind, with the height of the front's.

    Raises:
        InputError: If the silhouettes differ, or the image seems to have been mirrored beforehand.
    """
    alike, unmirrored = overlap(front, back), overlap(front, back[:, ::-1])
    if alike >= UNLIKE:
        return
    limit = (
        "When mirrored, the picture's silhouette overlaps the front's "
        f"by {alike:.0%}; at least {UNLIKE:.0%} is needed."
    )
    remedy = (
        "Give a picture from straight behind, in which the object "
        "is as upright as in the front picture."
    )
    if unmirrored >= UNLIKE:
        remedy = (
            "The picture fits the front if it is not mirrored, so it seems to be mirrored "
            "already: mirror it back."
        )
    raise InputError("back", "picture", limit, remedy)


def overlap(first: Solid, second: Solid) -> float:
    """Return the intersection over union of two silhouettes with aligned centres."""
    boxes = Box.of(first), Box.of(second)
    width, height = (max(sizes) for sizes in zip(*(box.size for box in boxes), strict=True))
    placed = []
    for solid, box in zip((first, second), boxes, strict=True):
        canvas = np.zeros((height, width), bool)
        top, left = (height - box.size[1]) // 2, (width - box.size[0]) // 2
        part = solid[box.top : box.bottom, box.left : box.right]
        canvas[top : top + box.size[1], left : left + box.size[0]] = part
        placed.append(canvas)
    return float((placed[0] & placed[1]).sum() / (placed[0] | placed[1]).sum())
