"""The lattice of a live run as a browser gets it: bound once, then a few bytes per node and frame.

A binding holds for each Gaussian what never changes, a frame for each node what does; both are
little-endian and planar (array after array):

    binding  place at rest [N,3] float32, covariance at rest [N,6] float32 (xx xy xz yy yz zz),
             largest stretch [N] float32, nodes at rest [P,3] float32, nodes of each Gaussian [N,8]
             uint16, their weights [N,8] uint8, colour and opacity [N,4] uint8
    frame    box of the nodes [2,3] float32, places in it [P,3] uint16, F [P,9] int16

The frame of the walls follows (`walls`). A node takes 24 bytes per frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.live import Live
from phy124.simulation.deform import CARRIERS, carriers

MOST = 5000
"""Nodes that are sent; at 24 frames per second they take 2.9 MB/s."""
REACH = 8.0
"""Largest entry of F that is sent."""


class Lattice:
    """The nodes of one live run that carry what is seen of it."""

    def __init__(self, live: Live, most: int = MOST) -> None:
        """Bind the Gaussians to the nearest particles.

        Args:
            live: The run.
            most: Nodes that are sent at most.
        """
        look, rest = live.look, live.rest
        # Whoever draws only the first ones gets a fair sample.
        order = np.random.default_rng(0).permutation(len(look.gaussians))
        self.gaussians, moves = look.gaussians.select(order), look.moves[order]
        stretch = np.ones(len(order), np.float32)
        stretch[look.moves] = np.minimum(look.max_stretch, look.holds)
        self._stretch = np.minimum(stretch[order], 1e6)
        self.nodes, near, self.weights = _bound(self.gaussians, rest, most)
        self.neighbours = near.astype("<u2")
        # What does not move has no node: it stays where it is.
        self.weights[~moves] = 0
        self.rest = rest[self.nodes]
        self._live = live

    def binding(self) -> bytes:
        """What a browser needs once."""
        g = self.gaussians
        sigma = g.covariances()[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        floats = [g.means, sigma, self._stretch, self.rest]
        colours = np.rint(np.column_stack([g.rgb, g.opacities]) * 255).clip(0, 255)
        whole = np.rint(self.weights * 255).astype(np.uint8)
        parts = [*(part.astype("<f4") for part in floats), self.neighbours, whole]
        return b"".join(part.tobytes() for part in [*parts, colours.astype(np.uint8)])

    def frame(self) -> bytes:
        """Where the nodes are now, and how the material about them is deformed."""
        x, F = (values[self.nodes] for values in self._live.particles)
        low, high = x.min(axis=0), x.max(axis=0)
        steps = np.rint((x - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2")
        turned = np.rint(F.reshape(-1, 9).clip(-REACH, REACH) * (32767 / REACH)).astype("<i2")
        box = np.stack([low, high]).astype("<f4")
        return b"".join(part.tobytes() for part in (box, steps, turned))


def _bound(
    gaussians: Gaussians, rest: NDArray, most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Particles that carry the Gaussians, and for each Gaussian its eight of them with weights."""
    nodes = np.arange(len(rest))
    near, weights = carriers(gaussians.means, rest)
    used = np.unique(near)
    if len(used) > most:
        nodes = np.sort(np.random.default_rng(0).permutation(used)[:most])
        near, weights = carriers(gaussians.means, rest[nodes])
        used = np.unique(near)
    spare = ((0, 0), (0, CARRIERS - near.shape[1]))
    return nodes[used], np.pad(np.searchsorted(used, near), spare), np.pad(weights, spare)
