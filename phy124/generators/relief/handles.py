"""Builds handles in vertical planes through the axis of a vessel that was photographed from above.

A handle that points towards a raised camera appears lower than its roots, and one that points away
appears higher. The azimuth of a handle with two roots is therefore chosen so that the middle of the
handle is horizontal.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.lathe import Lathe
from phy124.generators.relief.parts import inflate_part, keep
from phy124.generators.relief.shell import DRAWN_IN, Shell, join
from phy124.generators.relief.surface import View

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
STEP = float(np.radians(2.5))
AZIMUTHS = STEP * np.arange(-24, 25)
"""Directions of handles that are tried, relative to the image plane; positive towards the camera
[radians].
"""
JOINT = 4
"""Handles are extended by this length into the wall [pixels]."""
STRIP = 6.0
"""Width of the vertical strips in which the middle of a handle is measured [pixels]."""
CORE = 0.7
"""Smallest distance of a handle's middle from the outline, relative to the largest distance."""
THINNEST = 2.0
"""Thinner parts are ignored, as a half thickness [pixels]."""


@dataclass(frozen=True, eq=False)
class Handle:
    """A part outside a vessel, in a vertical plane through the vessel's axis."""

    mask: Mask
    """Pixels of the handle, continued to the wall [H,W]."""
    slope: float
    """Distance of the plane from the image plane through the axis, per distance to the right."""


def find_handles(
    outside: Mask, body: Mask, view: View, lathe: Lathe, offset: float
) -> list[Handle]:
    """Return the handles of a vessel.

    Args:
        outside: Pixels of the object outside the body [H,W].
        body: Pixels of the vessel without handles [H,W].
        view: The camera in front of the object.
        lathe: The vessel.
        offset: Distance of the axis from the image's centre [pixels].
    """
    handles = []
    for part in _parts(outside):
        rows, columns = np.nonzero(part)
        places = np.stack([columns - view.middle[0], rows - view.middle[1]], axis=1)
        side = 1.0 if places[:, 0].mean() > offset else -1.0
        core = _core(part, body)[rows, columns]
        azimuth = _azimuth(places, core, side, lathe, offset)
        slope = side * np.tan(azimuth)
        mask = part | _continue_roots(part, body, view, lathe, offset, slope)
        handles.append(Handle(mask, slope))
    return handles


def handle_shell(
    handles: list[Handle],
    rgba: Field,
    front: Field,
    view: View,
    lathe: Lathe,
    offset: float,
    count: int,
    rng: np.random.Generator,
) -> Shell:
    """Return the shell of at least one handle, outside the wall of the vessel.

    Args:
        handles: The handles, from `find_handles`.
        rgba: The image [H,W,4].
        front: Colours of the image [H,W,3].
        view: The camera in front of the object.
        lathe: The vessel.
        offset: Distance of the axis from the image's centre [pixels].
        count: Approximate number of points.
        rng: Random number generator.
    """
    total, shells = sum(handle.mask.sum() for handle in handles), []
    for handle in handles:
        alpha = np.where(handle.mask, rgba[..., 3], 0.0)
        points = max(1, round(count * handle.mask.sum() / total))
        flat, _ = inflate_part(alpha, front, view, points, rng)
        shell = lathe.camera.stand(flat, handle.slope, offset)
        x, y, z = shell.points.T
        radii = np.interp(-y, lathe.heights, lathe.radii - DRAWN_IN, left=0, right=0)
        shells.append(keep(shell, np.hypot(x - offset, z) > radii))
    return join(*shells)


def _parts(outside: Mask) -> Iterator[Mask]:
    parts, number = scipy.ndimage.label(outside)  # pyright: ignore
    for index in range(1, number + 1):
        part = parts == index
        if nearest_of(~part)[0].max() > THINNEST:
            yield part


