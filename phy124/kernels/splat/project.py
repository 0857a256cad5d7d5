"""Projects Gaussians to the screen, evaluates their colours, and assigns each splat to its tiles.

The projection is EWA splatting (Zwicker et al. 2001). The splats of a tile are listed from front to
back.
"""

import warp as wp

from phy124.gaussians import SH_C0, SH_C1, SH_C2, SH_C3
from phy124.kernels.build import kernel
from phy124.kernels.native import code, constants, native_func, native_kernel
from phy124.kernels.reduction import finite
from phy124.kernels.splat.arguments import DRAWN
from phy124.kernels.splat.screen import MIN_ALPHA, Splat, View, tiles_of

LOG2_E = wp.constant(1.4426950408889634)
C0 = wp.constant(SH_C0)
C1 = wp.constant(SH_C1)
C2 = wp.constant(wp.types.vector(5, float)(*SH_C2))
C3 = wp.constant(wp.types.vector(7, float)(*SH_C3))


@wp.func
def colour_towards(sh: wp.array2d(dtype=wp.vec3), i: int, degree: int, d: wp.vec3) -> wp.vec3:
    """Return the unclamped colour of Gaussian i seen along d; see phy124.gaussians for the
    signs.
    """
    rgb = wp.vec3(0.5, 0.5, 0.5) + C0 * sh[i, 0]
    if degree > 0:
        x = d[0]
        y = d[1]
        z = d[2]
        rgb += C1 * (z * sh[i, 2] - y * sh[i, 1] - x * sh[i, 3])
        if degree > 1:
            xx = x * x
            yy = y * y
            zz = z * z
            rgb += C2[0] * x * y * sh[i, 4] + C2[1] * y * z * sh[i, 5]
            rgb += C2[2] * (2.0 * zz - xx - yy) * sh[i, 6]
            rgb += C2[3] * x * z * sh[i, 7] + C2[4] * (xx - yy) * sh[i, 8]
            if degree > 2:
                rgb += C3[0] * y * (3.0 * xx - yy) * sh[i, 9] + C3[1] * x * y * z * sh[i, 10]
                rgb += C3[2] * y * (4.0 * zz - xx - yy) * sh[i, 11]
                rgb += C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh[i, 12]
                rgb += C3[4] * x * (4.0 * zz - xx - yy) * sh[i, 13]
                rgb += C3[5] * z * (xx - yy) * sh[i, 14] + C3[6] * x * (xx - 3.0 * yy) * sh[i, 15]
    return rgb


@wp.func
def colour_seen(sh: wp.array2d(dtype=wp.vec3), i: int, degree: int, away: wp.vec3) -> wp.vec3:
    """Return the unclamped colour of Gaussian i; `away` is the vector from camera to Gaussian."""
    towards = wp.vec3()
    if degree > 0:
        towards = wp.normalize(away)
    return colour_towards(sh, i, degree, towards)


@wp.func
def screen_axes(p: wp.vec3, quat: wp.vec4, scale: wp.vec3, view: View):
    """Return two rows [px] whose dot products are the covariance of the Gaussian on the screen."""
    u = wp.clamp(p[0] / p[2], -view.limit[0], view.limit[0])
    v = wp.clamp(p[1] / p[2], -view.limit[1], view.limit[1])
    f = view.focal / p[2]
    turn = wp.quat_to_matrix(wp.normalize(wp.quat(quat[1], quat[2], quat[3], quat[0])))
    # The Jacobian's rows, rotated to world axes.
    across = f * (view.rotation[0] - u * view.rotation[2])
    down = f * (view.rotation[1] - v * view.rotation[2])
    return wp.matrix_from_rows(wp.cw_mul(across * turn, scale), wp.cw_mul(down * turn, scale))


@wp.func
def first_pixel(edge: float, size: int) -> int:
    """Return the first pixel whose centre is at or past `edge`, clamped to the image."""
    return int(wp.clamp(wp.ceil(edge - 0.5), 0.0, float(size)))


