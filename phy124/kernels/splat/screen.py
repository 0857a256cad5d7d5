"""The camera, a splat on the screen, and the splat's alpha at a pixel, for all stages.

The conventions follow Kerbl et al. 2023 (3D Gaussian Splatting, section 4): alpha is limited to
0.99, and contributions below 1/255 are skipped. A pixel is finished before its transmittance falls
below 1e-4. Pixel (x, y) is sampled at its centre (x + 0.5, y + 0.5).
"""

import warp as wp

TILE = wp.constant(16)
"""Side of a screen tile [pixels]; native/tile.h relies on 16."""
MAX_ALPHA = wp.constant(0.99)
MIN_ALPHA = wp.constant(1.0 / 255.0)
MIN_TRANSMITTANCE = wp.constant(1.0e-4)


@wp.struct
class View:
    """A pinhole camera with OpenCV axes."""

    rotation: wp.mat33  # world to camera
    translation: wp.vec3  # world to camera [m]
    eye: wp.vec3  # position in the world [m]
    focal: float  # [px]
    centre: wp.vec2  # principal point [px]
    limit: wp.vec2  # largest |x/z|, |y/z| at which the projection is linearised
    near: float  # [m]
    width: int  # [px]
    height: int  # [px]
    columns: int  # number of tiles per row
    rows: int  # number of rows of tiles
    low_pass: float  # added to screen covariances [px^2]
    low_area: float  # low_pass^2, rounded here so that it is not contracted into an FMA [px^4]
    keeps_light: int  # 1 if splats become fainter when low_pass widens them


@wp.struct
class Splat:
    """A Gaussian on the screen.

    With the screen covariance ((a, b), (b, d)) the exponent is -1/2 ((dx - shear dy)^2 precision_x
    + dy^2 precision_y), shear = b/d, precision_x = d/det, precision_y = 1/d. Unlike the expanded
    conic, this form is never positive, and is exact for needles.
    """

    mean: wp.vec2  # [px]
    shear: float
    precision_x: float  # [1/px^2]
    precision_y: float  # [1/px^2]
    opacity: float
    least: float  # log2 of the exp(exponent) below which alpha is less than 1/255
    colour: wp.vec3  # linear blend, 0..
    box: wp.vec4i  # x0, y0, x1, y1: pixels within reach, half open; empty if invisible


@wp.func
def alpha_at(splat: Splat, x: int, y: int) -> float:
    """Return the alpha of a splat at the centre of a pixel; values below 1/255 become 0."""
    dy = float(y) + 0.5 - splat.mean[1]
    dx = float(x) + 0.5 - splat.mean[0] - splat.shear * dy
    power = -0.5 * (splat.precision_x * dx * dx + splat.precision_y * dy * dy)
    alpha = wp.min(MAX_ALPHA, splat.opacity * wp.exp(power))
    if alpha >= MIN_ALPHA:
        return alpha
    return 0.0


@wp.func
def tiles_of(splat: Splat) -> wp.vec4i:
    """Return the tiles that a splat's box touches: first column and row, and end column and row."""
    box = splat.box
    if box[2] <= box[0] or box[3] <= box[1]:
        return wp.vec4i(0, 0, 0, 0)
    return wp.vec4i(box[0] / TILE, box[1] / TILE, (box[2] - 1) / TILE + 1, (box[3] - 1) / TILE + 1)


@wp.func
def blend_over(light: wp.vec3, transmittance: float, background: wp.vec3) -> wp.vec3:
    """Return the colour of a pixel: the splats' light plus the transmitted background, up to 1."""
    return wp.min(light + transmittance * background, wp.vec3(1.0, 1.0, 1.0))