def _core(part: Mask, body: Mask) -> Mask:
    """Return the middle of a handle in columns outside the body [H,W]; empty without a gap."""
    both = part | body
    gap = scipy.ndimage.binary_fill_holes(both) & ~both
    if not (gap & scipy.ndimage.binary_dilation(part)).any():
        return np.zeros_like(part)
    depth = nearest_of(~both)[0]
    free = ~body[part.any(axis=1)].any(axis=0)
    return part & free & (depth > CORE * depth[part & free].max(initial=0))


def _azimuth(places: Field, core: Mask, side: float, lathe: Lathe, offset: float) -> float:
    """Return the direction of a handle [radians].

    A handle is never below the foot. A part without a gap, such as a spout, may be oblique.

    Args:
        places: Offsets of the handle's pixels from the image's centre [N,2].
        core: Whether a pixel is in the middle of the handle, and its column is outside the body
            [N].
        side: 1 for a handle on the right, -1 on the left.
        lathe: The vessel.
        offset: Distance of the axis from the image's centre [pixels].
    """

    def place(azimuth: float) -> tuple[Field, Field]:
        points = lathe.camera.meet(places, side * np.tan(azimuth), offset)
        return side * (points[:, 0] - offset) / np.cos(azimuth), -points[:, 1]

    def below(azimuth: float) -> float:
        return max(0.0, float(lathe.heights[0] - place(azimuth)[1].min()))

    def tilt(azimuth: float) -> float:
        out, height = place(azimuth)
        return _tilt(out[core], height[core])

    azimuth = min(AZIMUTHS.tolist(), key=lambda azimuth: (below(azimuth), abs(azimuth)))
    if not core.any():
        return azimuth
    # Steep planes distort a handle, so that the slope may vanish there again.
    step = -float(np.copysign(STEP, tilt(azimuth)))
    while abs(azimuth + step) <= AZIMUTHS[-1] and below(azimuth + step) == 0:
        if abs(tilt(azimuth + step)) >= abs(tilt(azimuth)):
            break
        azimuth += step
    return azimuth


def _tilt(out: Field, height: Field) -> float:
    """Return the slope of the line halfway between a handle's upper and lower edge.

    `out` and `height` [N] are the positions of the handle's pixels [pixels]. The slope is 0 if both
    edges are in fewer than two vertical strips.
    """
    upper = height > np.median(height)
    if not upper.any():
        return 0.0
    start = max(out[upper].min(), out[~upper].min())
    strip = np.floor((out - start) / STRIP).astype(int)
    number = np.intersect1d(strip[upper], strip[~upper])
    number = number[number < strip.max()]  # the last strip is only partly covered
    if len(number) < 2:
        return 0.0
    top = np.asarray(scipy.ndimage.maximum(height, strip, number))
    bottom = np.asarray(scipy.ndimage.minimum(height, strip, number))
    return float(np.polyfit(STRIP * number, (top + bottom) / 2, 1)[0])


def _continue_roots(
    part: Mask, body: Mask, view: View, lathe: Lathe, offset: float, slope: float
) -> Mask:
    """Return the pixels between the body's outline and the wall in the handle's plane [H,W]."""
    roots = part & scipy.ndimage.binary_dilation(body, iterations=2)
    rows, columns = np.nonzero(roots)
    continued = np.zeros_like(part)
    if not len(rows):
        return continued
    places = np.stack([columns - view.middle[0], rows - view.middle[1]], axis=1)
    points = lathe.camera.meet(places, slope, offset)
    radii = np.interp(-points[:, 1], lathe.heights, lathe.radii) - JOINT
    across = points[:, [0, 2]] - [offset, 0]
    nearer = points.copy()
    nearer[:, [0, 2]] = across * (radii / np.linalg.norm(across, axis=1))[:, None] + [offset, 0]
    column, row = np.median(lathe.camera.pixels(nearer) - places, axis=0)
    for share in np.linspace(0, 1, 2 + int(np.hypot(column, row))):
        down, right = round(share * row), round(share * column)
        continued |= np.roll(roots, (down, right), axis=(0, 1))
    return continued & (body | part)
