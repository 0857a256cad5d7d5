"""A damped oscillator: what a fit can be tried on without running a scene."""

import numpy as np

from phy124.fit.observation import Kind

POINTS, INSTANTS = 20, np.linspace(0, 2, 25)
TRUTH = np.array([0.6, 0.35])


class Oscillator:
    """Points that swing with one frequency and decay; the coarser the grid, the stiffer.

    `bent` is an error of the grid besides, of a shape that no value has.
    """

    def __init__(
        self, seed=0, *, noise=0.02, names=("k", "c"), grids=(16, 24), truth=TRUTH, bent=0.0
    ):
        random = np.random.default_rng(seed)
        self.names, self.grids, self.calls = names, grids, [0] * len(grids)
        self.heights = random.uniform(0.3, 1, POINTS)
        self.bend = bent * np.tile(np.cos(3 * np.pi * INSTANTS), POINTS)
        exact = self.swing(truth, 0.0)
        self.measured = exact + noise * random.standard_normal(exact.shape)
        self.groups = np.repeat(np.arange(POINTS), len(INSTANTS))
        self.kinds = [Kind("points", "m", slice(0, len(exact)))]

    def swing(self, place, spacing):
        """Heights of all points at all instants; a third value is a mass, a fourth does nothing."""
        k, c = 20 * 10 ** place[0] * (1 + 0.3 * spacing), 0.1 * 20 ** place[1]
        if len(place) > 2:
            k /= 10 ** place[2]
        return np.outer(self.heights, np.exp(-c * INSTANTS) * np.cos(k**0.5 * INSTANTS)).ravel()

    def predict(self, places, level):
        self.calls[level] += len(places)
        spacing = 1 / self.grids[level]
        return [self.swing(place, spacing) + spacing * self.bend for place in places]

    def late(self, part):
        return False
