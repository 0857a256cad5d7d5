"""Blends splats front to back: one thread per pixel (CUDA), or per tile in Python or C++ (CPUs).

tests/test_render.py compares both versions for tiles. `gather_pixels` is the adjoint.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.native import code, constants, native_kernel
from phy124.kernels.splat.arguments import DRAWN
from phy124.kernels.splat.screen import (
    MAX_ALPHA,
    MIN_ALPHA,
    MIN_TRANSMITTANCE,
    TILE,
    alpha_at,
    blend_over,
)

PIXELS = wp.constant(256)


@kernel("phy124_blend", types=DRAWN)
def blend_pixels(view, background, first, starts, ends, pairs, splats, image_out, alpha_out):
    """Blend the splats with one thread per pixel; 256 consecutive threads process a tile."""
    thread = wp.tid()
    tile = first + thread / PIXELS
    x = (tile % view.columns) * TILE + thread % TILE
    y = (tile / view.columns) * TILE + (thread % PIXELS) / TILE
    if x >= view.width or y >= view.height:
        return
    transmittance = float(1.0)
    light = wp.vec3(0.0, 0.0, 0.0)
    for k in range(starts[tile], ends[tile]):
        splat = splats[pairs[k]]
        alpha = alpha_at(splat, x, y)
        if alpha > 0.0:
            rest = transmittance * (1.0 - alpha)
            if rest < MIN_TRANSMITTANCE:
                break
            light += alpha * transmittance * splat.colour
            transmittance = rest
    pixel = y * view.width + x
    image_out[pixel] = blend_over(light, transmittance, background)
    alpha_out[pixel] = 1.0 - transmittance


@kernel("phy124_blend", types=DRAWN)
def quantise(image, bytes_out: wp.array2d(dtype=wp.uint8)):
    """Convert an image with values in 0..1 to bytes [pixels,3], rounded to the nearest integer."""
    pixel = wp.tid()
    colour = 255.0 * image[pixel] + wp.vec3(0.5, 0.5, 0.5)
    for channel in range(3):
        bytes_out[pixel, channel] = wp.uint8(colour[channel])


@kernel("phy124_blend", types=DRAWN)
def blend_tiles(view, background, first, starts, ends, pairs, splats, image_out, alpha_out):
    """Blend the splats with one thread per tile; a pixel with T < 0 is finished."""
    tile = first + wp.tid()
    left = (tile % view.columns) * TILE
    top = (tile / view.columns) * TILE
    transmittance = wp.zeros(shape=256, dtype=float)
    light = wp.zeros(shape=256, dtype=wp.vec3)
    for j in range(PIXELS):
        transmittance[j] = 1.0
    undone = wp.min(TILE, view.width - left) * wp.min(TILE, view.height - top)
    for k in range(starts[tile], ends[tile]):
        if undone == 0:
            break
        splat = splats[pairs[k]]
        box = splat.box
        for y in range(wp.max(box[1], top), wp.min(box[3], top + TILE)):
            for x in range(wp.max(box[0], left), wp.min(box[2], left + TILE)):
                j = (y - top) * TILE + x - left
                t = transmittance[j]
                alpha = alpha_at(splat, x, y)
                if alpha > 0.0 and t > 0.0:
                    rest = t * (1.0 - alpha)
                    if rest < MIN_TRANSMITTANCE:
                        transmittance[j] = -t
                        undone -= 1
                    else:
                        light[j] += alpha * t * splat.colour
                        transmittance[j] = rest
    for j in range(PIXELS):
        x = left + j % TILE
        y = top + j / TILE
        if x < view.width and y < view.height:
            t = wp.abs(transmittance[j])
            image_out[y * view.width + x] = blend_over(light[j], t, background)
            alpha_out[y * view.width + x] = 1.0 - t


OPEN_TILE = (
    code("elementary")
    + constants(
        "float", MAX_ALPHA=MAX_ALPHA, MIN_ALPHA=MIN_ALPHA, MIN_TRANSMITTANCE=MIN_TRANSMITTANCE
    )
    + code("tile")
)
SUM_TILE = OPEN_TILE + code("tile:light", "tile:splats")
STORE_TILE = code("tile:store")

blend_tiles_simd = native_kernel(
    "phy124_blend_simd", SUM_TILE + STORE_TILE, name="blend_tiles_simd"
)(blend_tiles.func)
"""Version of `blend_tiles` with vector instructions of a CPU."""


@kernel("phy124_gather", types=DRAWN)
def gather_pixels(view, first, values, starts, ends, pairs, splats, sums_out, weights_out):
    """Add to each splat the weighted values of the splat's pixels, and the weights."""
    thread = wp.tid()
    tile = first + thread / PIXELS
    x = (tile % view.columns) * TILE + thread % TILE
    y = (tile / view.columns) * TILE + (thread % PIXELS) / TILE
    if x >= view.width or y >= view.height:
        return
    value = values[y * view.width + x]
    transmittance = float(1.0)
    for k in range(starts[tile], ends[tile]):
        i = pairs[k]
        alpha = alpha_at(splats[i], x, y)
        if alpha > 0.0:
            rest = transmittance * (1.0 - alpha)
            if rest < MIN_TRANSMITTANCE:
                break
            wp.atomic_add(sums_out, i, alpha * transmittance * value)
            wp.atomic_add(weights_out, i, alpha * transmittance)
            transmittance = rest


gather_tiles_simd = native_kernel(
    "phy124_gather_simd", OPEN_TILE + code("tile:gather", "tile:splats"), name="gather_tiles_simd"
)(gather_pixels.func)
"""Version of `gather_pixels` for CPUs; it runs tile by tile, since tiles share splats."""
