"""Weights of liquid layers with different densities around a body."""

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.liquid import films
from phy124.liquid.cells import Cells, Region
from phy124.mpm import Model


def weigh_layers(
    model: Model,
    cells: Cells,
    region: Region,
    densities: wp.array | None,
    pull: NDArray[np.float64],
) -> tuple[float, wp.array]:
    """Return the height of the lowest layer of liquid around a body [cells], and the weight of each
    layer.

    Weights are relative to the mean density. The list is empty for a single liquid.

    Args:
        model: The particles of the bodies.
        cells: The cells.
        region: The cells around the body.
        densities: Relative densities in the cells; None if the density is uniform.
        pull: Acceleration by gravity [3], m/s^2.
    """
    strength = float(np.linalg.norm(pull))
    if densities is None or strength == 0:
        return 0.0, wp.zeros(0, dtype=model.real, device=model.device)
    up = -pull / strength
    corner = cells.origin / cells.dx + cells.low + np.asarray(region.box.numpy())[0]
    low = float(corner @ up + np.minimum(up * region.size, 0).sum())
    layers = wp.zeros(math.ceil(np.abs(up) @ region.size) + 1, dtype=wp.vec2d, device=model.device)
    inputs = [types(model.real).vec3(*up), low, region.box, cells.lattice, cells.window]
    inputs += [densities, cells.liquid]
    count = int(np.prod(region.size))
    wp.launch(films.make_layers(model.real), count, inputs, [layers], device=model.device)
    totals = np.asarray(layers.numpy(), np.float64)
    full = np.flatnonzero(totals[:, 1])
    if len(full) == 0:
        return 0.0, wp.zeros(0, dtype=model.real, device=model.device)
    dense = np.interp(np.arange(len(totals)), full, totals[full, 0] / totals[full, 1])
    return low, model.array(np.concatenate([[0.0], np.cumsum(dense)]), model.real)