@wp.func
def box_around(mean: wp.vec2, reach: wp.vec2, view: View) -> wp.vec4i:
    """Return the (possibly empty) box of pixels whose centres are within `reach` of the mean."""
    return wp.vec4i(
        first_pixel(mean[0] - reach[0], view.width),
        first_pixel(mean[1] - reach[1], view.height),
        int(wp.clamp(wp.floor(mean[0] + reach[0] - 0.5) + 1.0, 0.0, float(view.width))),
        int(wp.clamp(wp.floor(mean[1] + reach[1] - 0.5) + 1.0, 0.0, float(view.height))),
    )


@wp.func
def splat_of(p: wp.vec3, quat: wp.vec4, scale: wp.vec3, opacity: float, view: View) -> Splat:
    """Return the splat without colour; its box is empty if the splat is invisible or not finite."""
    splat = Splat()
    # The conditions are written so that NaN fails all of them.
    if not (p[2] > view.near and opacity >= MIN_ALPHA):
        return splat
    axes = screen_axes(p, quat, scale, view)
    along_x = axes[0]
    along_y = axes[1]
    xx = wp.dot(along_x, along_x)
    xy = wp.dot(along_x, along_y)
    yy = wp.dot(along_y, along_y)
    # Lagrange's identity gives the determinant as a sum of positive terms, without cancellation.
    low = view.low_pass
    area = wp.length_sq(wp.cross(along_x, along_y))
    det = area + low * (xx + yy) + view.low_area
    d = yy + low
    mean = view.focal * wp.vec2(p[0], p[1]) / p[2] + view.centre
    # Normalising would turn a NaN quaternion into a finite rotation, so the quaternion is checked
    # first.
    if not finite(quat[0] + quat[1] + quat[2] + quat[3] + det + mean[0] + mean[1] + opacity):
        return splat
    if view.keeps_light != 0:
        opacity *= wp.sqrt(area / det)
        if opacity < MIN_ALPHA:
            return splat
    sigmas = wp.sqrt(2.0 * wp.log(opacity / MIN_ALPHA))
    reach = sigmas * wp.vec2(wp.sqrt(xx + low), wp.sqrt(d))
    splat.mean = mean
    splat.shear = xy / d
    splat.precision_x = d / det
    splat.precision_y = 1.0 / d
    splat.opacity = opacity
    splat.least = -0.5 * LOG2_E * sigmas * sigmas
    splat.box = box_around(mean, reach, view)
    return splat


@kernel("phy124_project", types=DRAWN)
def project(
    means,
    quats,
    scales,
    opacities,
    sh,
    degree,
    view,
    splats_out,
    tiles_out,
    depths_out,
    order_out,
    corners_out,
):
    """Project one Gaussian per thread; write +1 and -1 to `corners_out` at its tiles' corners."""
    i = wp.tid()
    p = view.rotation * means[i] + view.translation
    splat = splat_of(p, quats[i], scales[i], opacities[i], view)
    depth = float(0.0)
    tiles = tiles_of(splat)
    if tiles[2] > tiles[0]:
        depth = p[2]
        colour = colour_seen(sh, i, degree, means[i] - view.eye)
        splat.colour = wp.max(colour, wp.vec3(0.0, 0.0, 0.0))
        if not finite(colour[0] + colour[1] + colour[2]):
            splat.box = wp.vec4i(0, 0, 0, 0)
            tiles = wp.vec4i(0, 0, 0, 0)
        else:
            wp.atomic_add(corners_out, tiles[1], tiles[0], 1)
            wp.atomic_add(corners_out, tiles[1], tiles[2], -1)
            wp.atomic_add(corners_out, tiles[3], tiles[0], -1)
            wp.atomic_add(corners_out, tiles[3], tiles[2], 1)
    splats_out[i] = splat
    tiles_out[i] = tiles
    depths_out[i] = depth
    order_out[i] = i


