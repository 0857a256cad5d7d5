"""Cells of a lattice that several parts of a body share (phy124/particles/shares.py)."""

import numpy as np
import pytest

from phy124.particles.lattice import cells_of, lattice_of
from phy124.particles.shares import Parts
from phy124.scene import Scene
from phy124.simulation import prepare
from support.lattices import DX, block
from support.shapes import ball


@pytest.mark.parametrize("low", [0, 0.5])
@pytest.mark.parametrize("thick", [0.3, 1.6])
def test_layers_have_their_mass_and_bending_stiffness(thick, low):
    """A beam is 6 cells thick; its outer layers on both sides are another part."""

    def skin(x):
        return (np.abs(x[:, 2] / DX - low - 3) > 3 - thick).astype(np.int32)

    beam = block((1.2, 0.2, 0.6), (low * DX,) * 3)
    parts = Parts(skin, np.array([False, False]))
    points = lattice_of(beam, density=1000, dx=DX, parts=parts)
    chosen, z = points.material == 1, points.x[:, 2] / DX - low - 3
    area, second = 2 * 2 * thick, 2 * 2 / 3 * (3**3 - (3 - thick) ** 3)
    volume = points.volume / DX**3 / 12
    assert volume[chosen].sum() == pytest.approx(area, rel=0.015)
    assert (volume * z**2)[chosen].sum() == pytest.approx(second, rel=0.015)
    assert points.volume.sum() == pytest.approx(beam.volume)


def test_parts_that_are_whole_end_at_whole_cells():
    def lower(x):
        return (x[:, 2] < 0.17).astype(np.int32)

    solid = block((0.4, 0.4, 0.4))
    parts = Parts(lower, np.array([False, True]))
    points = lattice_of(solid, density=1000, dx=DX, parts=parts)
    assert len(points) == len(lattice_of(solid, density=1000, dx=DX))
    cells = cells_of(points)
    assert np.array_equal(cells.material == 1, cells.x[:, 2] < 0.2)


def test_thin_layer_inside_a_cell_has_its_own_points():
    """The material on both sides of the layer has nearly the same centre, and another law."""
    region = {"lower": [-9, -9, 0.5475], "upper": [9, 9, 0.5775]}
    data = Scene.named("spin").data()
    data["accuracy"] = {"cells": 8, "solver": "lattice"}
    data["parts"] = [{"region": region, "material": {"law": "fixed_corotated", "density": 3000}}]
    particles = prepare(ball(), Scene.from_data(data)).particles
    layer = particles.density == 3000
    assert layer.any()
    z = particles.x[:, 2].reshape(-1, 8)[layer[::8]]
    assert np.ptp(z, axis=1).max() < 0.03


@pytest.mark.parametrize(("height", "more"), [(0.625, None), (0.56, "more"), (0.57, "less")])
def test_note_states_the_mass_that_static_parts_gain_or_lose(height, more):
    """The side of a cell is 0.125."""
    data = Scene.named("spin").data()
    data["accuracy"] = {"cells": 8, "solver": "lattice"}
    data["parts"] = [{"region": {"lower": [-9, -9, -9], "upper": [9, 9, height]}, "static": True}]
    notes = " ".join(prepare(ball(), Scene.from_data(data)).notes)
    said = f"{more} mass than the material in their regions, because static parts end at whole"
    assert said in notes if more else "whole cells" not in notes
