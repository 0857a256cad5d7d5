"""What stands around the object: backdrop, floor with its shadow, and boundaries as glass.

Whatever is not a Gaussian is drawn behind all of them, pixel by pixel; a Gaussian that is seen
through glass takes on its colour instead. Blending is linear, so this equals inserting the glass at
its depth, without a depth per pixel.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.glass import TINT, Solid, veil
from phy124.kernels.splat.screen import Splat, View


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
    pool: float  # how much brighter the floor is in the middle, for a grey of 1/2


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
    """How bright the pool of light is at a place, in units of the map's reach."""
    rest = wp.max(1.0 - 0.5 * (x * x + y * y), 0.0)
    return rest * rest


@wp.func
def ray_through(view: View, x: int, y: int) -> wp.vec3:
    """Direction of the ray through a pixel's centre, of length 1 along the camera's axis."""
    seen = wp.vec3(
        (float(x) + 0.5 - view.centre[0]) / view.focal,
        (float(y) + 0.5 - view.centre[1]) / view.focal,
        1.0,
    )
    return wp.transpose(view.rotation) * seen


@wp.func
def floor_along(setting: Setting, eye: wp.vec3, ray: wp.vec3) -> float:
    """Where a ray meets the floor; far away if it does not, or from below."""
    if setting.floor == 1 and eye[2] > setting.height and ray[2] < 0.0:
        return (setting.height - eye[2]) / ray[2]
    return 1.0e30


@kernel("phy124_stage")
def draw_glass(
    # model
    view: View,
    setting: Setting,
    solids: wp.array(dtype=Solid),
    boxes: wp.array(dtype=wp.vec4i),
    around: wp.vec4i,
    # state in
    coverage: wp.array(dtype=float),
    # out
    glass_out: wp.array(dtype=float),
):
    """One thread per pixel of the box `around` all solids: opacity of those before the floor.

    Each solid is inside its box of pixels, x0, y0, x1, y1.
    """
    wide = around[2] - around[0]
    x = around[0] + wp.tid() % wide
    y = around[1] + wp.tid() / wide
    if 1.0 - coverage[y * view.width + x] <= 1.0e-3:
        return
    ray = ray_through(view, x, y)
    limit = floor_along(setting, view.eye, ray)
    clear = float(1.0)
    for k in range(solids.shape[0]):
        box = boxes[k]
        if x >= box[0] and x < box[2] and y >= box[1] and y < box[3]:
            clear *= 1.0 - veil(solids[k], view.eye, ray, limit, 1.0 / view.focal)
    glass_out[y * view.width + x] = 1.0 - clear


@kernel("phy124_stage")
def draw_setting(
    # model
    view: View,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    # state in
    glass: wp.array(dtype=float),
    coverage: wp.array(dtype=float),
    # in place: light of the Gaussians, then the picture
    image_out: wp.array(dtype=wp.vec3),
):
    """One thread per pixel, for GPUs, and a readable form of stage_simd."""
    pixel = wp.tid()
    open = 1.0 - coverage[pixel]
    # Of what is behind, Gaussians may let through less than a byte can tell.
    if open <= 1.0e-3:
        return
    x = pixel % view.width
    y = pixel / view.width
    down = (float(y) + 0.5) / float(view.height)
    colour = (1.0 - down) * setting.top + down * setting.bottom
    if picture.shape[0] > 0:
        colour = picture[pixel]
    ray = ray_through(view, x, y)
    limit = floor_along(setting, view.eye, ray)
    if limit < 1.0e30:
        u = view.eye[0] + limit * ray[0] - setting.middle[0]
        v = view.eye[1] + limit * ray[1] - setting.middle[1]
        pool = setting.pool * pool_at(u / setting.reach, v / setting.reach)
        scale = 0.5 * float(setting.cells) / setting.reach
        i = (u + setting.reach) * scale - 0.5
        j = (v + setting.reach) * scale - 0.5
        bright = colour + pool * wp.cw_mul(colour, wp.vec3(1.0, 1.0, 1.0) - colour)
        colour = (1.0 - shade_at(setting, shade, i, j)) * bright
    if glass.shape[0] > 0:
        colour += glass[pixel] * (TINT - colour)
    image_out[pixel] = wp.min(image_out[pixel] + open * colour, wp.vec3(1.0, 1.0, 1.0))


@kernel("phy124_stage")
def tint_splats(
    # model
    view: View,
    solids: wp.array(dtype=Solid),
    boxes: wp.array(dtype=wp.vec4i),
    # state in
    means: wp.array(dtype=wp.vec3),
    # in place
    splats_out: wp.array(dtype=Splat),
):
    """One thread per Gaussian: the colour of what is seen through glass."""
    i = wp.tid()
    mean = splats_out[i].mean
    for k in range(solids.shape[0]):
        box = boxes[k]
        x = wp.clamp(mean[0], float(box[0]), float(box[2]))
        y = wp.clamp(mean[1], float(box[1]), float(box[3]))
        if x == mean[0] and y == mean[1]:
            ray = means[i] - view.eye
            depth = wp.dot(view.rotation[2], ray)
            alpha = veil(solids[k], view.eye, ray, 1.0, depth / view.focal)
            colour = splats_out[i].colour
            splats_out[i].colour = colour + alpha * (TINT - colour)
