"""What stands around the object: backdrop, floor with its shadow, and boundaries as glass.

Whatever is not a Gaussian is drawn behind all of them, pixel by pixel, and glass before all of them
is laid over their light. A Gaussian that is seen through glass among them takes on its colour
instead. Blending is linear, so this equals inserting the glass at its depth, without a depth per
pixel.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.native import code, native_kernel
from phy124.kernels.splat.blend import STORE_TILE, SUM_TILE
from phy124.kernels.splat.glass import TINT, VEIL, Outline, Solid, veil, within
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
    shaded: wp.vec4i  # first and last of them with shade along x, then along y
    pool: float  # how much brighter the floor is in the middle, for a grey of 1/2


@wp.func
def shade_at(setting: Setting, shade: wp.array2d(dtype=wp.uint16), u: float, v: float) -> float:
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
    near = float(shade[i, j]) + a * (float(shade[i + 1, j]) - float(shade[i, j]))
    far = float(shade[i, j + 1]) + a * (float(shade[i + 1, j + 1]) - float(shade[i, j + 1]))
    return (near + b * (far - near)) / 65535.0


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
def draw_setting(
    view: View,
    setting: Setting,
    shade: wp.array2d(dtype=wp.uint16),
    picture: wp.array(dtype=wp.vec3),
    before: int,
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    coverage: wp.array(dtype=float),
    # in place: light of the Gaussians, then the picture
    image_out: wp.array(dtype=wp.vec3),
):
    """One thread per pixel, for GPUs, and a readable form of `blend_staged_simd`.

    The first `before` solids are before all Gaussians.
    """
    pixel = wp.tid()
    open = 1.0 - coverage[pixel]
    # Of what is behind, Gaussians may let through less than a byte can tell.
    if open <= 1.0e-3:
        if before == 0:
            return
        open = float(0.0)
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
    clear = float(1.0)
    lens = float(1.0)
    for k in range(solids.shape[0]):
        if within(outlines[k], float(x) + 0.5, float(y) + 0.5):
            clear *= 1.0 - veil(solids[k], view.eye, ray, limit, 1.0 / view.focal)
            if k < before:
                lens = clear
    light = lens * image_out[pixel] + (1.0 - lens) * (1.0 - open) * TINT
    colour = TINT + clear * (colour - TINT)
    image_out[pixel] = wp.min(light + open * colour, wp.vec3(1.0, 1.0, 1.0))


@kernel("phy124_stage")
def tint_splats(
    view: View,
    first: int,
    last: int,
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    means: wp.array(dtype=wp.vec3),
    splats_out: wp.array(dtype=Splat),
):
    """One thread per Gaussian: the colour of what is seen through glass among them.

    `first` and `last` are the numbers of the first such solid and of the one after the last.
    """
    i = wp.tid()
    mean = splats_out[i].mean
    ray = means[i] - view.eye
    pixel = wp.dot(view.rotation[2], ray) / view.focal
    clear = float(1.0)
    for k in range(first, last):
        if within(outlines[k], mean[0], mean[1]):
            clear *= 1.0 - veil(solids[k], view.eye, ray, 1.0, pixel)
    splats_out[i].colour = TINT + clear * (splats_out[i].colour - TINT)


# A function of its own: within the one that sums splats it made that slower, by a sixtieth.
APART = "__attribute__((noinline))"
DRAW = f"const auto draw = [&]() {APART} {{ {VEIL + code('stage')} }};\ndraw();"


@native_kernel(
    "phy124_stage_simd",
    SUM_TILE + DRAW + STORE_TILE,
)
def blend_staged_simd(
    view: View,
    background: wp.vec3,
    first: int,
    setting: Setting,
    shade: wp.array2d(dtype=wp.uint16),
    picture: wp.array(dtype=wp.vec3),
    before: int,
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    image_out: wp.array(dtype=wp.vec3),
    alpha_out: wp.array(dtype=float),
):
    """One thread per tile: its splats, and the stage around them before they are stored."""
    ...


tint_splats_simd = native_kernel(
    "phy124_stage_simd", VEIL + code("stage:tint"), name="tint_splats_simd"
)(tint_splats.func)
"""`tint_splats` for the vector units of a CPU, sixteen Gaussians per thread."""
