"""Draws the surroundings of the object: backdrop, floor with shadow, and boundaries as glass.

If glass is among the Gaussians, the Gaussians behind it are tinted with the colour of the glass.
Blending is linear, so this has the same effect as blending the glass at its depth, but needs no
depth per pixel.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.native import code, native_kernel
from phy124.kernels.splat.arguments import DRAWN
from phy124.kernels.splat.blend import STORE_TILE, SUM_TILE
from phy124.kernels.splat.glass import TINT, VEIL, veil, within
from phy124.kernels.splat.screen import View


@wp.struct
class Setting:
    """Backdrop, floor and shadow map of a frame."""

    top: wp.vec3  # colour of the backdrop's first row
    bottom: wp.vec3  # colour of the backdrop's last row
    floor: int  # 1 if there is a floor
    height: float  # height of the floor [m]
    middle: wp.vec2  # centre of the square that the shadow map covers [m]
    reach: float  # half the side of that square [m]
    cells: int  # number of cells along each side of the shadow map
    shaded: wp.vec4i  # first and last shaded cells along x, then along y
    pool: float  # brightness added to the floor at the centre, for a grey of 1/2


@wp.func
def shade_at(setting: Setting, shade: wp.array2d(dtype=wp.uint16), u: float, v: float) -> float:
    """Return the interpolated fraction of light that the shadow removes; 0 outside the map.

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
    """Return the brightness of the light spot on the floor; x and y are relative to `reach`."""
    rest = wp.max(1.0 - 0.5 * (x * x + y * y), 0.0)
    return rest * rest


@wp.func
def ray_through(view: View, x: int, y: int) -> wp.vec3:
    """Return the ray through the centre of a pixel, with length 1 along the camera's axis."""
    seen = wp.vec3(
        (float(x) + 0.5 - view.centre[0]) / view.focal,
        (float(y) + 0.5 - view.centre[1]) / view.focal,
        1.0,
    )
    return wp.transpose(view.rotation) * seen


@wp.func
def floor_along(setting: Setting, eye: wp.vec3, ray: wp.vec3) -> float:
    """Return the distance at which a ray meets the floor from above; 1e30 if the ray does not."""
    if setting.floor == 1 and eye[2] > setting.height and ray[2] < 0.0:
        return (setting.height - eye[2]) / ray[2]
    return 1.0e30


@kernel("phy124_stage", types=DRAWN)
def draw_setting(
    view, setting: Setting, shade, picture, before, solids, outlines, coverage, image_out
):
    """Draw the surroundings with one thread per pixel: the plain version of `blend_staged_simd`.

    Before the launch, `image_out` contains the light of the Gaussians; afterwards, the whole frame.
    The solids are sorted by depth; the first `before` of them are in front of all Gaussians.
    """
    pixel = wp.tid()
    open = 1.0 - coverage[pixel]
    # If the transmittance of the Gaussians is less than one grey level of a byte, it is ignored.
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


@kernel("phy124_stage", types=DRAWN)
def tint_splats(view, first, last, solids, outlines, means, splats_out):
    """Tint Gaussians behind the glass solids `first` <= k < `last`; one thread per Gaussian."""
    i = wp.tid()
    mean = splats_out[i].mean
    ray = means[i] - view.eye
    pixel = wp.dot(view.rotation[2], ray) / view.focal
    clear = float(1.0)
    for k in range(first, last):
        if within(outlines[k], mean[0], mean[1]):
            clear *= 1.0 - veil(solids[k], view.eye, ray, 1.0, pixel)
    splats_out[i].colour = TINT + clear * (splats_out[i].colour - TINT)


# A separate function, because inlining it made the sum over the splats 1/60 slower.
APART = "__attribute__((noinline))"
DRAW = f"const auto draw = [&]() {APART} {{ {VEIL + code('stage')} }};\ndraw();"


@native_kernel("phy124_stage_simd", SUM_TILE + DRAW + STORE_TILE, types=DRAWN)
def blend_staged_simd(
    view,
    background,
    first,
    setting: Setting,
    shade,
    picture,
    before,
    solids,
    outlines,
    starts,
    ends,
    pairs,
    splats,
    image_out,
    alpha_out,
):
    """Blend the splats of a tile and draw the surroundings, with one thread per tile."""
    ...


tint_splats_simd = native_kernel(
    "phy124_stage_simd", VEIL + code("stage:tint"), name="tint_splats_simd"
)(tint_splats.func)
"""Version of `tint_splats` with vector instructions of a CPU."""