project_sixteen = native_func(
    code("elementary", "elementary:sixteen")
    + constants("float", MIN_ALPHA=MIN_ALPHA, LOG2_E=LOG2_E, C0=C0)
    + code("project"),
    project.func,
    "project_sixteen",
)
"""Projects the Gaussians `16 thread` to `16 thread + 15`, without colours of a degree above 0."""


@kernel("phy124_project_simd", types=DRAWN)
def project_simd(
    means,
    quats,
    scales,
    opacities,
    sh,
    degree,
    view,
    splats_out,
    tiles_out,
    depths_out,
    order_out,
    corners_out,
):
    """Project sixteen Gaussians per thread."""
    group = wp.tid()
    project_sixteen(
        group, means, quats, scales, opacities, sh, degree, view, splats_out, tiles_out,
        depths_out, order_out, corners_out,
    )  # fmt: skip
    if degree == 0:
        return
    for i in range(16 * group, wp.min(16 * group + 16, means.shape[0])):
        tiles = tiles_out[i]
        if tiles[2] > tiles[0]:
            colour = colour_seen(sh, i, degree, means[i] - view.eye)
            splats_out[i].colour = wp.max(colour, wp.vec3(0.0, 0.0, 0.0))
            if not finite(colour[0] + colour[1] + colour[2]):
                splats_out[i].box = wp.vec4i(0, 0, 0, 0)
                tiles_out[i] = wp.vec4i(0, 0, 0, 0)
                wp.atomic_add(corners_out, tiles[1], tiles[0], -1)
                wp.atomic_add(corners_out, tiles[1], tiles[2], 1)
                wp.atomic_add(corners_out, tiles[3], tiles[0], 1)
                wp.atomic_add(corners_out, tiles[3], tiles[2], -1)


@native_kernel("phy124_bin_serial", code("tile:bin"), types=DRAWN)
def bin_serial(count: int, columns, first, last, order, tiles, ends_out, pairs_out):
    """Fill the lists of all tiles in a single thread, for CPUs.

    Before the launch, `ends_out` contains the start of each tile's list; afterwards, the end.
    """
    ...


@kernel("phy124_bin")
def sum_columns(corners_out: wp.array2d(dtype=int)):
    """Replace the corner marks of each column by cumulative sums, with one thread per column."""
    column = wp.tid()
    total = int(0)
    for row in range(corners_out.shape[0]):
        total += corners_out[row, column]
        corners_out[row, column] = total


@kernel("phy124_bin", types=DRAWN)
def count_splats(columns, sums: wp.array2d(dtype=int), counts_out):
    """Count the splats of each tile from the sums of the columns, with one thread per row."""
    row = wp.tid()
    count = int(0)
    for column in range(columns):
        count += sums[row, column]
        counts_out[row * columns + column] = count


@kernel("phy124_bin", types=DRAWN)
def start_lists(room, before: wp.array(dtype=int), starts_out, ends_out):
    """Set the start of each tile's list after the entries of all previous tiles.

    All lists together have space for `room` entries; a start is never beyond this space.
    """
    tile = wp.tid()
    start = wp.min(before[tile], room)
    starts_out[tile] = start
    ends_out[tile] = start


@kernel("phy124_bin", types=DRAWN)
def bin_parallel(columns, first, last, room, total, order, tiles, ends_out, ranks_out, pairs_out):
    """Fill the lists of all tiles with one thread per splat, for GPUs; the caller sorts the lists.

    Before the launch, `ends_out` contains the start of each tile's list; afterwards, the end. If
    the number of entries, `total`, exceeds `room`, the lists stay empty.
    """
    if total[0] > room:
        return
    k = wp.tid()
    i = order[k]
    box = tiles[i]
    for row in range(box[1], box[3]):
        for column in range(box[0], box[2]):
            tile = row * columns + column
            if tile >= first and tile < last:
                slot = wp.atomic_add(ends_out, tile, 1)
                ranks_out[slot] = k
                pairs_out[slot] = i
