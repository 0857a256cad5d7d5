"""Random places of the particles of sand: no rows, and still one in each cell."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.materials import NeoHookean, Sand
from phy124.particles import find_solid, make_particles
from phy124.particles.scatter import scatter
from phy124.scene import Scene
from phy124.simulation import prepare
from support.shapes import ball

SPACING = 0.08


@pytest.fixture(scope="module")
def body():
    return ball(3000)


def rows(x: np.ndarray) -> np.ndarray:
    """Return the structure factor of points at the lattice's period, along each axis [3].

    It is the number of points for a lattice, and about 1 for random points.
    """
    return np.abs(np.exp(2j * np.pi * x / SPACING).mean(axis=0)) ** 2 * len(x)


def test_sand_has_no_rows_and_one_particle_per_cell(body):
    made, solid = make_particles(body, density=1, spacing=SPACING), find_solid(body, SPACING)
    moved = scatter(made, solid, [Sand()], spacing=SPACING, seed=0)
    deep = np.linalg.norm(made.x, axis=1) < 0.5 - SPACING
    assert deep.sum() > 500
    assert rows(made.x[deep]).min() > 0.99 * deep.sum()
    assert rows(moved.x[deep]).max() < 10
    cells = np.floor(moved.x[deep] / SPACING)
    assert len(np.unique(cells, axis=0)) == deep.sum()
    assert solid.contains(moved.x)[solid.contains(made.x)].all(), "none leaves the object"
    assert moved.volume is made.volume


def test_other_materials_keep_the_lattice(body):
    made, solid = make_particles(body, density=1, spacing=SPACING), find_solid(body, SPACING)
    assert scatter(made, solid, [NeoHookean()], spacing=SPACING, seed=0) is made
    half = np.arange(len(made)) % 2
    mixed = replace(made, material=half)
    both = scatter(mixed, solid, [NeoHookean(), Sand()], spacing=SPACING, seed=0)
    still = (both.x == made.x).all(axis=1)
    assert still[half == 0].all() and not still[half == 1].all()


def test_particles_of_a_scene_of_sand_are_scattered(body):
    def places(**changes):
        scene = Scene().replaced({"accuracy": {"cells": 8}, "material.law": "sand", **changes})
        return prepare(body, scene).particles.x

    first, again, other = places(), places(), places(seed=1)
    assert (first == again).all() and not (first == other).all()
    paper = places(binding="particles")
    assert (places(binding="particles", seed=1) == paper).all(), "the method of the paper has none"
