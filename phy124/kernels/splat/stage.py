"""What stands around the object: backdrop, floor with its shadow, and boundaries as glass.

Whatever is not a Gaussian is drawn behind all of them, pixel by pixel; a Gaussian that is seen
through glass takes on its colour instead. Blending is linear, so this equals inserting the glass at
its depth, without a depth per pixel.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.glass import TINT, Solid, veil
from phy124.kernels.splat.screen import Splat, View

RUN = wp.constant(16)
"""Number of pixels that a thread draws."""
POOL = wp.constant(0.5)
"""How much brighter the floor is in the middle, for a grey of 1/2."""


@wp.struct
class Setting:
    """Backdrop and floor."""

    top: wp.vec3  # colour of the backdrop's first row
    bottom: wp.vec3  # colour of its last row
    floor: int  # whether there is a floor
    height: float  # of the floor [m]
    middle: wp.vec2  # of the square that the shadow map covers [m]
    reach: float  # half its side [m]
    cells: int  # along its side


@wp.func
def shade_at(setting: Setting, shade: wp.array2d(dtype=float), u: float, v: float) -> float:
    """The light that the shadow takes, between the centres of cells; none outside the map.

    The outermost cells have no shadow.
    """
    last = float(setting.cells - 1)
    if u < 0.0 or v < 0.0 or u >= last or v >= last:
        return 0.0
    i = int(u)
    j = int(v)
    a = u - float(i)
    b = v - float(j)
    near = shade[i, j] + a * (shade[i + 1, j] - shade[i, j])
    far = shade[i, j + 1] + a * (shade[i + 1, j + 1] - shade[i, j + 1])
    return near + b * (far - near)


@wp.func
def pool_at(x: float, y: float) -> float:
    """How much brighter the floor is at a place, in units of the map's reach."""
    rest = wp.max(1.0 - 0.5 * (x * x + y * y), 0.0)
    return POOL * rest * rest


@wp.func
def seen_through(
    solids: wp.array(dtype=Solid), boxes: wp.array(dtype=wp.vec4i), view: View, ray: wp.vec3,
    x: int, y: int, limit: float,
) -> float:  # fmt: skip
    """Opacity of all the glass at a pixel in front of `limit`."""
    clear = float(1.0)
    for k in range(solids.shape[0]):
        box = boxes[k]
        if x >= box[0] and x < box[2] and y >= box[1] and y < box[3]:
            clear *= 1.0 - veil(solids[k], view.eye, ray, limit, 1.0 / view.focal)
    return 1.0 - clear


@kernel("phy124_stage")
def draw_setting(
    # model
    view: View,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    solids: wp.array(dtype=Solid),
    boxes: wp.array(dtype=wp.vec4i),
    # in place: light of the Gaussians, then the picture; and how far they cover it
    image_out: wp.array(dtype=wp.vec3),
    coverage_out: wp.array(dtype=float),
):
    """One thread for each run of `RUN` pixels in a row; each solid is inside its box of pixels."""
    run = wp.tid()
    runs = (view.width + RUN - 1) / RUN
    y = run / runs
    left = (run % runs) * RUN
    down = (float(y) + 0.5) / float(view.height)
    plain = (1.0 - down) * setting.top + down * setting.bottom
    # The ray of the run's first pixel, and how it turns from pixel to pixel.
    right = wp.vec3(view.rotation[0, 0], view.rotation[0, 1], view.rotation[0, 2]) / view.focal
    first = wp.transpose(view.rotation) * wp.vec3(
        (float(left) + 0.5 - view.centre[0]) / view.focal,
        (float(y) + 0.5 - view.centre[1]) / view.focal,
        1.0,
    )
    scale = 0.5 * float(setting.cells) / setting.reach
    for x in range(left, wp.min(left + RUN, view.width)):
        pixel = y * view.width + x
        open = 1.0 - coverage_out[pixel]
        # Of what is behind, Gaussians may let through less than a byte can tell.
        if open > 1.0e-3:
            ray = first + float(x - left) * right
            colour = plain
            if picture.shape[0] > 0:
                colour = picture[pixel]
            limit = float(1.0e30)
            if setting.floor == 1 and view.eye[2] > setting.height and ray[2] < 0.0:
                limit = (setting.height - view.eye[2]) / ray[2]
                u = view.eye[0] + limit * ray[0] - setting.middle[0]
                v = view.eye[1] + limit * ray[1] - setting.middle[1]
                pool = pool_at(u / setting.reach, v / setting.reach)
                light = 1.0 - shade_at(
                    setting,
                    shade,
                    (u + setting.reach) * scale - 0.5,
                    (v + setting.reach) * scale - 0.5,
                )
                colour = light * (
                    colour + pool * wp.cw_mul(colour, wp.vec3(1.0, 1.0, 1.0) - colour)
                )
            if solids.shape[0] > 0:
                alpha = seen_through(solids, boxes, view, ray, x, y, limit)
                colour = (1.0 - alpha) * colour + alpha * TINT
            image_out[pixel] = wp.min(image_out[pixel] + open * colour, wp.vec3(1.0, 1.0, 1.0))


@kernel("phy124_stage")
def tint_splats(
    # model
    view: View,
    solids: wp.array(dtype=Solid),
    # state in
    means: wp.array(dtype=wp.vec3),
    # in place
    splats_out: wp.array(dtype=Splat),
):
    """One thread per Gaussian: the colour of what is seen through glass."""
    i = wp.tid()
    box = splats_out[i].box
    if box[2] <= box[0] or box[3] <= box[1]:
        return
    ray = means[i] - view.eye
    depth = wp.dot(view.rotation[2], ray)
    colour = splats_out[i].colour
    for k in range(solids.shape[0]):
        alpha = veil(solids[k], view.eye, ray, 1.0, depth / view.focal)
        colour = (1.0 - alpha) * colour + alpha * TINT
    splats_out[i].colour = colour
